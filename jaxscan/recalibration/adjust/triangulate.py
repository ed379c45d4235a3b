"""Many points of one scanner at once, and how they follow from its parameters."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.geometry import Array, Scanner
from jaxscan.recalibration.adjust.rows import room_point
from jaxscan.recalibration.adjust.solver import compiled


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
    found = _in_blocks(_points, scanner, (q, laser, phi, _stations(station, len(q))))
    return found[0], found[1]


def point_gradient(
    scanner: Scanner,
    q: Float[np.ndarray, "n 2"],
    laser: Int[np.ndarray, " n"],
    phi: Float[np.ndarray, " n"],
    station: Float[np.ndarray, "n 4 4"] | None = None,
) -> tuple[Float[np.ndarray, "n 3 params"], Float[np.ndarray, "n 3 2"], Float[np.ndarray, "n 3"]]:
    """Derivatives of the points of `triangulate_points`.

    Returns:
        by_scanner: By the minimal coordinates of the scanner [m / px, m / rad, 1].
        by_q: By the pixel [m / px].
        by_phi: By the table's angle [m / rad].
    """
    found = _in_blocks(_gradients, scanner, (q, laser, phi, _stations(station, len(q))))
    return found[0], found[1], found[2]


def _stations(station: np.ndarray | None, count: int) -> np.ndarray:
    return np.broadcast_to(np.eye(4), (count, 4, 4)) if station is None else np.asarray(station, np.float64)


def _in_blocks(function, scanner: Scanner, arrays: tuple[np.ndarray, ...]) -> list[np.ndarray]:
    """A function of points, in blocks of one size if they are many and of another if few: compiled once for each."""
    q, laser, phi, station = arrays
    full = (np.asarray(q, np.float64), np.asarray(laser, np.int32), np.asarray(phi, np.float64), station)
    names = tuple(map(str, range(len(scanner.laser_names))))
    bare = Scanner(scanner.camera, scanner.lasers, scanner.turntable, None, names, scanner.up)
    parts = []
    block = _SMALL_BLOCK if len(q) <= _SMALL_BLOCK else _BLOCK
    with jax.enable_x64(True):
        for begin in range(0, max(len(q), 1), block):
            some = [array[begin : begin + block] for array in full]
            count = len(some[0])
            padded = [np.concatenate([a, np.zeros((block - count, *a.shape[1:]), a.dtype)]) for a in some]
            parts.append([np.asarray(leaf)[:count] for leaf in function(bare, *padded)])
    return [np.concatenate(leaves) for leaves in zip(*parts, strict=True)]


@compiled
def _points(scanner: Scanner, q: Array, laser: Array, phi: Array, station: Array) -> tuple[Array, Array]:
    return jax.vmap(partial(room_point, scanner))(station, q, laser, phi)


# Of every cell of a sweep: worth its optimisation where all else is compiled in haste.
@partial(compiled, xla_backend_optimization_level=3)
def _gradients(scanner: Scanner, q: Array, laser: Array, phi: Array, station: Array) -> tuple[Array, Array, Array]:
    zero = jnp.zeros(len(scanner.parameter_names()), q.dtype)

    def one(station, q, laser, phi):
        where = lambda step, q, phi: room_point(scanner.retract(step), station, q, laser, phi)[0]
        return jax.jacrev(where, argnums=(0, 1, 2))(zero, q, phi)

    return jax.vmap(one)(station, q, laser, phi)
