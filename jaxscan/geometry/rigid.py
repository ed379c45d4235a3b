"""Rigid motions as 4 x 4 matrices: `T_ab` maps coordinates of frame b to frame a.

Sums are written out component by component: one line serves one motion or many, NumPy and JAX, and an accelerator does
not shorten float32 as it does in its matrix products. Exponentials come from jaxlie.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxscan.geometry.arrays import Array, namespace


def exponential(twist: Float[Array, "6"]) -> Float[Array, "4 4"]:
    """The motion exp(twist) of a twist (v, omega) [m, rad], in jaxlie's order."""
    # Imported here, so that `import jaxscan` does not load jaxlie.
    import jaxlie

    return jaxlie.SE3.exp(jnp.asarray(twist)).as_matrix()


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
