"""Where the stripe may be: the highest maxima of two matched filters on every line of a frame.

The filters run on a lattice of 2 px: sums of two neighbouring samples, or the samples themselves where they are 2 px
apart. A triangle over three lattice points (weights 1, 2, 1) is within a few per cent of the matched filter of stripes
between 1 and 2 px; the sum of three triangles is within a few per cent of those between 2.5 and 6 px. A line's
candidates are the highest maxima of the larger of the two, each with the zone around it that belongs to it.

It is written for XLA, which makes fast code of elementwise operations over long rows and of nothing else, not even of
reductions: two samples are added inside the 16-bit word that they share; the maximum along a line is folded, slice onto
slice of it, where the best two of up to 16 points, a comb with wide gaps, are kept; and the lattice at the borders,
which filters reach beyond, is a small array of its own, so that no padding copies the frame.
"""

import functools
import operator
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Bool, Float, Int, Int16, UInt8

from jaxscan.geometry import Array
from jaxscan.memory import folded, in_blocks, kept
from jaxscan.stripes.planes import Plane


CANDIDATES = 3
"""Candidates of a line."""
LATTICE_PX = 2
"""Spacing of the points on which candidates are searched [px]."""
WINDOW = 24
"""Samples of a fit's window."""
COARSE_NORM = np.sqrt(22.0)
"""Root sum of squares of the wide filter's weights on the lattice."""
_FINE_SHIFT = 3
"""2 - 1 / 8 brings the fine filter's response to the noise of the coarse one's, within 2 %."""
_HALF_SPAN = 12
"""Lattice points on either side of a maximum in which its extent is measured."""
_ZONE_SPAN = 24
"""Lattice points on either side of a maximum that may belong to it."""
_BIN_EXTENT_PX = 13.0
"""Extent from which two samples of a window are taken as one [px]."""
_FLANK_GAP = 4
_TEETH = 16
"""Points of a comb; the number of one takes four bits of a key."""
_MARGIN = 3
"""Lattice points that the filters reach to either side."""
TOGETHER = 5
"""Lines of a sum."""
_CLEARER = 1.5
"""Threshold of half a sum in that of a line: its noise is 1.12 times that of a line, and of many lines without a stripe
none may be found by chance [1]."""


class Peaks(NamedTuple):
    """Candidates of one frame, the highest of each line first."""

    exists: Bool[Array, "candidates lines"]
    at: Float[Array, "candidates lines"]
    """Centre, from the line's first sample [px]."""
    extent: Float[Array, "candidates lines"]
    """Distance between the half-maximum points, widened by the filter [px]."""
    first: Int[Array, "candidates lines"]
    """First sample of the window for the fit; may lie outside the line."""
    bins: Int[Array, "candidates lines"]
    """Neighbouring samples that are taken as one."""
    height: Float[Array, "candidates lines"]
    """Response over the threshold [1]."""


