"""Rigid motions as 4 x 4 matrices: `T_ab` maps coordinates of frame b to frame a.

Sums are written out component by component: one line serves one motion or many, NumPy and JAX, and an accelerator does
not shorten float32 as it does in its matrix products.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import ArrayLike, Float

from jaxscan.geometry.arrays import Array, namespace


# Below this square of an angle the series in this file are exact to float64 rounding.
_SMALL_SQUARE = 1e-2
UNIT_TOLERANCE = 1e-6
"""Accepted departure of a vector from unit length and from perpendicular."""


def exponential(twist: Float[Array, "*n 6"]) -> Float[Array, "*n 4 4"]:
    r"""The motion exp(twist) of a twist (v, omega) [m, rad].

    With $K x = \omega \times x$ the rotation is $1 + a K + b K^2$ and the translation $v + b K v + c K^2 v$.

    Source: Lynch and Park, Modern Robotics (2017), section 3.3.
    """
    xp, (v, w) = namespace(twist), (twist[..., :3], twist[..., 3:])
    square = w[..., 0] * w[..., 0] + w[..., 1] * w[..., 1] + w[..., 2] * w[..., 2]
    a, b, c = (factor[..., None] for factor in _rotation_factors(xp, xp.asarray(square)))
    once = lambda x: xp.cross(w, x)
    columns = []
    for k in range(3):
        axis = xp.broadcast_to(xp.eye(3, dtype=twist.dtype)[k], w.shape)
        columns.append(axis + a * once(axis) + b * once(once(axis)))
    return rigid(xp.stack(columns, -1), v + b * once(v) + c * once(once(v)))


def _rotation_factors(xp: Any, square: Array) -> tuple[Array, Array, Array]:
    """sin t / t, (1 - cos t) / t^2 and (t - sin t) / t^3 of t^2; smooth at 0."""
    near = square < _SMALL_SQUARE
    s, far = (xp.where(where, square, 1.0).astype(square.dtype) for where in (near, ~near))
    t = xp.sqrt(far)
    half = xp.sin(t / 2)
    series = (
        1.0 - s / 6 * (1.0 - s / 20 * (1.0 - s / 42 * (1.0 - s / 72))),
        (1.0 - s / 12 * (1.0 - s / 30 * (1.0 - s / 56 * (1.0 - s / 90)))) / 2,
        (1.0 - s / 20 * (1.0 - s / 42 * (1.0 - s / 72 * (1.0 - s / 110)))) / 6,
    )
    exact = xp.sin(t) / t, 2 * half * half / far, (t - xp.sin(t)) / (t * far)
    a, b, c = (xp.where(near, *both).astype(square.dtype) for both in zip(series, exact, strict=True))
    return a, b, c


def rigid(rotation: Float[Array, "*n 3 3"], translation: Float[Array, "*n 3"]) -> Float[Array, "*n 4 4"]:
    """The motion p -> rotation p + translation."""
    xp = namespace(rotation, translation)
    top = xp.concatenate([rotation, translation[..., None]], -1)
    last = xp.broadcast_to(xp.asarray([[0.0, 0.0, 0.0, 1.0]], top.dtype), (*top.shape[:-2], 1, 4))
    return xp.concatenate([top, last], -2)


def turn(rotation: Float[Array, "... 3 3"], v: Float[Array, "... 3"]) -> Float[Array, "... 3"]:
    """The vector, turned."""
    x, y, z = (v[..., k] for k in range(3))
    rows = [rotation[..., i, 0] * x + rotation[..., i, 1] * y + rotation[..., i, 2] * z for i in range(3)]
    return namespace(rotation, v).stack(rows, -1)


def transform(T_ab: Float[Array, "... 4 4"], p_b: Float[Array, "... 3"]) -> Float[Array, "... 3"]:
    """The point `p_b` in frame a."""
    x, y, z = (p_b[..., k] for k in range(3))
    rows = [T_ab[..., i, 0] * x + T_ab[..., i, 1] * y + T_ab[..., i, 2] * z + T_ab[..., i, 3] for i in range(3)]
    return namespace(T_ab, p_b).stack(rows, -1)


def invert(T_ab: Float[Array, "*n 4 4"]) -> Float[Array, "*n 4 4"]:
    """T_ba."""
    rotation = T_ab[..., :3, :3].swapaxes(-1, -2)
    return rigid(rotation, -turn(rotation, T_ab[..., :3, 3]))


def compose(T_ab: Float[Array, "... 4 4"], T_bc: Float[Array, "... 4 4"]) -> Float[Array, "... 4 4"]:
    """T_ac."""
    columns = [turn(T_ab[..., :3, :3], T_bc[..., :3, k]) for k in range(3)]
    return rigid(namespace(T_ab, T_bc).stack(columns, -1), transform(T_ab, T_bc[..., :3, 3]))


def nearest_rotation(matrix: Float[np.ndarray, "*n 3 3"]) -> Float[np.ndarray, "*n 3 3"]:
    """The rotation that is nearest to a matrix, in the sum of squares.

    Source: Kabsch, Acta Cryst. A32 (1976) 922: of a covariance of points, the rotation between them.
    """
    u, _, vt = np.linalg.svd(matrix)
    u[..., :, 2] *= np.sign(np.linalg.det(u @ vt))[..., None]
    return u @ vt


def is_pose(matrix: np.ndarray) -> bool:
    """Whether a 4 x 4 matrix is a rigid motion of less than 10 km, to six digits."""
    if not (np.isfinite(matrix).all() and np.abs(matrix).max() <= 1e4):
        return False
    turn, last = matrix[:3, :3], np.array([0.0, 0.0, 0.0, 1.0])
    off = max(np.abs(turn.T @ turn - np.eye(3)).max(), np.abs(matrix[3] - last).max())
    return bool(off < 100 * UNIT_TOLERANCE and np.linalg.det(turn) > 0)


def quaternion(rotation: Float[np.ndarray, "3 3"]) -> tuple[float, float, float, float]:
    """Unit quaternion (w, x, y, z) of a rotation, w not negative."""
    # Imported here, so that `import jaxscan` does not load SciPy.
    from scipy.spatial.transform import Rotation  # type: ignore[import-untyped]

    x, y, z, w = Rotation.from_matrix(rotation).as_quat(canonical=True).tolist()
    return w, x, y, z


def from_quaternion(q: Float[np.ndarray, "4"]) -> Float[np.ndarray, "3 3"]:
    """The rotation of a quaternion (w, x, y, z) of any length."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_quat(np.roll(q, -1)).as_matrix())


