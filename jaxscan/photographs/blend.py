"""One colour of many observations, that come one after another and are not kept.

Colours of a point that agree are added up. There is room for a few that do not: a pixel at an edge that shows the
other side of it founds a colour of its own, and the one with most weight is that of the point. So memory does not grow
with the number of photographs, and what a few of them mistake does not bleed into it.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, UInt8

from jaxscan.geometry import Array


ROOM = 3
"""Different colours of a point that are remembered."""


class Tally(NamedTuple):
    """Colours of points so far."""

    total: Float[Array, "*n colours 3"]
    """Sum of the weighted observations of each [DN]."""
    weight: Float[Array, "*n colours"]

    @staticmethod
    def start(rgb: UInt8[np.ndarray, "n 3"] | None, count: int) -> "Tally":
        """Nothing seen yet, or one colour of each point: zero for none."""
        total, weight = np.zeros((count, ROOM, 3), np.float32), np.zeros((count, ROOM), np.float32)
        if rgb is not None:
            weight[:, 0] = np.any(rgb != 0, -1)
            total[:, 0] = rgb
        return Tally(total, weight)


def add(tally: Tally, colour: Float[Array, "3"], weight: Float[Array, ""], tolerance: Float[Array, ""]) -> Tally:
    """One more observation of one point.

    Args:
        tally: So far.
        colour: The observation [DN].
        weight: Its weight; 0 for none.
        tolerance: Difference [DN] up to which colours are the same.
    """
    mean = tally.total / jnp.maximum(tally.weight, 1e-9)[:, None]
    apart = jnp.where(tally.weight > 0, jnp.max(jnp.abs(mean - colour[None, :]), -1), jnp.inf)
    nearest, lightest = jnp.argmin(apart), jnp.argmin(tally.weight)
    agrees = apart[nearest] <= tolerance
    slot = jnp.arange(ROOM) == jnp.where(agrees, nearest, lightest)
    # Where all colours are taken, the lightest gives way to a heavier one.
    taken = (weight > 0) & (agrees | (weight > tally.weight[lightest]))
    kept = jnp.where(slot & ~agrees, 0.0, 1.0)
    change = jnp.where(slot, weight, 0.0)
    total = tally.total * kept[:, None] + change[:, None] * colour[None, :]
    return Tally(jnp.where(taken, total, tally.total), jnp.where(taken, tally.weight * kept + change, tally.weight))


def conclude(tally: Tally, tolerance: float) -> UInt8[np.ndarray, "n 3"]:
    """The colour with most weight of every point; black where there is none.

    Others that differ from it by no more than twice the tolerance are mixed with it: fine print looks a little
    different in each photograph, by where its pixels fall.
    """
    mean = tally.total / np.maximum(tally.weight, 1e-9)[..., None]
    best = np.take_along_axis(mean, np.argmax(tally.weight, -1)[:, None, None], 1)
    like = np.abs(mean - best).max(-1) <= 2 * tolerance
    weight = np.where(like, tally.weight, 0)[..., None]
    rgb = np.rint(np.sum(weight * mean, 1) / np.maximum(weight.sum(1), 1e-9))
    return np.clip(rgb, 0, 255).astype(np.uint8)


def tally_all(tally: Tally, colour: Array, weight: Array, tolerance: Array) -> Tally:
    """`add` for many points."""
    return jax.vmap(add, (0, 0, 0, None))(tally, colour, weight, tolerance)
