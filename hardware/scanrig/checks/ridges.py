"""Finds a thin bright stripe in a frame, line by line, with its significance."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from scanrig.checks.frame_pair import median_of


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
    variance = (median_of(size) / _NORMAL) ** 2 + _ROUNDING
    square = size * size
    for _ in range(2):
        # Values within 3 standard deviations have 0.973 of the variance.
        variance = float(square[square <= 9.0 * variance].mean()) / 0.973
    return variance
