"""Many points of one scanner at once, and how they follow from its parameters."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.geometry import Array, Rig, Scanner, lit_points, points, poses, transform


_BLOCK, _SMALL_BLOCK = 16_384, 1_024


def triangulate_points(
    scanner: Scanner,
    q: Float[np.ndarray, "n 2"],
    laser: Int[np.ndarray, " n"],
    phi: Float[np.ndarray, " n"],
    station: Float[np.ndarray, "n 4 4"] | None = None,
) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """Points of stripes in the frame of the room.

    Args:
        scanner: Any; its covariance is not used.
        q: Stripe centres (u, v) [px].
        laser: The scanner's sheet of each.
        phi: The table's angle of each, with corrections [rad from home].
        station: T_room_scanner of each; None for the scanner's own frame.

    Returns:
        points: [m].
        valid: Whether the ray meets the sheet in front of the camera.
    """
    rig = scanner.rig
    p_cam, incidence = lit_points(rig, q, laser)
    point = transform(poses(rig, phi), p_cam)
    return np.asarray(point if station is None else transform(station, point)), np.asarray(incidence) > 0


def point_gradient(
    scanner: Scanner, q: Float[np.ndarray, "n 2"], laser: Int[np.ndarray, " n"], phi: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 3 params"]:
    """Derivatives of points in the scanner's frame by its minimal coordinates [m / px, m / rad, 1].

    Computed in blocks of one size if they are many and of another if few: compiled once for each.
    """
    full = np.asarray(q, np.float64), np.asarray(laser, np.int32), np.asarray(phi, np.float64)
    block, parts = _SMALL_BLOCK if len(q) <= _SMALL_BLOCK else _BLOCK, []
    with jax.enable_x64(True):
        for begin in range(0, max(len(q), 1), block):
            some = [array[begin : begin + block] for array in full]
            padded = [np.concatenate([a, np.zeros((block - len(a), *a.shape[1:]), a.dtype)]) for a in some]
            parts.append(np.asarray(_gradients(scanner.rig, *padded))[: len(some[0])])
    return np.concatenate(parts)


# Of every cell of a sweep: worth its optimisation where all else is compiled in haste.
@partial(jax.jit, compiler_options={"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 3})
def _gradients(rig: Rig, q: Array, laser: Array, phi: Array) -> Array:
    zero = jnp.zeros(rig.parameter_count(), q.dtype)
    by_step = jax.jacrev(lambda step, *seen: points(rig.retract(step), *seen))
    return jax.vmap(by_step, (None, 0, 0, 0))(zero, q, laser, phi)
