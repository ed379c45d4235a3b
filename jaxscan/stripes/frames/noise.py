"""Noise of a frame from the frames themselves, by photon transfer: the line of the noise over the level."""

import numpy as np
from jaxtyping import Bool, Float, Int, Int16, UInt8

from jaxscan.geometry import Array
from jaxscan.stripes.frames.formats import LaserLine, PixelFormat, Response, decode_table, laser_plane
from jaxscan.stripes.stripes import NoiseModel


Codes = UInt8[np.ndarray, "lines n"]
Lines = Int16[np.ndarray, "lines n"]
Level = Float[np.ndarray, "256"]
Noise = tuple[Int16[np.ndarray, " m"], Int16[np.ndarray, " m"]]
Counts = Int[np.ndarray, "bins values"]
PerBin = Float[np.ndarray, " bins"]

_LINE = LaserLine()
_FRAMES = 4
_SAMPLES = 1 << 18
"""Samples that are looked at, of all frames together: half a per cent of a variance, in some milliseconds."""
UNITS = 8
"""Steps per DN of the integers that are counted: their rounding adds 0.1 % of a variance of 1 DN^2."""
_BIN_DN = 8
_BINS = 256 // _BIN_DN
_BIN_STEPS = 4 * UNITS * _BIN_DN
"""Width of a bin for levels that are sums of four samples."""
_REACH = 1024
"""Steps on either side of zero that are counted apart; larger values are no noise."""
_LAG = 8
"""Distance of the samples that are compared: noise of neighbours is alike in compressed or
demosaiced pictures."""
_BOX = 5
"""Samples over which differences are added up to find places that stand out."""
_OUTSTANDING = 5.0
"""Robust standard deviations of such a sum from which on it is no noise."""
_MARGIN = 24
"""Samples on either side of such a place that are left out too: the foot of a stripe."""
_EDGE_DN = 10
"""Steps of the scene from which the flicker of its light is learned."""
_MIN_COUNT = 200
_MIN_SHARE = 0.01
"""Share of the samples below which a level is not believed: only a rest of reflections, or an
object that moved, may have it."""
_DARK_DN = 3.0
"""Below this level the noise is cut off at zero."""
_BRIGHT_DN = 240.0
"""Above this level the noise is cut off at the top."""
_CLIPPED = 254
"""Code from which on a sample is clipped."""
_MIN_READ_DN = 0.2
_MIN_GAIN = 0.5
"""No sensor whose full scale is 255 DN has fewer electrons per DN: its whole well would be 130."""
_MIN_SPAN_DN = 10.0
"""Range of levels from which the gain can be told."""
_SEEN = 5.0
"""Standard deviations from which a slope is seen."""


def estimate_noise(
    on: Array,
    off: Array | None = None,
    *,
    pixel_format: PixelFormat = "mono8",
    response: Response = "linear",
    line: LaserLine = _LINE,
) -> NoiseModel:
    r"""Read noise and conversion gain from pairs of frames.

    Away from all stripes the difference of a pair varies by

    $$\mathrm{var} = 2\,\mathrm{read}^2 + 2\,\mathrm{level}/K + 2/12,$$

    a straight line over the level. Samples a few pixels apart are compared, so that scattered
    light, which is smooth, cancels; the laser-off frame is scaled by the flicker of its light.
    Places that stand out (the stripe, its reflections, moved objects) are left out with a margin.
    Without laser-off frames the second difference along a line takes the place of the pair; fine
    texture then counts as noise.

    Args:
        on: Laser-on frames, uint8 [frames, rows, columns] (rgb8: and 3).
        off: Laser-off frames of the same shape, or None.
        response: "linear", "srgb" or "gamma 2.2".
        line: The laser, which says which channel is looked at.

    Returns:
        The model, in linear DN. Where the frames do not tell one of its numbers (all of one
        level, or all dark), that number is the default of `NoiseModel`; at the levels that were
        seen the sum of both holds nevertheless.

    Source:
        J. R. Janesick, Photon Transfer, 2007, chapter 5.
    """
    return photon_transfer(*photon_points(on, off, pixel_format=pixel_format, response=response, line=line))[0]


