"""Unit vectors in minimal coordinates: a direction, and two tangent vectors for its steps."""

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import ArrayLike, Float

from jaxscan.geometry.arrays import Array, namespace


def tangent_basis(direction: np.ndarray) -> np.ndarray:
    """Two orthonormal vectors, float64 [2, 3], perpendicular to the unit vector `direction`."""
    # The cross product with the coordinate axis after the largest component is safe. The least parallel
    # axis would be safe too, but for an upright direction the last digits would decide which one it is.
    first = np.cross(direction, np.eye(3)[(np.argmax(np.abs(direction)) + 1) % 3])
    first = first / np.linalg.norm(first)
    return np.stack([first, np.cross(direction, first)])


def unit_vector(vector: ArrayLike | Sequence[float], name: str) -> tuple[np.ndarray, float]:
    """A vector of any length, made a unit vector.

    Args:
        vector: Three numbers.
        name: Its name in messages.

    Returns:
        unit: float64 [3].
        length: Length of `vector`.

    Raises:
        ValueError: If there are not three finite numbers, or all are 0.
    """
    found = np.asarray(vector, np.float64)
    length = math.hypot(*found.ravel())
    if found.shape != (3,) or not 0 < length < math.inf:
        raise ValueError(f"{name}: found {found.tolist()}, expected three finite numbers, not all 0")
    return found / length, length


def move_direction(
    direction: Float[Array, "*n 3"], basis: Float[Array, "*n 2 3"], step: Float[Array, "*n 2"]
) -> tuple[Float[Array, "*n 3"], Float[Array, "*n 2 3"]]:
    """Move unit vectors by `step` [rad, to first order] along their tangent vectors.

    Returns:
        direction: The moved unit vectors.
        basis: The tangent vectors moved along: orthonormal and perpendicular to them again.
    """
    xp = namespace(direction, basis, step)
    dot = lambda a, b: xp.sum(a * b, -1, keepdims=True)
    unit = lambda vector: vector / xp.sqrt(dot(vector, vector))
    moved = unit(direction + step[..., 0:1] * basis[..., 0, :] + step[..., 1:2] * basis[..., 1, :])
    first = unit(basis[..., 0, :] - dot(basis[..., 0, :], moved) * moved)
    second = basis[..., 1, :] - dot(basis[..., 1, :], moved) * moved - dot(basis[..., 1, :], first) * first
    return moved, xp.stack([first, unit(second)], -2)
