"""Points of stripes in double precision, and how far the calibration's uncertainty moves them."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxscan.geometry import Scanner


_BATCH = 16_384
"""Points of one call: one shape, so that one function is compiled."""
_LOOSE = {
    "n1": 1e-3,
    "n2": 1e-3,
    "d": 3e-4,
    "axis.d1": 1e-3,
    "axis.d2": 1e-3,
    "axis.p1": 3e-4,
    "axis.p2": 3e-4,
    "gain": 2e-4,
    "c1": 3e-4,
    "s1": 3e-4,
    "c2": 3e-4,
    "s2": 3e-4,
}
"""Standard deviations of a drift that no covariance states, by which walls may be bent as well [rad, m]."""
_DIRECTIONS = 24
"""Directions of the covariance that are used at most."""


def triangulate(
    scanner: Scanner,
    q: Float[np.ndarray, "points 2"],
    laser: Int[np.ndarray, " points"],
    phi: Float[np.ndarray, " points"],
    step: Float[np.ndarray, " params"] | None = None,
) -> tuple[Float[np.ndarray, "points 3"], Float[np.ndarray, " points"]]:
    """Points of stripe pixels, in the scanner's frame.

    Args:
        scanner: The calibrated rig.
        q: Pixels (u, v) [px].
        laser: The sheet of each.
        phi: The table's angle of each [rad], or the position of a stage [m].
        step: Added to the scanner in its minimal coordinates; nothing without it.

    Returns:
        points: [m].
        incidence: Positive where the point exists.
    """
    count = len(q)
    points, incidence = np.zeros((count, 3)), np.zeros(count)
    with jax.enable_x64(True):
        bare = scanner.without_covariance().as_dtype(jnp.float64)
        moved = jnp.zeros(len(scanner.parameter_names())) if step is None else jnp.asarray(step, jnp.float64)
        for start in range(0, count, _BATCH):
            part = slice(start, min(start + _BATCH, count))
            short = _BATCH - (part.stop - part.start)
            pixels = np.pad(np.asarray(q[part], np.float64), ((0, short), (0, 0)), mode="edge")
            sheet, angle = (np.pad(x[part], (0, short), mode="edge") for x in (laser, phi))
            found = _points(
                bare, moved, jnp.asarray(pixels), jnp.asarray(sheet, jnp.int32), jnp.asarray(angle, jnp.float64)
            )
            points[part], incidence[part] = (np.asarray(x)[: part.stop - part.start] for x in found)
    return points, incidence


@jax.jit
def _points(scanner, step, q, laser, phi):
    moved = scanner.retract(step)
    return jax.vmap(moved.point)(q, laser, phi)


def likely_steps(scanner: Scanner) -> Float[np.ndarray, "directions params"]:
    """Steps of the scanner by one standard deviation, independent of one another: its covariance, and a drift.

    The largest first.
    """
    names = scanner.parameter_names()
    loose = np.array([_LOOSE.get(name, _LOOSE.get(name.rsplit(".", 1)[-1], 0.0)) for name in names])
    covariance = np.diag(loose**2)
    if scanner.covariance is not None:
        covariance = covariance + np.asarray(scanner.covariance, np.float64)
    # In units of each parameter's own standard deviation, so that pixels and metres compare.
    unit = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    safe = np.where(unit > 0, unit, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(safe, safe))
    steps = (vectors * np.sqrt(np.maximum(values, 0.0))).T * safe
    return steps[::-1][:_DIRECTIONS][values[::-1][:_DIRECTIONS] > 1e-12]


def bending(
    scanner: Scanner,
    points: Float[np.ndarray, "points 3"],
    q: Float[np.ndarray, "points 2"],
    laser: Int[np.ndarray, " points"],
    phi: Float[np.ndarray, " points"],
) -> Float[np.ndarray, "points 3 directions"]:
    """Shifts of points [m] by each of the `likely_steps`."""
    small, steps = 0.1, likely_steps(scanner)
    shifts = np.zeros((len(points), 3, len(steps)), np.float32)
    for k, step in enumerate(steps):
        moved, incidence = triangulate(scanner, q, laser, phi, small * step)
        shifts[..., k] = np.where((incidence > 0)[:, None], moved - points, 0.0) / small
    return shifts
