"""Stripes on lines where none was found, between lines that have one.

Speckle lets a stripe fade on some lines, so that the search of a line by itself does not see it. The lines before and
behind say where it has to be: there it is measured with less signal than anywhere else. A gap that is dark on purpose,
behind an edge, has nothing to measure, and chance finds something there on one line of ten at most.
"""

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Bool, Float, Int8

from jaxscan.geometry import Array
from jaxscan.stripes.fit import FILTER_VARIANCE
from jaxscan.stripes.peaks import Peaks, peaks_at
from jaxscan.stripes.stripes import FrameStripes


LEAST_SNR = 2.0
"""Signal-to-noise ratio of a stripe that is measured where it has to be [1]."""
PASSES = 3
"""How often gaps are filled: what is found makes the gaps that are left shorter."""
_LINES = 12
"""Lines without a stripe, at most, that lines with one lie around."""
_STEEPEST = 1.0
"""Largest slope of the stripe over a gap [px per line]; errors of both ends come to it."""
_REACH_PX = 1.5
"""Distance from the line between both ends within which a stripe is accepted, and by which the ends may err [px]."""


class Gaps(NamedTuple):
    """Where stripes have to be, [frames, lines]."""

    exists: Bool[Array, "frames lines"]
    u: Float[Array, "frames lines"]
    """Centre, as of the measured stripes [px]."""
    width: Float[Array, "frames lines"]
    """Standard deviation of the stripe [px]."""

    def peaks(self, offset: Float[Array, "1 lines"], pitch: int) -> Peaks:
        """As candidates of the search.

        Args:
            offset: Of the first sample of every line [px].
            pitch: Distance between samples [px].
        """
        extent = 2.0 * jnp.sqrt(2.0 * math.log(2.0) * (self.width**2 + FILTER_VARIANCE[pitch]))
        return peaks_at(self.exists, self.u - offset, extent, pitch)


def find_gaps(measured: FrameStripes, number: Int8[Array, "frames lines"]) -> Gaps:
    """The lines without a stripe between lines with one.

    Args:
        measured: All candidates [frames, candidates, lines].
        number: Of each line's stripe among them, -1 where there is none.
    """
    chosen = jnp.maximum(number, 0).astype(jnp.int32)[:, None]
    taken = lambda field: jnp.take_along_axis(jnp.asarray(field), chosen, 1)[:, 0]
    u, width, there = taken(measured.u), taken(measured.width), number >= 0
    lines = u.shape[1]
    line = jnp.arange(lines, dtype=jnp.int32)[None]
    before = lax.cummax(jnp.where(there, line, -1), axis=1)
    after = lax.cummin(jnp.where(there, line, lines), axis=1, reverse=True)
    between = (before >= 0) & (after < lines) & ~there & (after - before <= _LINES + 1)
    ends = [jnp.clip(end, 0, lines - 1) for end in (before, after)]
    (u_a, width_a), (u_b, width_b) = ([jnp.take_along_axis(f, end, 1) for f in (u, width)] for end in ends)
    length = jnp.maximum(after - before, 1).astype(u.dtype)
    share = (line - before).astype(u.dtype) / length
    straight = jnp.abs(u_b - u_a) <= _STEEPEST * length + _REACH_PX
    return Gaps(between & straight, u_a + share * (u_b - u_a), 0.5 * (width_a + width_b))


def fill_gaps(
    measured: FrameStripes, number: Int8[Array, "frames lines"], gaps: Gaps, found: FrameStripes
) -> tuple[FrameStripes, Int8[Array, "frames lines"]]:
    """The candidates with those that were found in gaps in place of the last one, and the new numbers.

    Args:
        measured: As of `find_gaps`.
        number: As of `find_gaps`.
        gaps: Where stripes had to be.
        found: What was measured there [frames, lines].
    """
    last = measured.u.shape[1] - 1
    new = gaps.exists & found.valid & (jnp.abs(found.u - gaps.u) <= _REACH_PX)
    fields = (
        jnp.asarray(all).at[:, last].set(jnp.where(new, one, all[:, last]))
        for all, one in zip(measured, found, strict=True)
    )
    return FrameStripes(*fields), jnp.where(new, np.int8(last), number)
