"""The stripe of every line where all candidates are at hand."""

import jax
import numpy as np
from jaxtyping import Float, Int, Int8

from jaxscan.geometry import Array
from jaxscan.stripes.choosing.steps import check_steps
from jaxscan.stripes.stripes import FrameStripes


_LINES = 128
"""Lines that are compared at a time: the copies for it stay small beside the sweep itself."""


def chosen_of(stripes: FrameStripes, chosen: Int8[Array, "frames lines"] | None) -> FrameStripes:
    """The chosen ones among all candidates [frames * K, lines]; all of them where nothing is chosen."""
    if chosen is None:
        return stripes
    return jax.tree.map(lambda field: _taken(np.asarray(field), np.asarray(chosen)), stripes)


def pick_by_steps(
    fields: dict[str, np.ndarray],
    chosen: Int8[np.ndarray, "profiles lines"],
    laser: Int[np.ndarray, " profiles"],
    angle: Float[np.ndarray, " profiles"],
) -> dict[str, np.ndarray]:
    """One candidate of every line: the chosen one, unless `check_steps` knows better.

    Args:
        fields: Fields of all candidates [profiles * K, lines, ...], those of a profile following each other.
        chosen: Number of each line's candidate, -1 where there is none.
        laser: Which laser lit each profile.
        angle: The table's angle of each profile [rad].

    Returns:
        The fields [profiles, lines, ...], zero where there is no stripe.
    """
    profiles, lines = chosen.shape
    u, valid = (fields[name].reshape(profiles, -1, lines) for name in ("u", "valid"))
    new = chosen.copy()
    for number in np.unique(laser):
        own = np.flatnonzero(laser == number)
        own = own[np.argsort(angle[own], kind="stable")]
        for start in range(0, lines, _LINES):
            part = slice(start, start + _LINES)
            candidates, exists = (np.moveaxis(field[own, :, part], 1, 2) for field in (u, valid))
            with jax.enable_x64(False):
                new[own, part] = np.asarray(check_steps(candidates, exists, chosen[own, part]))
    return {name: _taken(field, new) for name, field in fields.items()}


def _taken(field: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Of a field [profiles * K, lines, ...] the entries of the chosen candidates; zero where there is none."""
    rest = (1,) * (field.ndim - 2)
    number = np.maximum(chosen, 0).astype(np.intp).reshape(len(chosen), 1, -1, *rest)
    taken = np.take_along_axis(field.reshape(len(chosen), -1, *field.shape[1:]), number, 1)[:, 0]
    return np.where((chosen >= 0).reshape(*chosen.shape, *rest), taken, taken.dtype.type(0))
