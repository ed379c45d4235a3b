"""The point that a click means."""

import numpy as np
from jaxtyping import Float, Int8

from jaxscan.viewer.sides import seen_from


_BEHIND = 0.02
"""Points of one surface: so much farther than the nearest one, as a share of its distance."""
_AT_ONCE = 1 << 20
"""Points that are looked at together, which bounds the memory."""


def pick(
    xyz: Float[np.ndarray, "n 3"],
    origin: Float[np.ndarray, "3"],
    direction: Float[np.ndarray, "3"],
    *,
    cone_rad: float,
    shown: np.ndarray | None = None,
    sides: Int8[np.ndarray, "n 3"] | None = None,
) -> int | None:
    """The point that a click means: it is on the nearest surface in a cone around the ray, and closest to the ray.

    Args:
        xyz: Points [m].
        origin: Where the ray begins [m].
        direction: Where it goes; its length does not matter.
        cone_rad: Half the angle of the cone.
        shown: Which points may be picked, bool [n]; all if None.
        sides: From which side the points were seen, where those that the ray meets from behind are not shown.
    """
    direction = np.asarray(direction, np.float64) / np.linalg.norm(direction)
    found: list[np.ndarray] = []
    for start in range(0, len(xyz), _AT_ONCE):
        apart = xyz[start : start + _AT_ONCE] - np.asarray(origin, xyz.dtype)
        along = apart @ direction.astype(xyz.dtype)
        inside = along > 0
        inside &= np.einsum("ni,ni->n", apart, apart) < (along / np.cos(cone_rad)) ** 2
        if shown is not None:
            inside &= shown[start : start + _AT_ONCE]
        found.append(start + np.flatnonzero(inside))
    candidates = np.concatenate(found) if found else np.zeros(0, int)
    if sides is not None:
        candidates = candidates[seen_from(sides[candidates], xyz[candidates], np.asarray(origin, np.float64))]
    if not len(candidates):
        return None
    apart = xyz[candidates].astype(np.float64) - origin
    along = apart @ direction
    off = np.linalg.norm(apart - along[:, None] * direction, axis=1) / along
    front = along <= along.min() * (1 + _BEHIND)
    return int(candidates[front][np.argmin(off[front])])
