"""One colour of many observations, that come one after another and are not kept.

Colours of a point that agree are added up. There is room for a few that do not: a pixel at an edge that shows the
other side of it founds a colour of its own, and the one with most weight is that of the point. So memory does not grow
with the number of photographs, and what a few of them mistake does not bleed into it.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8


ROOM = 3
"""Different colours of a point that are remembered."""


class Tally(NamedTuple):
    """Colours of points so far."""

    total: Float[np.ndarray, "*n colours 3"]
    """Sum of the weighted observations of each [DN]."""
    weight: Float[np.ndarray, "*n colours"]

    @staticmethod
    def start(rgb: UInt8[np.ndarray, "*n 3"]) -> "Tally":
        """One colour of each point already; zero for none."""
        total, weight = np.zeros((*rgb.shape[:-1], ROOM, 3), np.float32), np.zeros((*rgb.shape[:-1], ROOM), np.float32)
        weight[..., 0] = np.any(rgb != 0, -1)
        total[..., 0, :] = rgb
        return Tally(total, weight)


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
