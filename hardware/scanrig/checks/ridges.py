"""Where a thin bright line runs through a picture, line by line, and how sure that is."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int


CORE = 3
"""Samples that a ridge is summed over: the middle of a laser's line."""
FLANK = 9
"""Samples on either side that it has to stand out from."""
GAP = 8
"""From the middle of the core to the middle of a flank [samples]."""
COARSE = 4
"""Samples that are added up for the second look, which finds wide, glowing and clipped lines."""
Z = 4.0
"""Standard deviations from which a ridge counts. Of lines of 1280 samples of noise 4 in 100 have one, but at a place of
its own: only ridges with company count (`coherent`), by chance one line in a million."""
OTHERS = 0.5
"""Part of a ridge's height that another ridge of its line, or a furrow, may have at most: texture, motion and uneven
flicker make many of them, of both signs; a laser makes one, and light only."""
_AROUND = 24
"""Samples around a ridge in which there is no other."""
_REACH = 3
"""Lines on either side among which a ridge looks for company."""
_SLOPE = 8.0
"""Samples per line that a ridge may lean by: with 4 lines added up, 63 degrees."""
_ROUNDING = (CORE + CORE**2 / FLANK / 2.0) * 2.0 / 12.0
"""Variance of a height that the rounding of two frames leaves. Noise counts as no less: where it is, single counts
are most of it, and those are not Gaussian."""
_MEASURABLE = (1.0, 240.0)
"""Levels at which noise is not cut off at zero or at the top [DN, one sample]."""
_NORMAL = 0.6745
_BINS = 8
_ENOUGH = 200
"""Samples that a bin of levels needs to tell its noise to 5 %."""
_PLENTY = 0.5
"""Part of the lines with a clear ridge from which on no second look is needed."""


class Ridges(NamedTuple):
    """The best ridge of each line."""

    at: Int[np.ndarray, " lines"]
    """Its middle [samples]."""
    z: Float[np.ndarray, " lines"]
    """Its height above the higher of its flanks, in standard deviations."""
    seen: Bool[np.ndarray, " lines"]
    """It stands out, and has company on the neighbouring lines."""
    clear: Bool[np.ndarray, " lines"]
    """It is seen, and no other ridge and no furrow of its line comes near it."""

    @property
    def strength(self) -> float:
        """Height of all that are seen together, in standard deviations."""
        return float(self.z[self.seen].sum())


class Relief(NamedTuple):
    """What stands out of a field, and what lies below it."""

    ridges: Ridges
    furrows: Ridges


def find_ridges(field: Float[np.ndarray, "lines samples"], level: Float[np.ndarray, "lines samples"]) -> Relief:
    """The line that brightens a field, and the line that darkens it, at two scales.

    Args:
        field: What is searched, float32: the difference of two frames, or a frame.
        level: The light that its noise depends on, float32.
    """
    fine = _at_scale(field, level, 1)
    if fine.ridges.clear.mean() > _PLENTY or field.shape[1] < COARSE * (2 * GAP + FLANK + 2):
        return fine
    coarse = _at_scale(_coarse(field), _coarse(level), COARSE)
    # One look for the whole frame, so that company is measured alike.
    return coarse if _clear(coarse) > 1.5 * _clear(fine) else fine


def _clear(relief: Relief) -> int:
    return max(int(np.count_nonzero(one.clear)) for one in relief)


def _coarse(field: Float[np.ndarray, "lines samples"]) -> Float[np.ndarray, "lines fewer"]:
    kept = field.shape[1] // COARSE * COARSE
    total = field[:, 0:kept:COARSE].copy()
    for k in range(1, COARSE):
        total += field[:, k:kept:COARSE]
    return total


def heights(field: Float[np.ndarray, "lines samples"], at: Int[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Height of a field at one place of each of its lines above the mean of both flanks, per sample of the core."""
    half, x = FLANK // 2, np.arange(field.shape[1], dtype=np.int64)
    rows = np.arange(len(at))[:, None]

    def mean(middle: Int[np.ndarray, " n"], reach: int) -> Float[np.ndarray, " n"]:
        offsets = np.arange(-reach, reach + 1)
        return field[rows, np.clip(middle[:, None] + offsets, 0, x[-1])].mean(1)

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
    """Where each line is highest, how high, and how high elsewhere; changes the response."""
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
    """Chosen lines with two others nearby, at places that one line can lead through."""
    company = np.zeros(len(at), np.int8)
    for step in range(1, min(_REACH, len(at) - 1) + 1):
        near = chosen[step:] & chosen[:-step] & (np.abs(at[step:] - at[:-step]) <= slope * step)
        company[step:] += near
        company[:-step] += near
    return chosen & (company >= 2)


def _core_and_flanks(field: Float[np.ndarray, "lines samples"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sum of the core, and the flanks left and right as sums of as many samples, where all three are inside."""
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
    """One over the standard deviation of a ridge's height: of its variance the middle half, a line over the level.

    From the heights themselves, so that whatever is everywhere - noise of neighbours that is alike, texture under
    uneven flicker - is what a line has to stand out from.
    """
    # Every third sample: neighbours share their sums.
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
        # A variance is as uncertain as it is large.
        weight = np.sqrt([len(bins[k]) for k in known]) / (np.array(variance) + _ROUNDING * scale)
        slope, start = (float(a) for a in np.polyfit(centres[known], variance, 1, w=weight))
        slope = max(slope, 0.0)
    model = level * np.float32(slope)
    model += np.float32(start)
    np.maximum(model, np.float32(_ROUNDING * scale), out=model)
    np.sqrt(model, out=model)
    return np.divide(np.float32(1.0), model, out=model)


def _variance(size: Float[np.ndarray, " n"]) -> float:
    """Variance of the bulk of some heights, from their absolute values; a quantile alone would be of whole counts."""
    variance = (float(np.median(size)) / _NORMAL) ** 2 + _ROUNDING
    square = size * size
    for _ in range(2):
        # What lies within 3 standard deviations has 0.973 of the variance.
        variance = float(square[square <= 9.0 * variance].mean()) / 0.973
    return variance
