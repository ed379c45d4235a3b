"""One colour of many observations, that come one after another and are not kept.

Colours of a point that agree are added up. There is room for a few that do not: a pixel at an edge that shows the
other side of it founds a colour of its own, and the one with most weight is that of the point. So memory does not grow
with the number of photographs, and what a few of them mistake does not bleed into it.
"""

import functools
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, UInt8

from jaxscan.geometry import Array


ROOM = 3
"""Different colours of a point that are remembered."""


class Tally(NamedTuple):
    """Colours of points so far; the points come last, as they lie side by side for the compiler."""

    total: Float[Array, "..."]
    """Sum of the weighted observations of each [DN]."""
    weight: Float[Array, "..."]

    @staticmethod
    def start(rgb: UInt8[np.ndarray, "blocks 3 n"]) -> "Tally":
        """One colour of each point already; zero for none."""
        blocks, _, count = rgb.shape
        total, weight = np.zeros((blocks, ROOM, 3, count), np.float32), np.zeros((blocks, ROOM, count), np.float32)
        weight[:, 0], total[:, 0] = np.any(rgb != 0, 1), rgb
        return Tally(total, weight)


def add(
    tally: Tally, colour: Float[Array, "3"], weight: Float[Array, ""], tolerance: float | Float[Array, ""]
) -> Tally:
    """The tally of one point with one more observation of it.

    Args:
        tally: So far.
        colour: Of the observation [DN].
        weight: Of the observation; 0 for none.
        tolerance: Difference [DN] up to which colours are the same.
    """
    # Slot by slot: of an index and a reduction over three of them XLA makes a loop for each of many points.
    total, known = jnp.asarray(tally.total), jnp.asarray(tally.weight)
    apart = []
    for slot in range(ROOM):
        mean = total[slot] * (1 / jnp.where(known[slot] > 0, known[slot], 1.0))
        apart.append(jnp.where(known[slot] > 0, _largest(jnp.abs(mean - colour)), jnp.inf))
    nearest, lightest = functools.reduce(jnp.minimum, apart), functools.reduce(jnp.minimum, known)
    alike = nearest <= tolerance
    # Where all colours are taken, the lightest gives way to a heavier one.
    counts = (weight > 0) & (alike | (weight > lightest))
    totals, weights = [], []
    for slot in range(ROOM):
        here = counts & jnp.where(alike, apart[slot] == nearest, known[slot] == lightest)
        counts &= ~here
        kept, more = jnp.where(here & ~alike, 0.0, 1.0), jnp.where(here, weight, 0.0)
        totals.append(kept * total[slot] + more * colour)
        weights.append(kept * known[slot] + more)
    return Tally(jnp.stack(totals), jnp.stack(weights))


def _largest(three: Float[Array, "3"]) -> Float[Array, ""]:
    return jnp.maximum(jnp.maximum(three[0], three[1]), three[2])


def conclude(tally: Tally, tolerance: float) -> UInt8[np.ndarray, "3 n"]:
    """The colour with most weight of every point; black where there is none.

    Others that differ from it by no more than twice the tolerance are mixed with it: fine print looks a little
    different in each photograph, by where its pixels fall.
    """
    total, weight = (np.asarray(field) for field in tally)
    mean = total / np.maximum(weight, 1e-9)[:, None]
    best = np.take_along_axis(mean, np.argmax(weight, 0)[None, None], 0)
    like = np.abs(mean - best).max(1) <= 2 * tolerance
    weight = np.where(like, weight, 0)
    rgb = np.rint(np.sum(weight[:, None] * mean, 0) / np.maximum(weight.sum(0), 1e-9))
    return np.clip(rgb, 0, 255).astype(np.uint8)
