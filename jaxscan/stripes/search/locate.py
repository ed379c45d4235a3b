"""Where the stripe may be: the highest maxima of two matched filters on every line.

The filters run on a lattice of 2 px: sums of two neighbouring samples, or the samples themselves
where they are 2 px apart. A triangle over three lattice points (weights 1, 2, 1) is within a few
per cent of the matched filter of stripes between 1 and 2 px; the sum of three triangles is within
a few per cent of those between 2.5 and 6 px. A line's candidates are its highest maxima of the
larger of the two, each with the zone around it that belongs to it.

This is the reference; on a CPU `native.NativeLocator` computes the same, many times faster.
"""

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Int16

from jaxscan.geometry import Array
from jaxscan.stripes.search.candidates import (
    BIN_EXTENT_PX,
    CANDIDATES,
    FINE_SHIFT,
    HALF_SPAN,
    LATTICE_PX,
    NO_LEVEL,
    WIDE,
    ZONE_SPAN,
    Candidates,
    Located,
    fixed_point,
    reach,
)
from jaxscan.stripes.search.planes import Planes
from jaxscan.stripes.search.search import Search


_FLANK_GAP = 4
_NOTHING = -32768


def locate(planes: Planes, search: Search, *, pitch: int, saturation: int) -> Located:
    """Candidates of all lines, in one list of one block with a place for each.

    Args:
        planes: Samples of the laser's colour. Where there are none with the laser off, the level of both
            sides of a maximum is subtracted from it, the higher of the two, so that no edge wins.
        search: Where to look and from which response on; a line whose `high` is not above `low` is skipped.
        pitch: Distance between samples [px], 1 or 2.
        saturation: Codes from here on are clipped.

    Returns:
        Candidates with WIDE samples each.
    """

    levels = jnp.asarray(search.levels, jnp.float32)

    def of_frame(on, off, ratio):
        found = _of_frame(on, off, ratio, search, pitch)
        return found, _cut(on, off, found, pitch, levels, saturation)

    ratio = fixed_point(planes.lamp_ratio)
    (exists, at, extent, first, bins), cut = jax.vmap(of_frame)(planes.on, planes.off, ratio)
    saturated, level_on, level_off = cut
    middle = _middle(first, bins, pitch)

    def flat(values):
        return jnp.reshape(values, (1, -1))

    def windows(values):
        # [frames, samples, lines, rank] to [1, samples, candidates].
        return jnp.moveaxis(values, 1, 0).reshape(1, WIDE, -1)

    number = jnp.arange(exists.size, dtype=jnp.int32)
    found = Candidates(
        total=jnp.asarray(exists.size, jnp.int32),
        frame=(number // exists[0].size)[None, :],
        start=flat(at - middle),
        extent=flat(extent),
        middle=flat(middle),
        bins=flat(bins),
        saturated=flat(saturated),
        on=windows(level_on),
        off=None if level_off is None else windows(level_off),
    )
    return Located((found,), jnp.where(exists, number.reshape(exists.shape), -1))


def _of_frame(on, off, ratio, search, pitch):
    """Candidates of one frame's lines: whether, centre, extent, window's first sample, samples per bin."""
    samples = on.shape[1]
    per_point = LATTICE_PX // pitch
    points = samples // per_point
    begin, end = search.low // per_point, jnp.minimum(-(-search.high // per_point), points)
    point = jnp.arange(points, dtype=jnp.int32)[None, :]
    inside = (point >= begin[:, None]) & (point < end[:, None])
    lattice = jnp.where(inside, _lattice(on, off, ratio, pitch), 0).astype(jnp.int16)
    padded = jnp.pad(lattice, ((0, 0), (4, 4)))
    fine = padded[:, :-2] + 2 * padded[:, 1:-1] + padded[:, 2:]
    middle = fine[:, 3 : 3 + points]
    coarse = fine[:, 1 : 1 + points] + middle + fine[:, 5 : 5 + points]
    scaled = (2 * middle - (middle >> FINE_SHIFT)).astype(jnp.int32)
    coarse = coarse.astype(jnp.int32)
    ground: Array = jnp.zeros_like(scaled)
    if off is None:
        # A constant level answers 15 / 2 times itself in the one, 12 times in the other.
        level = _surround(lattice)
        scaled, coarse = scaled - ((15 * level) >> 4), coarse - ((3 * level) >> 1)
        ground = level >> 1
    response = jnp.where(inside, jnp.maximum(scaled, coarse), _NOTHING)
    dark = jnp.asarray(on if off is None else off).astype(jnp.int32)
    counted = jnp.repeat(inside, per_point, axis=1, total_repeat_length=points * per_point)
    total = jnp.sum(jnp.where(counted, dark[:, : points * per_point], 0), axis=1)
    mean = total // jnp.maximum(per_point * (end - begin), 1)
    threshold = jnp.asarray(search.thresholds)[mean].astype(jnp.int32)

    left = response
    fine = fine.astype(jnp.int32)
    kept, places, extents = [], [], []
    for _ in range(CANDIDATES):
        best = jnp.argmax(left, axis=1).astype(jnp.int32)
        peak = jnp.take_along_axis(left, best[:, None], axis=1)[:, 0]
        zone = [_zone_steps(left, best, side, threshold, (begin, end)) for side in (-1, 1)]
        base = jnp.take_along_axis(ground, best[:, None], axis=1)
        before, after = (_half_distance(fine, base, best + 3, begin + 3, end + 3, side) for side in (-1, 1))
        kept.append((peak >= threshold) & (end > begin))
        extents.append(2.0 * (before + after))
        centre = 2.0 * (best.astype(jnp.float32) + 0.5 * (after - before))
        places.append(centre + (0.5 if pitch == 1 else 0.0))
        taken = (point > (best - zone[0])[:, None]) & (point < (best + zone[1])[:, None])
        left = jnp.where(taken, _NOTHING, left)
    at, extent = jnp.stack(places, 1), jnp.stack(extents, 1)
    # Later maxima of a line without an earlier one are none either.
    exists = jnp.cumprod(jnp.stack(kept, 1).astype(jnp.int32), axis=1).astype(jnp.bool_)
    bins = jnp.where((extent > BIN_EXTENT_PX) & (pitch == 1), 2, 1).astype(jnp.int32)
    first = jnp.floor(at / pitch + 0.5).astype(jnp.int32) - bins * (WIDE // 2)
    return exists, at, extent, first, bins


def _lattice(on: Array, off: Array | None, ratio: Array, pitch: int) -> Int16[Array, "lines points"]:
    signal: Array = jnp.asarray(on).astype(jnp.int32)
    if off is not None:
        signal = signal - ((jnp.asarray(off).astype(jnp.int32) * ratio + 64) >> 7)
    signal = signal.astype(jnp.int16)
    if pitch == 2:
        return signal
    whole = signal[:, : signal.shape[1] // 2 * 2]
    return whole[:, 0::2] + whole[:, 1::2]


def _surround(lattice: Int16[Array, "lines points"]) -> Array:
    """The higher of the levels on both sides, summed over eight points."""
    left, right = _FLANK_GAP + 7, _FLANK_GAP
    points = lattice.shape[1]
    # Beyond the image its last level goes on, or the image's border would be an edge.
    flank = jnp.pad(lattice.astype(jnp.int32), ((0, 0), (left, right + 7)), mode="edge")
    for distance in (1, 2, 4):
        flank = flank[:, :-distance] + flank[:, distance:]
    # Point k of `flank` now holds 8 points from k - left on.
    return jnp.maximum(flank[:, :points], flank[:, left + right : left + right + points])


def _zone_steps(response, best, side, threshold, span):
    """Steps to the first point on one side that does not belong to the maximum any more."""
    begin, end = span
    peak = jnp.take_along_axis(response, best[:, None], axis=1)[:, 0]
    floor = threshold // 2
    rise = jnp.maximum(floor, peak // 4)
    step = jnp.arange(1, ZONE_SPAN + 2, dtype=jnp.int32)[None, :]
    point = best[:, None] + side * step
    outside = (point < begin[:, None]) | (point >= end[:, None])
    value = jnp.take_along_axis(response, jnp.clip(point, 0, response.shape[1] - 1), axis=1)
    lowest = lax.cummin(jnp.concatenate([peak[:, None], value], axis=1), axis=1)[:, :-1]
    ended = outside | (value < floor[:, None]) | (value >= lowest + rise[:, None]) | (step > ZONE_SPAN)
    return 1 + jnp.argmax(ended, axis=1).astype(jnp.int32)


def _half_distance(fine, ground, best, begin, end, side):
    """Distance to half of the fine filter's maximum above the ground [lattice points]."""
    step = jnp.arange(0, HALF_SPAN + 1, dtype=jnp.int32)[None, :]
    point = best[:, None] + side * step
    # The filter reaches one point beyond the lattice.
    outside = (point < begin[:, None] - 1) | (point > end[:, None])
    value = jnp.take_along_axis(fine, jnp.clip(point, 0, fine.shape[1] - 1), axis=1)
    value = jnp.where(outside, 0, value - ground)
    peak = value[:, :1]
    below = (2 * value < peak) | (step == HALF_SPAN)
    crossed = 1 + jnp.argmax(below[:, 1:], axis=1).astype(jnp.int32)[:, None]
    inner = jnp.take_along_axis(value, crossed - 1, axis=1)
    outer = jnp.take_along_axis(value, crossed, axis=1)
    drop = (2 * jnp.maximum(inner - outer, 1)).astype(jnp.float32)
    fraction = jnp.clip((2 * inner - peak).astype(jnp.float32) / drop, 0.0, 1.0)
    return ((crossed - 1).astype(jnp.float32) + fraction)[:, 0]


def _middle(first: Array, bins: Array, pitch: int) -> Array:
    """Middle of a window, from the line's first sample [px]."""
    return pitch * (first.astype(jnp.float32) + 0.5 * (WIDE * bins - 1).astype(jnp.float32))


def _cut(on, off, found, pitch, levels, saturation):
    """Saturated pixels, levels on and off around one frame's candidates: [samples, lines, rank]."""
    _, at, extent, first, bins = found
    lines, samples = on.shape
    sample = jnp.arange(WIDE, dtype=jnp.int32)[:, None, None]
    index = first[None] + bins[None] * sample
    inside = (index >= 0) & (index + bins[None] <= samples)
    step = (pitch * bins).astype(jnp.float32)[None]
    x = step * (sample.astype(jnp.float32) - 0.5 * (WIDE - 1)) - (at - _middle(first, bins, pitch))[None]
    near = inside & (jnp.abs(x) <= reach(extent)[None])
    line = samples * jnp.arange(lines, dtype=jnp.int32)[None, :, None]
    places = [line + jnp.clip(i, 0, samples - 1) for i in (index, index + bins[None] - 1)]

    def codes(frame):
        flat = jnp.asarray(frame).reshape(-1)
        return [flat.at[place].get(mode="promise_in_bounds") for place in places]

    on_codes, off_codes = codes(on), None if off is None else codes(off)
    clipped = [code >= saturation for code in on_codes]
    second = bins[None] == 2
    saturated = jnp.sum(near & clipped[0], axis=0, dtype=jnp.int32)
    saturated += jnp.sum(near & clipped[1] & second, axis=0, dtype=jnp.int32)
    whole = ~(clipped[0] | clipped[1])
    level_off = None
    if off_codes is not None:
        whole &= (off_codes[0] < saturation) & (off_codes[1] < saturation)
        level_off = jnp.where(inside, 0.5 * (levels[off_codes[0]] + levels[off_codes[1]]), 0.0)
    level_on = 0.5 * (levels[on_codes[0]] + levels[on_codes[1]])
    return saturated, jnp.where(near & whole, level_on, NO_LEVEL), level_off
