"""How far the calibration's uncertainty moves points."""

import numpy as np
from jaxtyping import Float, Int

from jaxscan.geometry import Scanner, root_of
from jaxscan.recalibration.adjust import point_gradient


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


def likely_steps(scanner: Scanner) -> Float[np.ndarray, "directions params"]:
    """Steps of the scanner by one standard deviation, independent of one another: its covariance, and a drift.

    The largest first.
    """
    names = scanner.parameter_names()
    loose = np.array([_LOOSE.get(name, _LOOSE.get(name.rsplit(".", 1)[-1], 0.0)) for name in names])
    covariance = np.diag(loose**2)
    if scanner.covariance is not None:
        covariance = covariance + np.asarray(scanner.covariance, np.float64)
    steps = root_of(covariance)[::-1][:_DIRECTIONS]
    return steps[steps.any(1)]


def bending(
    scanner: Scanner,
    q: Float[np.ndarray, "points 2"],
    laser: Int[np.ndarray, " points"],
    phi: Float[np.ndarray, " points"],
) -> Float[np.ndarray, "points 3 directions"]:
    """Shifts of points [m] by each of the `likely_steps`.

    Args:
        scanner: The calibrated rig.
        q: Pixels of the stripes (u, v) [px].
        laser: The sheet of each.
        phi: The table's angle of each [rad], or the position of a stage [m].
    """
    by_scanner = point_gradient(scanner, q, laser, phi)
    return (by_scanner @ likely_steps(scanner).T).astype(np.float32)
