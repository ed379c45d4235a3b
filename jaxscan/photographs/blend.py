"""One colour of many observations, that come one after another and are not kept.

Colours of a point that agree are added up. There is room for a few that do not: a pixel at an edge that shows the
other side of it founds a colour of its own, and the one with most weight is that of the point. So memory does not grow
with the number of photographs, and what a few of them mistake does not bleed into it.
"""

from typing import NamedTuple

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
    def start(rgb: UInt8[np.ndarray, "*n 3"]) -> "Tally":
        """One colour of each point already; zero for none."""
        total, weight = np.zeros((*rgb.shape[:-1], ROOM, 3), np.float32), np.zeros((*rgb.shape[:-1], ROOM), np.float32)
        weight[..., 0] = np.any(rgb != 0, -1)
        total[..., 0, :] = rgb
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
    used = tally.weight > 0
    mean = tally.total / jnp.where(used, tally.weight, 1.0)[:, None]
    apart = jnp.where(used, jnp.abs(mean - colour[None]).max(-1), jnp.inf)
    alike = apart.min() <= tolerance
    # Where all colours are taken, the lightest gives way to a heavier one.
    slot = jnp.where(alike, jnp.argmin(apart), jnp.argmin(tally.weight))
    counts = (weight > 0) & (alike | (weight > tally.weight.min()))
    here = (jnp.arange(len(used)) == slot) & counts
    before = jnp.where(alike, tally.weight, 0.0), jnp.where(alike, tally.total, 0.0)
    return Tally(
        jnp.where(here[:, None], before[1] + weight * colour[None], tally.total),
        jnp.where(here, before[0] + weight, tally.weight),
    )


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