def photon_points(
    on: Array, off: Array | None, *, pixel_format: PixelFormat, response: Response, line: LaserLine
) -> tuple[PerBin, PerBin, PerBin]:
    """Levels that the frames show, twice the variance of a frame there, and its standard deviation [DN, DN^2]."""
    chosen = np.unique(np.linspace(0, len(on) - 1, _FRAMES).astype(int))
    lines = lambda frames, i: _lines(frames[i : i + 1], pixel_format, line, _SAMPLES // len(chosen))
    table, slope = decode_table(response)
    counts, sums = np.zeros((_BINS, 2 * _REACH), np.int64), np.zeros(_BINS)
    for i in chosen:
        if off is None:
            found = _second_differences(lines(on, i), table)
        else:
            found = _pair_differences(lines(on, i), lines(off, i), table)
        noise, level = found
        counts += _histogram(noise, level)
        sums += np.bincount(level // _BIN_STEPS, level, minlength=_BINS)
    steps = np.sqrt(2.0 if off is not None else 3.0) * UNITS
    return _points(counts, sums / (4 * UNITS), np.arange(-_REACH, _REACH) / steps, table, slope)


def _lines(frames: Array, pixel_format: PixelFormat, line: LaserLine, samples: int) -> Codes:
    plane = np.asarray(laser_plane(np.asarray(frames), pixel_format=pixel_format, line=line))[0]
    # An odd stride: the two kinds of lines of a Bayer tile stay balanced.
    return np.ascontiguousarray(plane[:: max(1, plane.size // samples) | 1])


def _pair_differences(on: Codes, off: Codes, table: Level) -> Noise:
    """Noise of twice a frame's variance [sqrt(2) steps], and its level [1/32 DN]."""
    if on.shape[1] <= _LAG + 2 * _BOX:
        return _NOTHING
    fixed = np.rint(UNITS * table).astype(np.int16)
    room = fixed[off]
    flicker = flicker_of(fixed[on], room)
    # Divided so that the variance of the difference is that of a pair without flicker.
    scaled = table * UNITS / np.sqrt(0.5 * (1.0 + flicker**2))
    difference = np.rint(scaled).astype(np.int16)[on] - np.rint(flicker * scaled).astype(np.int16)[off]
    kept = ~_standing_out(difference, 2 * room) & (on < _CLIPPED) & (off < _CLIPPED)
    level = _pair_sums(fixed[on] + room)
    kept = kept[:, _LAG:] & kept[:, :-_LAG] & _measurable(level)
    return _steps(difference)[kept], level[kept]


def _second_differences(on: Codes, table: Level) -> Noise:
    """Noise of twice a frame's variance [sqrt(3) steps], and its level [1/32 DN]."""
    if on.shape[1] <= _LAG + 2 * _BOX:
        return _NOTHING
    value = np.rint(UNITS * table).astype(np.int16)[on]
    kept = ~_standing_out(value, 2 * value) & (on < _CLIPPED)
    noise = value[:, 1:-3] - 2 * value[:, 2:-2] + value[:, 3:-1]
    # The level from samples that are not in the difference, or noise would choose its level.
    level = 2 * (value[:, :-4] + value[:, 4:])
    inside = kept[:, 2:-2] & _measurable(level)
    return noise[inside], level[inside]


_NOTHING = (np.zeros(0, np.int16), np.zeros(0, np.int16))


def _steps(a: Lines) -> Int16[np.ndarray, "lines m"]:
    return a[:, _LAG:] - a[:, :-_LAG]


def _pair_sums(a: Lines) -> Int16[np.ndarray, "lines m"]:
    return a[:, _LAG:] + a[:, :-_LAG]


def _measurable(level: Lines) -> Bool[np.ndarray, "lines n"]:
    return (level > int(4 * UNITS * _DARK_DN)) & (level < int(4 * UNITS * _BRIGHT_DN))


def flicker_of(on: Lines, off: Lines) -> float:
    """How much brighter the scene is in the laser-on frame: the median over its edges.

    Edges, because scattered light adds to the levels and not to them.
    """
    step_on, step_off = _steps(on), _steps(off)
    # Both: at the edges of a stripe only one of them is steep.
    steep = np.minimum(np.abs(step_on), np.abs(step_off)) > _EDGE_DN * UNITS
    if np.count_nonzero(steep) < _MIN_COUNT:
        return 1.0
    one, other = step_on[steep].astype(np.float32), step_off[steep].astype(np.float32)
    # Difference over sum, not a ratio: noise of either then counts alike and gives no bias.
    asymmetry = np.median((one - other) / np.where(one + other == 0, np.inf, one + other))
    return float(np.clip((1.0 + asymmetry) / (1.0 - asymmetry), 0.5, 2.0)) if asymmetry < 1.0 else 1.0


def _standing_out(difference: Lines, level: Lines) -> Bool[np.ndarray, "lines n"]:
    """True near each line's brightest place, and wherever a short sum is no noise of its level [1/16 DN]."""
    samples = difference.shape[1]
    box = sum((difference[:, k : samples - _BOX + 1 + k] for k in range(1, _BOX)), difference[:, : samples - _BOX + 1])
    step, half = _steps(box) // UNITS, _BOX // 2
    level = _pair_sums(level)[:, half:-half]
    middle, deviation = _centre_and_scale(_histogram(step, level))
    # The limit depends on the level of the scene: at levels that only stripes have, they would pass for noise.
    bin_of = level // _BIN_STEPS
    limit = _OUTSTANDING * np.maximum(deviation, 1.0)
    low, high = (np.clip(middle + sign * limit, -30000, 30000).astype(np.int16)[bin_of] for sign in (-1, 1))
    outstanding = (step < low) | (step > high)
    out = np.zeros(difference.shape, bool)
    out[:, half : -_LAG - half] |= outstanding
    out[:, _LAG + half : -half] |= outstanding
    out[np.arange(len(out)), np.argmax(box, 1) + half] = True
    before = np.cumsum(np.pad(out, ((0, 0), (_MARGIN + 1, _MARGIN))), 1, dtype=np.int32)
    return before[:, 2 * _MARGIN + 1 :] > before[:, : -2 * _MARGIN - 1]


def _histogram(value: Int16[np.ndarray, "*n"], level: Int16[np.ndarray, "*n"]) -> Counts:
    """How often each value occurs in each bin of the level [1/32 DN]."""
    row = level.astype(np.intp) // _BIN_STEPS
    place = row * (2 * _REACH) + np.clip(value, -_REACH, _REACH - 1) + _REACH
    return np.bincount(place.ravel(), minlength=_BINS * 2 * _REACH).reshape(_BINS, 2 * _REACH)


def _centre_and_scale(counts: Counts) -> tuple[PerBin, PerBin]:
    """Median and standard deviation of each row by its quartiles [steps]: up to half may be no noise."""
    upto = np.cumsum(counts, 1)
    low, middle, high = ((upto < share * upto[:, -1:]).sum(1) for share in (0.25, 0.5, 0.75))
    return middle.astype(np.float64) - _REACH, (high - low) / 1.349


def _points(
    counts: Counts, sums: PerBin, value: Float[np.ndarray, " values"], table: Level, slope: Level
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Level, variance without rounding, and its standard deviation, for each well filled bin."""
    total = counts.sum(1)
    filled = total >= max(_MIN_COUNT, _MIN_SHARE * total.sum())
    level = sums[filled] / total[filled]
    variance, count = _clipped_variances(counts[filled], value)
    rounding = 2.0 / 12.0 * np.interp(level, table, slope**2)
    return level, variance - rounding, np.maximum(np.sqrt(2.0 / count) * variance, 1e-3)


def _clipped_variances(counts: Counts, value: Float[np.ndarray, " values"]) -> tuple[PerBin, PerBin]:
    """Variance of the values within 4 standard deviations, by iteration from quantiles, and their number."""
    step = value[1] - value[0]
    middle, deviation = (step * a for a in _centre_and_scale(counts))
    deviation = np.maximum(deviation, 0.5)
    for _ in range(5):
        offset = value - middle[:, None]
        kept = np.where(np.abs(offset) <= 4.0 * deviation[:, None], counts, 0)
        count = kept.sum(1)
        mean = (kept * offset).sum(1) / count
        deviation = np.maximum(np.sqrt((kept * offset**2).sum(1) / count - mean**2), 0.1)
        middle = middle + mean
    return deviation**2, count.astype(np.float64)


def free_line(level: PerBin, variance: PerBin, sigma: PerBin) -> tuple[float, float, float] | None:
    """The line through the bins, wherever it starts: twice the variance of a frame at level 0, below 0 where there is a
    black level, its growth per level, and the standard deviation of the first; None where no slope is seen."""
    if len(level) < 2 or np.ptp(level) < _MIN_SPAN_DN:
        return None
    weight = 1.0 / sigma**2
    centre, mean, spread, slope = _line(level, variance, weight)
    if not _SEEN / np.sqrt(spread) < slope <= 2.0 / _MIN_GAIN:
        return None
    return mean - slope * centre, slope, float(np.sqrt(1.0 / np.sum(weight) + centre**2 / spread))


def photon_transfer(
    level: PerBin, variance: PerBin, sigma: PerBin, *, black_dn: float = 0.0
) -> tuple[NoiseModel, bool]:
    """The noise of such points with a known black level, and whether they tell the gain."""
    default = NoiseModel(black_dn=black_dn)
    if len(level) == 0:
        return default, False
    # The black level is no light: it has no shot noise.
    level, weight, start = level - black_dn, 1.0 / sigma**2, 2.0 * _MIN_READ_DN**2
    centre, mean, spread, slope = _line(level, variance, weight)
    told = np.ptp(level) >= _MIN_SPAN_DN and slope * np.sqrt(spread) > _SEEN
    if told and mean - slope * centre < start:
        # So steep that it passes below the levels with the most samples: it starts at the least read noise, and has to
        # meet them.
        slope = float(np.sum(weight * level * (variance - start)) / np.sum(weight * level**2))
    told = told and 0.0 < slope <= 2.0 / _MIN_GAIN
    if told:
        gain = 2.0 / slope
    else:
        # One level tells a sum only: keep the default gain, unless it alone explains too much.
        shot = mean - start
        gain = max(default.electrons_per_dn, 2.0 * centre / shot) if shot > 0 else 1e6
    read = np.sqrt(max(0.5 * mean - centre / gain, _MIN_READ_DN**2))
    return NoiseModel(read_dn=float(read), electrons_per_dn=float(gain), black_dn=black_dn), bool(told)


def _line(level: PerBin, variance: PerBin, weight: PerBin) -> tuple[float, float, float, float]:
    """Mean level and variance of the bins, the weighted spread of their levels, and the slope of the line."""
    centre, mean = np.average(level, weights=weight), np.average(variance, weights=weight)
    spread = np.sum(weight * (level - centre) ** 2)
    slope = np.sum(weight * (level - centre) * variance) / max(spread, 1e-12)
    return float(centre), float(mean), float(spread), float(slope)
