"""The stripe of every line where all candidates are at hand."""

import jax
import numpy as np
from jaxtyping import Float, Int, Int8

from jaxscan.reconstruction.streaming.chunk import ChunkResult
from jaxscan.reconstruction.streaming.grid import GrowingStripes
from jaxscan.stripes.choosing.steps import check_steps
from jaxscan.stripes.stripes import FrameStripes


_LINES = 128
"""Lines that are compared at a time: what is copied for it stays small beside the sweep itself."""


def one_per_line(result: ChunkResult) -> FrameStripes:
    """The chosen stripes of a chunk, whether or not it has the other candidates too."""
    if result.chosen is None:
        return result.stripes
    chosen = np.asarray(result.chosen)
    number = np.maximum(chosen, 0).astype(np.intp)[:, None, :]

    def of_chosen(field):
        taken = np.take_along_axis(np.asarray(field).reshape(len(chosen), -1, chosen.shape[1]), number, 1)[:, 0]
        return np.where(chosen >= 0, taken, taken.dtype.type(0))

    return jax.tree.map(of_chosen, result.stripes)


def pick_by_steps(
    stripes: GrowingStripes,
    chosen: Int8[np.ndarray, "profiles lines"],
    laser: Int[np.ndarray, " profiles"],
    angle: Float[np.ndarray, " profiles"],
) -> None:
    """Keep one candidate of every line: the chosen one, unless `check_steps` knows better.

    Args:
        stripes: All candidates, those of a profile following each other; left with one per profile.
        chosen: Number of each line's candidate, -1 where there is none.
        laser: Which laser lit each profile.
        angle: The table's angle of each profile [rad].
    """
    profiles, lines = chosen.shape
    u, valid = (stripes.fields[name].reshape(profiles, -1, lines) for name in ("u", "valid"))
    new = chosen.copy()
    for number in np.unique(laser):
        own = np.flatnonzero(laser == number)
        own = own[np.argsort(angle[own], kind="stable")]
        for start in range(0, lines, _LINES):
            part = slice(start, start + _LINES)
            candidates, exists = (np.moveaxis(field[own, :, part], 1, 2) for field in (u, valid))
            with jax.enable_x64(False):
                new[own, part] = np.asarray(check_steps(candidates, exists, chosen[own, part]))
    index, found = np.maximum(new, 0).astype(np.intp)[:, None, :], new >= 0
    for name, field in stripes.fields.items():
        taken = np.take_along_axis(field.reshape(profiles, -1, lines), index, 1)[:, 0]
        stripes.fields[name] = np.where(found, taken, taken.dtype.type(0))
    colours = stripes.rgb.reshape(profiles, -1, lines, 3)
    taken = np.take_along_axis(colours, index[..., None], 1)[:, 0]
    stripes.rgb = np.where(found[..., None], taken, np.uint8(0))
