"""Stripes on lines where none was found, searched in the light of several lines together.

A stripe that is lost in the noise of each line, or fades in speckle on one of them, stands out of the sum of some lines
around. There it is measured, in the light of the line alone, with less signal than anywhere else. A line that is much
darker than those around is dark on purpose, behind an edge or on print: the fainter it is beside them, the more of its
own signal is asked for, but for what speckle takes away.

The search and the fit are those of the first look: both looks are one compiled function, which gets the number of the
look.
"""

import functools
import math
import operator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Int8

from jaxscan.geometry import Array
from jaxscan.stripes.peaks import TOGETHER, Peaks
from jaxscan.stripes.search import Search
from jaxscan.stripes.stripes import FrameStripes


_LEAST_SNR = 1.0
"""Signal-to-noise ratio of a stripe that is measured where it has to be [1]."""
_LESS_SURE = 2.0
"""Largest accepted standard deviation of its centre, in that of others [1]."""
_REACH_PX = 1.5
"""Distance from its place in the sum within which a stripe is accepted [px]."""
_TOGETHER_SNR = 4.8
"""Signal-to-noise ratio of the lowest maximum of the sum [1]."""
_BETWEEN = TOGETHER // 2
"""Lines on either side, of which one has to have a stripe."""
_DARKER, _FADED = 0.5, 0.1
"""Signal of a line, in that of those around, below which it is dark on purpose: without speckle, and at least [1]."""


class Look(NamedTuple):
    """What is looked for in a frame."""

    again: Bool[Array, ""]
    """Whether for faint stripes."""
    lacking: Bool[Array, " lines"]
    """Lines without a stripe."""

    def search(self, search: Search) -> Search:
        """The search with what is asked of a stripe."""
        limits, of = search.limits, lambda faint, other: jnp.where(self.again, jnp.float32(faint), other)
        return search._replace(
            limits=limits._replace(
                least_snr=of(_LEAST_SNR, limits.least_snr), max_sigma_px=of(_LESS_SURE, 1.0) * limits.max_sigma_px
            )
        )

    def believed(self, found: FrameStripes, peaks: Peaks, search: Search) -> FrameStripes:
        """The stripes [candidates, lines] that are between others, where these are, and as bright."""
        around = peaks.height * (_TOGETHER_SNR / math.sqrt(TOGETHER))
        share = jnp.maximum(_DARKER - 0.5 * search.speckle, _FADED)
        near = (jnp.abs(found.u - peaks.at) <= _REACH_PX) & (found.snr >= share * around)
        # The light of a sum may lie on one side alone: beyond the end of a stripe.
        lit = jnp.pad(~self.lacking | jnp.any(found.valid & near, 0), _BETWEEN)
        lines = len(self.lacking)
        before, after = (
            functools.reduce(operator.or_, (lit[_BETWEEN + side * k :][:lines] for k in range(1, _BETWEEN + 1)))
            for side in (-1, 1)
        )
        return found._replace(valid=found.valid & ((near & (before & after)[None]) | ~self.again))


def with_faint(
    measured: FrameStripes, number: Int8[Array, "frames lines"], found: FrameStripes
) -> tuple[FrameStripes, Int8[Array, "frames lines"]]:
    """The candidates with faint stripes in place of the last one, where there is none, and the new numbers.

    Args:
        measured: All candidates [frames, candidates, lines].
        number: Which of them is each line's stripe, -1 where none is.
        found: Faint stripes, the first candidate of each line.
    """
    last = measured.u.shape[1] - 1
    new = found.valid[:, 0] & ~measured.valid[:, last]
    put = lambda all, one: jnp.asarray(all).at[:, last].set(jnp.where(new, one[:, 0], all[:, last]))
    return jax.tree.map(put, measured, found), jnp.where(new, np.int8(last), number)
