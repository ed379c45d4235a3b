"""Measures on a pair: its lines in linear DN, ridges across them, how much contrast explains, leak and clipping."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8, UInt16

from jaxscan.stripes import Colour, LaserLine, PixelFormat, Response, decode_table, frame_rank, laser_plane


COLOURS: tuple[Colour, ...] = ("red", "green", "blue")
_LINES = 256
"""Number of lines that are examined; each is independent evidence."""
STACK = 4
"""Most image lines that are averaged to one: this helps faint stripes and harms leaning ones little."""
CLIPPED = 250
"""Lowest level of a clipped pixel [DN]."""
_NEARLY_CLIPPED = 245.0


class FramePair(NamedTuple):
    """The examined lines; each is the mean of some image lines [linear DN]."""

    on: Float[np.ndarray, "lines samples"]
    off: Float[np.ndarray, "lines samples"]
    clipped: float
    """Fraction of clipped pixels, the larger of the two frames."""
    lit: UInt8[np.ndarray, "all samples"] | UInt16[np.ndarray, "all samples"]
    step: int
    """Distance of the examined lines, in image lines."""
    top: int = CLIPPED
    """Lowest sample that is clipped."""


def check_frames(on: np.ndarray, off: np.ndarray, pixel_format: PixelFormat, bits: int = 8) -> None:
    """Raise ValueError if these are not two frames of the same shape."""
    rank = frame_rank(pixel_format)
    kind = np.dtype(np.uint16 if bits > 8 else np.uint8)
    if on.dtype != kind or on.ndim != rank or min(on.shape[:2]) < 64:
        raise ValueError(f"`on` must be {kind} with {rank} dimensions and 64 px, got {on.dtype} with shape {on.shape}.")
    if off.shape != on.shape or off.dtype != kind:
        raise ValueError(f"`off` must be like `on`, got {off.dtype} with shape {off.shape}.")


def with_colour(on: np.ndarray, off: np.ndarray, pixel_format: PixelFormat, line: LaserLine) -> LaserLine:
    """The laser; for the colour "auto", with the colour that changes most between the frames."""
    if line.colour != "auto" or pixel_format == "mono8":
        return line
    lines = [LaserLine(line.name, colour, line.stripe_axis) for colour in COLOURS]
    return max(lines, key=lambda one: _brightest_change(on, off, pixel_format, one))


def _brightest_change(on: np.ndarray, off: np.ndarray, pixel_format: PixelFormat, line: LaserLine) -> float:
    lit, dark = (laser_plane(a[None], pixel_format=pixel_format, line=line)[0, ::4].astype(np.int32) for a in (on, off))
    return float(np.abs(lit - dark).max(1).mean())


def lines_of(
    on: np.ndarray, off: np.ndarray, pixel_format: PixelFormat, response: Response, line: LaserLine, bits: int = 8
) -> FramePair:
    """The examined lines of two frames, in the laser's colour and along its axis."""
    top = CLIPPED << bits - 8
    lit, dark = (np.asarray(laser_plane(a[None], pixel_format=pixel_format, line=line))[0] for a in (on, off))
    step = max(1, len(lit) // _LINES)
    few = (slice(None, None, 4), slice(None, None, 3))
    clipped = max(float((a[few] >= top).mean()) for a in (lit, dark))
    frames = _stacked(lit, step, response, bits), _stacked(dark, step, response, bits)
    return FramePair(*frames, clipped, lit, step, top)


def _stacked(plane: np.ndarray, step: int, response: Response, bits: int) -> Float[np.ndarray, "lines samples"]:
    """Means of up to `STACK` image lines each [linear DN of 8 bits]; more than 8 bits are linear."""
    lines, stack = len(plane) // step, min(step, STACK)
    unit, wide = 1.0 / (1 << bits - 8), np.uint32 if bits > 8 else np.uint16
    if response != "linear":
        unit = 1.0 / 16.0
        plane = np.rint(16.0 * decode_table(response)[0]).astype(np.uint16)[plane]
    total = plane[: lines * step : step].astype(wide)
    for k in range(1, stack):
        np.add(total, plane[k : lines * step : step], out=total)
    # Where the lines are columns of the image, they are contiguous only from here on.
    return np.ascontiguousarray(total).astype(np.float32) * np.float32(unit / stack)


def difference_of(pair: FramePair, gain: float) -> Float[np.ndarray, "lines samples"]:
    """The laser-on frame minus the light of the room; 0 where that is clipped."""
    room = pair.off * np.float32(gain)
    np.minimum(room, np.float32(255.0), out=room)
    difference = np.subtract(pair.on, room, out=room)
    difference[(pair.off > _NEARLY_CLIPPED) & (difference > 0)] = 0.0
    return difference


def gain_of(pair: FramePair) -> float:
    """Lamp ratio of the pair: the median ratio, refined by a robust fit."""
    few = (slice(None, None, max(1, len(pair.on) // 32)), slice(None, None, 3))
    on, off = pair.on[few].ravel(), pair.off[few].ravel()
    # Selected and weighted by the sum: a selection by one frame would be biased by its noise.
    usable = (on + off > 8.0) & (on < CLIPPED) & (off < CLIPPED)
    on, off = on[usable], off[usable]
    if len(on) < 200:
        return 1.0
    gain = float(np.clip(float(np.median(on / np.maximum(off, 0.25))), 0.1, 10.0))
    both = on + off
    for _ in range(2):
        residual = on - np.float32(gain) * off
        scale = 1.4826 * float(np.median(np.abs(residual))) + 0.1
        weight = np.maximum(1.0 - (residual / (3.0 * scale)) ** 2, 0.0) ** 2
        bottom = float(np.sum(weight * both * off))
        gain = float(np.sum(weight * both * on)) / bottom if bottom > 0 else gain
    return gain


CORE = 3
"""Samples over which a ridge is summed: the middle of a stripe."""
FLANK = 9
"""Samples on either side with which it is compared."""
GAP = 8
"""Distance from the middle of the core to the middle of a flank [samples]."""
COARSE = 4
"""Samples that are summed for the coarse scale, which finds wide, glowing and clipped stripes."""
Z = 4.0
"""Least height of a ridge, in standard deviations. Of 100 lines of 1280 samples of noise 4 have one, but at random
places; only ridges that continue on neighbouring lines count (`coherent`): by chance one line in a million."""
OTHERS = 0.5
"""Largest height of another ridge or a furrow on the same line, as a part of the ridge's height: texture, motion and
uneven flicker make many of both signs; a laser makes one ridge."""
_AROUND = 24
"""Least distance of two ridges [samples]."""
_REACH = 3
"""Lines on either side on which a ridge must continue."""
_SLOPE = 8.0
"""Largest lean of a ridge, samples per line: with 4 lines averaged, 63 degrees."""
_ROUNDING = (CORE + CORE**2 / FLANK / 2.0) * 2.0 / 12.0
"""Variance of a height from the rounding of two frames. Noise is taken as at least this, since smaller noise consists
of single counts and is not Gaussian."""
_MEASURABLE = (1.0, 240.0)
"""Levels at which noise is not cut off at 0 or 255 [DN, one sample]."""
_NORMAL = 0.6745
_BINS = 8
_ENOUGH = 200
"""Samples that a bin of levels needs to estimate its noise to 5 %."""
_PLENTY = 0.5
"""Part of the lines with a clear ridge above which the coarse scale is skipped."""


class Ridges(NamedTuple):
    """The best ridge of each line."""

    at: Int[np.ndarray, " lines"]
    """Its middle [samples]."""
    z: Float[np.ndarray, " lines"]
    """Its height above the higher of its flanks, in standard deviations."""
    seen: Bool[np.ndarray, " lines"]
    """It is significant and continues on neighbouring lines."""
    clear: Bool[np.ndarray, " lines"]
    """It is seen, and no other ridge or furrow of its line comes near its height."""

    @property
    def strength(self) -> float:
        """Sum of the heights of all seen ridges, in standard deviations."""
        return float(self.z[self.seen].sum())


class Relief(NamedTuple):
    """Ridges and furrows of a field."""

    ridges: Ridges
    furrows: Ridges


def find_ridges(field: Float[np.ndarray, "lines samples"], level: Float[np.ndarray, "lines samples"]) -> Relief:
    """The brightest and the darkest thin line of a field, at two scales.

    Args:
        field: The field to search, float32: the difference of two frames, or a frame.
        level: The light on which its noise depends, float32.
    """
    fine = _at_scale(field, level, 1)
    if fine.ridges.clear.mean() > _PLENTY or field.shape[1] < COARSE * (2 * GAP + FLANK + 2):
        return fine
    coarse = _at_scale(_coarse(field), _coarse(level), COARSE)
    # One scale for the whole frame, so that all lines are judged alike.
    return coarse if _clear(coarse) > 1.5 * _clear(fine) else fine


def _clear(relief: Relief) -> int:
    return max(int(np.count_nonzero(one.clear)) for one in relief)


def _coarse(field: Float[np.ndarray, "lines samples"]) -> Float[np.ndarray, "lines fewer"]:
    kept = field.shape[1] // COARSE * COARSE
    total = field[:, 0:kept:COARSE].copy()
    for k in range(1, COARSE):
        total += field[:, k:kept:COARSE]
    return total


def heights(
    field: Float[np.ndarray, "lines samples"], rows: Int[np.ndarray, " n"], at: Int[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Height of the core above the mean of both flanks at one place of some lines, per sample of the core."""
    half, last, lines = FLANK // 2, field.shape[1] - 1, rows[:, None]

    def mean(middle: Int[np.ndarray, " n"], reach: int) -> Float[np.ndarray, " n"]:
        offsets = np.arange(-reach, reach + 1)
        return field[lines, np.clip(middle[:, None] + offsets, 0, last)].mean(1)

    return mean(at, CORE // 2) - 0.5 * (mean(at - GAP - half, half) + mean(at + GAP + half, half))


def _at_scale(
    field: Float[np.ndarray, "lines samples"], level: Float[np.ndarray, "lines samples"], scale: int
) -> Relief:
    core, left, right = _core_and_flanks(field)
    reach = GAP + FLANK // 2
    per_deviation = _per_deviation(core, left, right, level[:, reach:-reach], scale)
    higher, lower = np.maximum(left, right), np.minimum(left, right, out=left)
    up = np.subtract(core, higher, out=higher)
    up *= per_deviation
    down = np.subtract(lower, core, out=lower)
    down *= per_deviation
    best = [_best(response, scale) for response in (up, down)]
    return Relief(*(_judged(*one, other[1], scale) for one, other in zip(best, best[::-1], strict=True)))


def _best(response: Float[np.ndarray, "lines samples"], scale: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Place and height of each line's maximum, and its second maximum; overwrites the response."""
    rows = np.arange(len(response))
    at = np.argmax(response, 1)
    z = response[rows, at]
    around = at[:, None] + np.arange(-_AROUND // scale, _AROUND // scale + 1)
    response[rows[:, None], np.clip(around, 0, response.shape[1] - 1)] = 0.0
    return at, z, response.max(1)


def _judged(at: np.ndarray, z: np.ndarray, rival: np.ndarray, opposite: np.ndarray, scale: int) -> Ridges:
    allowed = np.maximum(Z, OTHERS * z)
    strong = z >= Z
    clear = strong & (rival < allowed) & (opposite < allowed)
    middle = at + GAP + FLANK // 2
    slope = _SLOPE / scale + 1.0 * (scale > 1)
    place = middle * scale + scale // 2
    return Ridges(place, z, coherent(middle, strong, slope), clear & coherent(middle, clear, slope))


def coherent(
    at: Int[np.ndarray, " lines"], chosen: Bool[np.ndarray, " lines"], slope: float
) -> Bool[np.ndarray, " lines"]:
    """Which chosen ridges continue on two neighbouring lines without leaning too much."""
    company = np.zeros(len(at), np.int8)
    for step in range(1, min(_REACH, len(at) - 1) + 1):
        near = chosen[step:] & chosen[:-step] & (np.abs(at[step:] - at[:-step]) <= slope * step)
        company[step:] += near
        company[:-step] += near
    return chosen & (company >= 2)


def _core_and_flanks(field: Float[np.ndarray, "lines samples"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sum of the core, and of the left and right flank scaled to as many samples, where all three are inside."""
    reach = GAP + FLANK // 2
    inside = field.shape[1] - 2 * reach
    third = field[:, :-2] + field[:, 1:-1] + field[:, 2:]
    flank = (third[:, :-6] + third[:, 3:-3] + third[:, 6:]) * np.float32(CORE / FLANK)
    return third[:, reach - 1 : reach - 1 + inside], flank[:, :inside], flank[:, 2 * GAP : 2 * GAP + inside]


def _per_deviation(
    core: Float[np.ndarray, "lines samples"],
    left: Float[np.ndarray, "lines samples"],
    right: Float[np.ndarray, "lines samples"],
    level: Float[np.ndarray, "lines samples"],
    scale: int,
) -> Float[np.ndarray, "lines samples"]:
    """One over the standard deviation of a ridge's height: a straight line is fitted to its variance over the level.

    Estimated from the heights themselves, so that it includes correlated noise and texture under uneven flicker.
    """
    # Every third sample, since the sums of neighbours overlap.
    few = slice(None, None, max(1, len(core) // 32)), slice(None, None, 3)
    size = np.abs(core[few] - 0.5 * (left[few] + right[few])).ravel()
    light = level[few].ravel()
    measurable = (light > _MEASURABLE[0] * scale) & (light < _MEASURABLE[1] * scale)
    if np.count_nonzero(measurable) >= _BINS * _ENOUGH:
        size, light = size[measurable], light[measurable]
    edges = np.linspace(float(light.min()), float(light.max()) + 1e-3, _BINS + 1)
    which = np.minimum((light - np.float32(edges[0])) * np.float32(_BINS / np.ptp(edges)), _BINS - 1).astype(np.int8)
    bins = [size[which == k] for k in range(_BINS)]
    centres = 0.5 * (edges[1:] + edges[:-1])
    known = [k for k in range(_BINS) if len(bins[k]) >= _ENOUGH]
    if len(known) < 2:
        slope, start = 0.0, _variance(size)
    else:
        variance = [_variance(bins[k]) for k in known]
        # The uncertainty of a variance is proportional to it.
        weight = np.sqrt([len(bins[k]) for k in known]) / (np.array(variance) + _ROUNDING * scale)
        slope, start = (float(a) for a in np.polyfit(centres[known], variance, 1, w=weight))
        slope = max(slope, 0.0)
    model = level * np.float32(slope)
    model += np.float32(start)
    np.maximum(model, np.float32(_ROUNDING * scale), out=model)
    np.sqrt(model, out=model)
    return np.divide(np.float32(1.0), model, out=model)


def _variance(size: Float[np.ndarray, " n"]) -> float:
    """Robust variance of heights, from their absolute values; a median alone would be a whole number of counts."""
    variance = (float(np.median(size)) / _NORMAL) ** 2 + _ROUNDING
    square = size * size
    for _ in range(2):
        # Values within 3 standard deviations have 0.973 of the variance.
        variance = float(square[square <= 9.0 * variance].mean()) / 0.973
    return variance


_BLACK_DN = 32.0
_FEATURELESS_DN = 3.0
"""Under a lens cap a frame is darker than the first, and its large features are flatter than the second."""
_NOISE_CUT = 6.0
"""Residuals are clipped at this many standard deviations when the unrest is computed."""
_BESIDE = 14
"""Contrast may explain a ridge within this many samples on either side."""
_EXPLAINS_MOST = 1.5
"""Largest change by motion as a multiple of the contrast; thin moving objects exceed 1."""
_MOSTLY = 0.4
"""Least part of the ridges that contrast must not explain: for a laser it is nearly all, for motion a fifth."""
_MARGIN = 3.0
"""Ratio of the largest relative change of a contrast to its 90 % quantile."""
_ALIKE = 4.0
"""Number of neighbouring lines that see the same texture."""


def solid_part(ridges: Ridges, field: np.ndarray, frame: np.ndarray, explains: float) -> float:
    """Part of the lines whose ridge contrast of the other frame cannot explain; 0 if that is a minority of the ridges.

    Motion and flicker change a frame by a fraction of its contrast. A ridge that is higher than this fraction of the
    contrast of the other frame beside it is additional light.
    """
    rows = np.flatnonzero(ridges.clear)
    if len(rows) == 0:
        return 0.0
    at = ridges.at[rows]
    beside = np.clip(at[:, None] + np.arange(-_BESIDE, _BESIDE + 1), 0, field.shape[1] - 1)
    contrast = np.ptp(_smooth(frame[rows[:, None], beside]), 1)
    solid = float((peak_heights(field, rows, at) > explains * contrast).mean())
    return solid * len(rows) / len(ridges.at) if solid > _MOSTLY else 0.0


def explained_part(difference: np.ndarray, off: np.ndarray, relief: Relief) -> float:
    """Fraction of a frame's contrast by which it may have changed: near 0 if nothing moved, 1 if everything moved.

    Estimated from blocks with contrast, without those that may contain the stripe: along a door frame these could be a
    sixth of all.
    """
    few = slice(None, None, max(1, len(off) // 32))
    change, light = _smooth(difference[few]), _smooth(off[few])
    noise = 1.4826 * float(np.median(np.abs(change).ravel())) + 0.1
    blocks = change.shape[1] // 16
    change, light = (a[:, : 16 * blocks].reshape(len(a), blocks, 16) for a in (change, light))
    contrast = np.ptp(light, 2)
    structured = contrast > 8.0 * noise
    for found in relief:
        own = np.abs(np.arange(blocks) - found.at[few, None] // 16) <= 1
        structured &= ~(own & found.seen[few, None])
    if np.count_nonzero(structured) < 50:
        return 1.0
    part = np.maximum(np.abs(change[structured]).max(1) - 3.0 * noise, 0.0) / contrast[structured]
    return float(min(_MARGIN * np.quantile(part, 0.9) + 0.1, _EXPLAINS_MOST))


def _smooth(field: np.ndarray) -> np.ndarray:
    return (field[:, :-2] + field[:, 1:-1] + field[:, 2:]) * np.float32(1.0 / 3.0)


def unrest_of(difference: Float[np.ndarray, "lines samples"], off: Float[np.ndarray, "lines samples"]) -> float:
    """Root mean square of the negative differences, over that of the noise; a laser makes only positive ones.

    The noise is estimated from second differences along the lines, as the median over blocks of similar level, so that
    smooth light and edges do not contribute.
    """
    few = slice(None, None, max(1, len(off) // 32))
    residual, level = difference[few], off[few]
    block = 16
    blocks = residual.shape[1] // block
    if blocks == 0:
        return 0.0
    second = residual[:, :-4] - 2.0 * residual[:, 2:-2] + residual[:, 4:]
    second = np.pad(second, ((0, 0), (0, 4)))[:, : blocks * block].reshape(len(level), blocks, block)[..., :-4]
    variance = (second * second).mean(2).ravel() / 6.0
    light = level[:, : blocks * block].reshape(len(level), blocks, block).mean(2).ravel()
    order = np.argsort(light)
    # The median of 12 correlated squares is below their mean.
    table = [
        (float(np.median(light[part])), float(np.median(variance[part])) / 0.89)
        for part in np.array_split(order, 8)
        if len(part)
    ]
    floor = 2.0 / 12.0 / 4.0
    # Noise of dark samples is cut off at zero.
    darker = (residual < 0) & (level > 2.0)
    residual, level = residual[darker], level[darker]
    if residual.size <= 50:
        return 0.0
    noise = np.maximum(np.interp(level, *np.array(table).T), floor)
    return float(np.sqrt(np.minimum(residual * residual / noise, _NOISE_CUT**2).mean()))


def peak_heights(
    difference: Float[np.ndarray, "lines samples"], rows: Int[np.ndarray, " n"], at: Int[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Highest sample near a ridge of some lines minus the median beside it [DN]."""
    lines, last = rows[:, None], difference.shape[1] - 1
    near = difference[lines, np.clip(at[:, None] + np.arange(-4, 5), 0, last)]
    beside = difference[lines, np.clip(at[:, None] + np.array([-32, -28, -24, -20, 20, 24, 28, 32]), 0, last)]
    return near.max(1) - np.median(beside, 1)


def leak_of(off: Float[np.ndarray, " n"], difference: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Part of the stripe's light that is in the laser-off frame: median over the rows, and its standard deviation."""
    good = difference > 0
    if np.count_nonzero(good) < 3:
        return 0.0, 1.0
    ratio = off[good] / difference[good]
    middle = float(np.median(ratio))
    scatter = 1.4826 * float(np.median(np.abs(ratio - middle)))
    leak = middle / (1.0 + middle) if middle > 0 else middle
    return leak, 1.2533 * scatter / float(np.sqrt(len(ratio) / _ALIKE))


def saturated_part(pair: FramePair, rows: np.ndarray, at: np.ndarray) -> float:
    """Part of the rows whose stripe is clipped at its peak, at `at` [samples]."""
    if len(rows) == 0:
        return 0.0
    lines = rows[:, None, None] * pair.step + np.arange(min(pair.step, STACK))[None, :, None]
    samples = np.clip(at[:, None, None] + np.arange(-2, 3)[None, None, :], 0, pair.lit.shape[1] - 1)
    return float((pair.lit[lines, samples] >= pair.top).any((1, 2)).mean())


def is_covered(frame: Float[np.ndarray, "lines samples"]) -> bool:
    """Whether a frame is dark and has no large features, judged by blocks of 16 by 16 samples."""
    lines, samples = (size // 16 for size in frame.shape)
    blocks = frame[: lines * 16, : samples * 16].reshape(lines, 16, samples, 16).mean((1, 3))
    return bool(frame.mean() < _BLACK_DN and np.ptp(blocks) < _FEATURELESS_DN)
