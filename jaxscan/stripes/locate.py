"""Where to look for the stripe: the maximum of a small matched filter over the whole line.

The filter runs on a lattice of 2 px: sums of two neighbouring pixels, or the samples themselves
where they are 2 px apart. A triangle over three lattice points (weights 1, 2, 1) is within
a few per cent of the matched filter of stripes between 1 and 3 px. All is done in 16-bit integers
and in reductions along leading axes, which compile to vector instructions on a CPU.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Float, Int, Int16, UInt8

from jaxscan.geometry import Array


HALF_SPAN = 12
"""Lattice points on either side of the maximum in which the stripe's extent is measured."""
_GROUPS = 32
_FLANK_GAP = 4


class Candidate(NamedTuple):
    """The strongest stripe-like maximum of each line."""

    u: Float[Array, " lines"]
    """Middle between the half-maximum points [px from the line's first sample]."""
    extent: Float[Array, " lines"]
    """Distance between the half-maximum points [px]."""


def locate(on: UInt8[Array, "lines samples"], off: Array | None, *, pitch: int) -> Candidate:
    """The best candidate of every line.

    Args:
        on: Samples with the laser on [DN].
        off: Samples with the laser off [DN], or None: then the level of both sides of
            a maximum is subtracted from it, the higher of the two, so that no edge wins.
        pitch: Distance between samples [px], 1 or 2.
    """
    lattice = _lattice(on, pitch)
    if off is not None:
        lattice = lattice - _lattice(off, pitch)
    length = lattice.shape[-1]
    padded = -length % _GROUPS
    response = _window_sum(_window_sum(lattice, 1, 1, 0), 1, 0, 1 + padded)
    if off is None:
        response = response - _surround(lattice, padded)
    best, peak = _argmax(response)
    step = 2.0
    shift = 0.5 if pitch == 1 else 0.0
    left, right = _half_maximum(lattice, best, peak)
    middle = best.astype(jnp.float32) + 0.5 * (right - left)
    return Candidate(u=step * middle + shift, extent=step * (left + right))


def _lattice(samples: UInt8[Array, "lines samples"], pitch: int) -> Int16[Array, "lines points"]:
    if pitch == 2:
        return samples.astype(jnp.int16)
    lines, count = samples.shape
    pairs = samples[:, : count // 2 * 2].reshape(lines, count // 2, 2)
    both = lax.bitcast_convert_type(pairs, jnp.uint16)
    return ((both & 0xFF) + (both >> 8)).astype(jnp.int16)


def _window_sum(values: Int16[Array, "l p"], distance: int, before: int, after: int) -> Int16[Array, "l q"]:
    """Sum of two points `distance` apart, with zeros around the line."""
    padding = ((0, 0), (before, after))
    return lax.reduce_window(values, jnp.int16(0), lax.add, (1, 2), (1, 1), padding, window_dilation=(1, distance))


def _surround(lattice: Int16[Array, "l p"], padded: int) -> Int16[Array, "l q"]:
    """The higher of the mean levels on both sides, in units of the triangle's response."""
    left, right = _FLANK_GAP + 7, _FLANK_GAP
    # Beyond the image its last level goes on, or the image's border would be an edge.
    flank: Array = jnp.pad(jnp.asarray(lattice), ((0, 0), (left, right + 7 + padded)), mode="edge")
    for distance in (1, 2, 4):
        flank = _window_sum(flank, distance, 0, 0)
    # Point k of `flank` now holds 8 points from k - left on; a mean of 8 weighs 4 in the triangle.
    higher = lax.reduce_window(
        flank, jnp.int16(0), lax.max, (1, 2), (1, 1), ((0, 0), (0, 0)), window_dilation=(1, left + right)
    )
    return higher >> 1


def _argmax(response: Int16[Array, "l q"]) -> tuple[Int[Array, " lines"], Int[Array, " lines"]]:
    """Index and value of each line's maximum.

    Value and group number share one unsigned 16-bit key (a response is at most 2040), so the
    maximum over groups runs along a leading axis; only its short result is reduced along lanes.
    """
    lines, length = response.shape
    lanes = length // _GROUPS
    key = jnp.maximum(response, 0).astype(jnp.uint16) << 5
    key = key.reshape(lines, _GROUPS, lanes) | jnp.arange(_GROUPS, dtype=jnp.uint16)[None, :, None]
    key = jnp.max(key, 1).astype(jnp.int32)
    key = jnp.max(key << 12 | jnp.arange(lanes, dtype=jnp.int32)[None, :], -1)
    return (key >> 12 & 31) * lanes + (key & 4095), key >> 17


def _half_maximum(
    lattice: Int16[Array, "l p"], best: Int[Array, " lines"], peak: Int[Array, " lines"]
) -> tuple[Float[Array, " lines"], Float[Array, " lines"]]:
    """Distance to half of the maximum on either side [lattice points]."""
    length = lattice.shape[-1]
    offset = jnp.arange(-HALF_SPAN, HALF_SPAN + 1, dtype=jnp.int32)[:, None]
    row_start = length * jnp.arange(best.shape[0], dtype=jnp.int32)
    flat = jnp.asarray(lattice).reshape(-1)

    def at(point):
        index = jnp.clip(point, 0, length - 1) + row_start
        return flat.at[index].get(mode="promise_in_bounds").astype(jnp.int32)

    triangle = at(best - 1) + 2 * at(best) + at(best + 1)
    # The triangle weighs 4 lattice points; what it counts beyond the peak is background.
    half = 2 * triangle - peak
    point = best[None, :] + offset
    index = jnp.clip(point, 0, length - 1) + row_start[None, :]
    value = flat.at[index].get(mode="promise_in_bounds").astype(jnp.int32)
    outside = (8 * value < half[None, :]) | (point < 0) | (point >= length)
    distance = jnp.where(outside, jnp.abs(offset), HALF_SPAN)

    def crossing(first_outside, side):
        inner, outer = at(best + side * (first_outside - 1)), at(best + side * first_outside)
        drop = jnp.maximum(inner - outer, 1).astype(jnp.float32)
        fraction = (inner.astype(jnp.float32) - half.astype(jnp.float32) / 8.0) / drop
        return first_outside.astype(jnp.float32) - 1.0 + jnp.clip(fraction, 0.0, 1.0)

    left = jnp.min(distance[:HALF_SPAN], 0)
    right = jnp.min(distance[HALF_SPAN + 1 :], 0)
    return crossing(left, -1), crossing(right, 1)
