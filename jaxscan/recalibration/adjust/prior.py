"""The stored calibration as a prior: a square root of its covariance, and departures from its scanner."""

from collections.abc import Mapping

import jax
import numpy as np
from jaxtyping import Float

from jaxscan.errors import CalibrationError
from jaxscan.geometry import Scanner, square_root


def prior_root(
    scanner: Scanner, loosened: Mapping[str, float]
) -> tuple[Float[np.ndarray, "params params"], Float[np.ndarray, "params params"]]:
    r"""A square root A of the covariance, $C = A A^T$, by the eigenvectors of the correlations.

    A step of the scanner is $A z$ with $z$ normal: every unknown has size 1 however badly the covariance is
    scaled, and directions without variance are held, since their columns are zero.

    Args:
        scanner: With the covariance of its minimal coordinates.
        loosened: Standard deviations that are added, by the name of the coordinate.

    Returns:
        root: A.
        inverse: Its pseudo-inverse, which takes a step to z.

    Raises:
        CalibrationError: If there is no covariance, or it is not one.
    """
    names = scanner.parameter_names()
    if scanner.covariance is None:
        raise CalibrationError(
            "The stored calibration has no covariance, so nothing says how far it may be off: calibrate from boards "
            "again, and recalibrate from that file."
        )
    covariance = np.asarray(scanner.covariance, np.float64)
    if covariance.shape != (len(names), len(names)) or not np.isfinite(covariance).all():
        raise CalibrationError(
            f"The stored calibration's covariance has shape {covariance.shape} or is not finite, expected "
            f"{len(names)} x {len(names)} numbers: calibrate from boards again."
        )
    unknown = sorted(set(loosened) - set(names))
    if unknown:
        raise CalibrationError(f"loosened: found {unknown[0]!r}, expected one of {', '.join(names)}.")
    added = np.array([loosened.get(name, 0.0) for name in names])
    covariance = (covariance + covariance.T) / 2 + np.diag(added**2)
    root = square_root(covariance)
    return root.steps.T, root.inverse.T


def departure(before: Scanner, after: Scanner) -> Float[np.ndarray, " params"]:
    """How far a scanner is from another of the same kind, in the minimal coordinates of `before` [px, rad, m]."""
    with jax.enable_x64(True):
        parts = [np.asarray(after.camera.parameters()) - np.asarray(before.camera.parameters())]
    for index in range(len(before.laser_names)):
        old, new = before.laser(index), after.laser(index)
        parts += [np.asarray(old.basis) @ (np.asarray(new.normal) - np.asarray(old.normal))]
        parts += [np.atleast_1d(new.distance - old.distance), np.asarray(new.bow - old.bow)]
    parts.append(np.asarray(before.turntable.departure(after.turntable)))
    return np.concatenate(parts).astype(np.float64)