def find_peaks(
    on: Plane,
    off: Plane | None,
    lamp_ratio: Float[Array, ""],
    low: Int[Array, " lines"],
    high: Int[Array, " lines"],
    thresholds: Int16[Array, "256"],
    *,
    pitch: int,
    together: Bool[Array, ""] | None = None,
    wanted: Bool[Array, " lines"] | None = None,
) -> Peaks:
    """The candidates of a frame.

    Args:
        off: The same with the laser off. Without it the level of both sides of a maximum is subtracted, the higher of
            the two, so that no edge wins.
        low: First sample of each line that may hold the stripe.
        high: The sample behind the last one; a line whose `high` is not above `low` has no candidate.
        thresholds: Smallest response of a candidate by the level of the room around it.
        pitch: Distance between samples [px], 1 or 2.
        together: Whether one candidate is looked for in the sum of `TOGETHER` lines around each, above its mean: over
            several lines the laser's stray light is no noise.
        wanted: Lines on which candidates are looked for; all where not given.

    Raises:
        ValueError: If a line has more samples than the search can count.
    """
    each = LATTICE_PX // pitch
    points = on.samples.shape[1] // each
    if points > _LAST:
        raise ValueError(f"A line may have up to {_LAST * each} samples, got {on.samples.shape[1]}.")
    begin, end = low // each, jnp.minimum(-(-high // each), points)
    point = jnp.arange(points, dtype=jnp.int16)[None]
    inside = (point >= begin.astype(jnp.int16)[:, None]) & (point < end.astype(jnp.int16)[:, None])
    level = _lattice(on.samples, pitch)
    if off is not None:
        room = _lattice(off.samples, pitch)
        level = level - room - _brighter(room, lamp_ratio)
    lattice = jnp.where(inside, level, jnp.int16(0))
    lines: Array | float = 1.0
    thresholds = jnp.asarray(thresholds)
    wanted = (jnp.asarray(high) > 0) if wanted is None else wanted & (jnp.asarray(high) > 0)
    if together is not None:
        lattice = lax.cond(together, lambda one: _together(one, inside, off is not None), lambda one: one, lattice)
        lines = jnp.where(together, TOGETHER / 2, 1.0).astype(jnp.float32)
        raised = jnp.where(together, _CLEARER, 1.0).astype(jnp.float32) * thresholds.astype(jnp.float32)
        thresholds = raised.astype(jnp.int16)
    ground = _surround(lattice) if off is None else None
    some = jnp.any(wanted)

    def bases(at: Array) -> tuple[Array, Array]:
        """The ground under a point of every line, and the threshold there."""
        base = jnp.zeros(()) if ground is None else jnp.take_along_axis(ground, at[:, None], 1)[:, 0]
        level = (
            _level(off, each, at)
            if off is not None
            else (base.astype(jnp.float32) / (8 * each * lines)).astype(jnp.int32)
        )
        return base, thresholds[level]

    def measured(line: Array, at: Array, base: Array, threshold: Array) -> tuple[Array, ...]:
        """A maximum over the threshold, its extent to both sides and the ends of its zone."""
        around = kept(some, _around, lattice, line, at)
        count = len(around) - 2 * _MARGIN
        fine, response = _filters(
            lambda k: around[_MARGIN + k : _MARGIN + k + count], None if ground is None else base[None]
        )
        half = [_half_distance(fine, side) for side in (-1, 1)]
        zone = [_zone_steps(response, threshold, side) for side in (-1, 1)]
        height = response[_ZONE_SPAN + 1].astype(jnp.float32) / threshold.astype(jnp.float32)
        return height, *half, at - zone[0], at + zone[1]

    def rank(keys, _):
        """The highest maximum that is left on every line, and what is left without its zone."""
        key = folded(jnp.maximum, keys)
        at = _LAST - (key & _LAST)
        base, threshold = kept(some, bases, at)
        may = wanted & (2 * (key >> _INDEX_BITS) + 1 >= threshold.astype(jnp.int32))
        of = lambda line: (at[line], base if base.ndim == 0 else base[line], threshold[line])
        height, before, after, first, last = in_blocks(may, lambda line, _: measured(line, *of(line)))
        # A maximum that is too low where it lies may hide a lower one in a darker place; of it the filters' reach goes.
        first, last = jnp.where(may, first, at - _MARGIN - 1), jnp.where(may, last, at + _MARGIN + 1)
        place = _LAST - (keys & _LAST)
        left = jnp.where((place <= first[None]) | (place >= last[None]), keys, 0)
        centre = LATTICE_PX * (at.astype(jnp.float32) + 0.5 * (after - before)) + (0.5 if pitch == 1 else 0.0)
        return left, (height, centre, LATTICE_PX * (before + after))

    _, (height, at, extent) = lax.scan(rank, _keys(lattice, ground, some), length=CANDIDATES)
    bins = jnp.where((extent > _BIN_EXTENT_PX) & (pitch == 1), 2, 1).astype(jnp.int32)
    first = jnp.floor(at / pitch + 0.5).astype(jnp.int32) - bins * (WINDOW // 2)
    exists = height >= 1.0
    if together is not None:
        exists = exists & (~together | (jnp.arange(CANDIDATES)[:, None] == 0))
    return Peaks(exists, at, extent, first, bins, height)


_INDEX_BITS = 13
_LAST = (1 << _INDEX_BITS) - 1
"""The last point that a line can have. The lower bits of a key say how far from it a point is, the upper ones are half
of its response: of equal responses the first wins."""


def _lattice(frame: UInt8[Array, "lines samples"], pitch: int) -> Int16[Array, "lines points"]:
    if pitch == 2:
        return frame.astype(jnp.int16)
    pairs = frame.shape[1] // 2
    words = lax.bitcast_convert_type(frame[:, : 2 * pairs].reshape(-1, pairs, 2), jnp.uint16)
    return ((words & 255) + (words >> 8)).astype(jnp.int16)


def _together(
    lattice: Int16[Array, "lines points"], inside: Bool[Array, "lines points"], level: bool
) -> Int16[Array, "lines points"]:
    """Half the sum of `TOGETHER` lines, none of them beyond the image; with `level` that of the line is subtracted."""
    side, lines = TOGETHER // 2, lattice.shape[0]
    wide = jnp.pad(lattice, ((side, side), (0, 0)))
    total = functools.reduce(operator.add, [wide[k : k + lines] for k in range(TOGETHER)]) >> 1
    if not level:
        return total
    count = jnp.maximum(jnp.sum(inside, 1, dtype=jnp.int32), 1)
    mean = jnp.sum(jnp.where(inside, total, jnp.int16(0)), 1, dtype=jnp.int32) // count
    return jnp.where(inside, total - mean.astype(jnp.int16)[:, None], jnp.int16(0))


def _brighter(room: Int16[Array, "lines points"], ratio: Float[Array, ""]) -> Int16[Array, "lines points"]:
    """What the lamps add to the laser-off level, in 1/128 of it; ratios from 0.5 to 1.5 stay within 16 bits."""
    more = jnp.clip(jnp.round(128.0 * ratio) - 128.0, -64, 64).astype(jnp.int16)
    return (room * more + 64) >> 7


def _filters(at, ground: Array | None) -> tuple[Array, Array]:
    """The fine filter, and the larger of both above the ground.

    Args:
        at: Gives the lattice so many points away.
        ground: Sums of eight points: a constant level answers 15 / 8 of them in the one filter, 12 / 8 in the other.
    """
    fine = at(-1) + 2 * at(0) + at(1)
    coarse = at(-3) + at(3) + 2 * (at(-2) + at(-1) + at(0) + at(1) + at(2))
    scaled = 2 * fine - (fine >> _FINE_SHIFT)
    if ground is None:
        return fine, jnp.maximum(scaled, coarse)
    low, high = ((15 * ground) >> 4).astype(jnp.int16), ((3 * ground) >> 1).astype(jnp.int16)
    return fine - (ground >> 1).astype(jnp.int16), jnp.maximum(scaled - low, coarse - high)


def _respond(lattice: Int16[Array, "lines points"], ground: Array | None) -> Int16[Array, "lines n"]:
    """The response at all points but `_MARGIN` on either side."""
    count = lattice.shape[1] - 2 * _MARGIN
    level = None if ground is None else ground[:, _MARGIN : _MARGIN + count]
    return _filters(lambda k: lattice[:, _MARGIN + k : _MARGIN + k + count], level)[1]


def _keys(
    lattice: Int16[Array, "lines points"], ground: Array | None, some: Bool[Array, ""]
) -> Int[Array, "keys lines"]:
    """Keys of the best two points of every comb, and of all points near the borders, which the combs leave out."""
    points = lattice.shape[1]
    # A multiple of 16 columns, or vectors do not fill: a third slower; and so wide that one stripe's zone has no two
    # points of a comb.
    width = max(2 * _ZONE_SPAN, 16 * -(-(points - 2 * _MARGIN) // (16 * _TEETH)))
    teeth = (points - 2 * _MARGIN) // width
    if teeth == 0:
        return _border(lattice, ground, 0, points).T
    inner = np.s_[:, : width * teeth + 2 * _MARGIN]
    half = jnp.clip(_respond(lattice[inner], None if ground is None else ground[inner]) >> 1, 0, 4095).astype(
        jnp.uint16
    )
    numbered = [(half[:, i * width : (i + 1) * width] << 4) | jnp.uint16(_TEETH - 1 - i) for i in range(teeth)]
    ranked: list[tuple[Array, Array | None]] = [(key, None) for key in numbered]
    while len(ranked) > 1:
        ranked = [_best_two(*ranked[i : i + 2]) for i in range(0, len(ranked), 2)]
    # In one word, so that one loop over the frame makes both.
    best, second = (jnp.zeros((), jnp.int32) if key is None else key.astype(jnp.int32) for key in ranked[0])
    borders = [_border(lattice, ground, 0, 16), _border(lattice, ground, width * teeth + _MARGIN, points)]
    # Lines last: a maximum over the leading axis is fast code.
    turned = lambda fields: tuple(field.T for field in fields)
    together = lambda fields: jnp.concatenate([_decoded(fields[0] >> 16), _decoded(fields[0] & 0xFFFF), *fields[1:]])
    return kept(some, together, kept(some, turned, (best << 16 | second, *borders)))


def _decoded(comb: Int[Array, "columns lines"]) -> Int[Array, "columns lines"]:
    """The keys of points of combs."""
    width = comb.shape[0]
    column = jnp.arange(width, dtype=jnp.int32)[:, None]
    tooth = _TEETH - 1 - (comb & (_TEETH - 1))
    return _key((comb >> 4) & 0xFFF, _MARGIN + tooth * width + column)


def _best_two(one: tuple[Array, Array | None], other: tuple[Array, Array | None] | None = None) -> tuple:
    """The best two of what two slices have."""
    if other is None:
        return one
    seconds = [second for second in (one[1], other[1]) if second is not None]
    return jnp.maximum(one[0], other[0]), functools.reduce(jnp.maximum, seconds, jnp.minimum(one[0], other[0]))


def _key(half: Int[Array, "lines n"], place: Int[Array, "#lines n"]) -> Int[Array, "lines n"]:
    return jnp.where(half > 0, half * (_LAST + 1) + (_LAST - place), 0)


def _border(lattice: Array, ground: Array | None, first: int, last: int) -> Int[Array, "lines n"]:
    """Keys of some points, of which the filters may reach beyond the line."""
    points = lattice.shape[1]
    before, behind = max(first - _MARGIN, 0), min(last + _MARGIN, points)
    room = ((0, 0), (_MARGIN - (first - before), _MARGIN - (behind - last)))
    cut = lambda field: jnp.pad(field[:, before:behind], room)
    half = jnp.clip(_respond(cut(lattice), None if ground is None else cut(ground)) >> 1, 0, 4095).astype(jnp.int32)
    return _key(half, jnp.arange(first, last, dtype=jnp.int32)[None])


def _level(off: Plane, each: int, at: Int[Array, " lines"]) -> Int[Array, " lines"]:
    """Mean level around a lattice point of every line."""
    line = jnp.arange(len(at), dtype=jnp.int32)
    away = range(-8, 9, 2)
    levels = [off.at(line, jnp.clip(each * at + k, 0, off.samples.shape[1] - 1)).astype(jnp.int32) for k in away]
    return functools.reduce(operator.add, levels) // len(away)


def _around(
    lattice: Int16[Array, "lines points"], line: Int[Array, " n"], at: Int[Array, " n"]
) -> Int16[Array, "around n"]:
    """The lattice around points of some lines; 0 beyond it, as it is beyond what is searched."""
    points = lattice.shape[1]
    place = at[None] + np.arange(-_ZONE_SPAN - 1 - _MARGIN, _ZONE_SPAN + 2 + _MARGIN, dtype=np.int32)[:, None]
    flat = points * line[None] + jnp.clip(place, 0, points - 1)
    found = jnp.asarray(lattice).reshape(-1).at[flat].get(mode="promise_in_bounds")
    return jnp.where((place >= 0) & (place < points), found, jnp.int16(0))


def _surround(lattice: Int16[Array, "lines points"]) -> Int[Array, "lines points"]:
    """The higher of the levels on both sides, summed over eight points."""
    left, right = _FLANK_GAP + 7, _FLANK_GAP
    points = lattice.shape[1]
    # Beyond the image its last level goes on, or the image's border would be an edge.
    flank = jnp.pad(lattice.astype(jnp.int32), ((0, 0), (left, right + 7)), mode="edge")
    for distance in (1, 2, 4):
        flank = flank[:, :-distance] + flank[:, distance:]
    # Point k of `flank` now holds 8 points from k - left on.
    return jnp.maximum(flank[:, :points], flank[:, left + right : left + right + points])


def _zone_steps(
    response: Int16[Array, "around lines"], threshold: Int16[Array, " lines"], side: int
) -> Int[Array, " lines"]:
    """Steps to the first point on one side that does not belong to the maximum any more."""
    middle = _ZONE_SPAN + 1
    peak, floor = response[middle], threshold // jnp.int16(2)
    rise, lowest = jnp.maximum(floor, peak >> 2), peak
    steps, goes_on = jnp.ones_like(peak), jnp.ones(peak.shape, jnp.bool_)
    for step in range(1, _ZONE_SPAN + 1):
        value = response[middle + side * step]
        goes_on &= (value >= floor) & (value < lowest + rise)
        steps += goes_on.astype(jnp.int16)
        lowest = jnp.minimum(lowest, value)
    return steps.astype(jnp.int32)


def _half_distance(fine: Int16[Array, "around lines"], side: int) -> Float[Array, " lines"]:
    """Distance to half of the fine filter's maximum above the ground [lattice points]."""
    middle = _ZONE_SPAN + 1
    peak = fine[middle]
    inner, outer, steps = peak, peak, jnp.zeros_like(peak)
    goes_on = jnp.ones(peak.shape, jnp.bool_)
    for step in range(1, _HALF_SPAN + 1):
        value = fine[middle + side * step]
        inner, outer = jnp.where(goes_on, outer, inner), jnp.where(goes_on, value, outer)
        steps += goes_on.astype(jnp.int16)
        goes_on &= 2 * value >= peak
    drop = (2 * jnp.maximum(inner - outer, jnp.int16(1))).astype(jnp.float32)
    fraction = jnp.clip((2 * inner - peak).astype(jnp.float32) / drop, 0.0, 1.0)
    return steps.astype(jnp.float32) - 1.0 + fraction