def tangent_basis(direction: np.ndarray) -> np.ndarray:
    """Two orthonormal vectors, float64 [2, 3], perpendicular to the unit vector `direction`."""
    # The cross product with the coordinate axis after the largest component is safe. The least parallel
    # axis would be safe too, but for an upright direction the last digits would decide which one it is.
    first = np.cross(direction, np.eye(3)[(np.argmax(np.abs(direction)) + 1) % 3])
    first = first / np.linalg.norm(first)
    return np.stack([first, np.cross(direction, first)])


def unit_vector(vector: ArrayLike | Sequence[float], name: str) -> tuple[np.ndarray, float]:
    """A vector of any length, made a unit vector.

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


def check_frame(name: str, direction: ArrayLike | Sequence[float], basis: ArrayLike | Sequence[Any]) -> None:
    """Refuse a direction that is no unit vector, and a basis that is not perpendicular to it.

    Raises:
        ValueError: With the value found.
    """
    # Digits are lost where numbers are written by hand.
    length = float(np.linalg.norm(np.asarray(direction)))
    if abs(length - 1) > UNIT_TOLERANCE:
        raise ValueError(f"{name}: found a vector of length {length:.9g}, expected 1")
    frame = np.concatenate([np.reshape(direction, (1, 3)), np.reshape(basis, (2, 3))])
    if np.abs(frame @ frame.T - np.eye(3)).max() > UNIT_TOLERANCE:
        raise ValueError(f"basis: expected two unit vectors, perpendicular to each other and to {name}")


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
