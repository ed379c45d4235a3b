"""The same points scanned again, with the scanner moved by one standard deviation along each independent direction.

Nothing is differentiated: half of the change from back to forth stands for the derivative.
"""

import jax
import numpy as np
from jaxtyping import Float, Int

from jaxscan.calibration.verdict.lit import bare
from jaxscan.compiling import compile_quickly
from jaxscan.geometry import Array, Scanner
from jaxscan.geometry.rigid import transform


_BLOCK = 512


def sigma_steps(scanner: Scanner) -> np.ndarray:
    """No step, then one standard deviation forth along each independent direction, then back [steps, params].

    Raises:
        ValueError: If the scanner has no covariance.
    """
    if scanner.covariance is None:
        raise ValueError("The scanner has no covariance, so nothing can be said about its lengths.")
    covariance = np.asarray(scanner.covariance, np.float64)
    return pad_steps(scanner, root_of(covariance))


def root_of(covariance: Float[np.ndarray, "params params"]) -> Float[np.ndarray, "params params"]:
    """Steps whose outer products add up to a covariance."""
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    # Pixels and radians differ by a million: in units of sigma all directions are of one size.
    unit = np.where(sigma > 0, sigma, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))
    return (unit[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))).T


def pad_steps(scanner: Scanner, steps: Float[np.ndarray, "steps params"]) -> np.ndarray:
    """No step, then the given ones forth, then back, as many as `sigma_steps` has [steps, params].

    Raises:
        ValueError: If there are more steps than parameters.
    """
    count = len(scanner.parameter_names())
    if len(steps) > count:
        raise ValueError(f"{len(steps)} steps are more than {count}.")
    forth = np.zeros((count, count))
    forth[: len(steps)] = steps
    return np.concatenate([np.zeros((1, count)), forth, -forth])


def no_steps(scanner: Scanner) -> np.ndarray:
    """Steps of length 0 [steps, params]."""
    # As many as `sigma_steps` has: then both are one compilation.
    return np.zeros((1 + 2 * len(scanner.parameter_names()), len(scanner.parameter_names())))


def change(values: np.ndarray) -> np.ndarray:
    """Half of the change of a quantity [steps, ...] from back to forth, for each direction."""
    count = len(values) // 2
    return (values[1 : 1 + count] - values[1 + count :]) / 2.0


def sigma_of(values: np.ndarray) -> np.ndarray:
    """Standard deviation of a quantity [steps, ...] at the steps of `sigma_steps`."""
    return np.sqrt(np.sum(change(values) ** 2, axis=0))


def scan_points(
    scanner: Scanner, steps: np.ndarray, q: np.ndarray, laser: np.ndarray | int, angle: np.ndarray | float = 0.0
) -> np.ndarray:
    """Points in the camera frame at angle 0, with the scanner moved by each step [steps, points, 3]."""
    laser = np.broadcast_to(np.asarray(laser, np.int32), len(q))
    angle = np.broadcast_to(np.asarray(angle, np.float64), len(q))
    # Padded, so that one compilation serves all.
    index = np.resize(np.arange(len(q)), -(-len(q) // _BLOCK) * _BLOCK)
    with jax.enable_x64(True):
        parts = [_scan(bare(scanner), steps, q[i], laser[i], angle[i]) for i in index.reshape(-1, _BLOCK)]
        return np.concatenate([np.asarray(part) for part in parts], axis=1)[:, : len(q)]


@compile_quickly
def _scan(
    scanner: Scanner,
    steps: Float[Array, "steps params"],
    q: Float[Array, "n 2"],
    laser: Int[Array, " n"],
    angle: Float[Array, " n"],
) -> Float[Array, "steps n 3"]:
    def one(scanner, q, laser, phi):
        ray = scanner.camera.unproject(q)
        range_m, _ = scanner.laser(laser).intersect(ray)
        return transform(scanner.turntable.motion(phi), range_m * ray)

    every = jax.vmap(one, in_axes=(None, 0, 0, 0))
    return jax.lax.map(lambda step: every(scanner.retract(step), q, laser, angle), steps)
