"""Observed errors of calibrations against their stated covariances."""

from typing import NamedTuple

import numpy as np

from experiments.worlds.calibration_trials import errors, to_true_tangents
from jaxscan.geometry import Scanner
from jaxscan.geometry.motions import ANGLE_PARAMETERS
from jaxscan.simulation import SimulationConfig


AGREE = 0.8, 1.2
"""Observed over predicted errors must lie between these."""
ENOUGH = 10
"""Fewest draws for that limit: with fewer, the standard error of a spread is over 20 %."""


class Honesty(NamedTuple):
    """Errors over their predicted standard deviations."""

    names: tuple[str, ...]
    """Parameters that are compared."""
    pooled: float
    """Root mean square of errors about the truth, each over its predicted standard deviation; a bias counts."""
    pooled_error: float
    """Its standard error from draw to draw, without a bias that all draws share."""
    spread: float
    """The same about the mean of the draws."""
    spread_error: float
    squared: float
    """Mean of e' C⁻¹ e per parameter, errors about the truth; 1 is expected."""
    squared_error: float


def compare(scanners: list[Scanner], config: SimulationConfig) -> Honesty:
    """Compare calibrations of independent draws.

    Held parameters are left out, and those of the table's angle: a few degrees hardly determine them, so their
    predicted errors are those of their priors, from which the true rig was not drawn.

    Args:
        scanners: Calibrations with the same free parameters.
        config: The true rig.
    """
    names = scanners[0].parameter_names()
    turned = [to_true_tangents(scanner, config) for scanner in scanners]
    error = np.array([turn @ errors(scanner, config) for turn, scanner in zip(turned, scanners, strict=True)])
    covariance = np.array(
        [turn @ np.asarray(one.covariance) @ turn.T for turn, one in zip(turned, scanners, strict=True)]
    )
    free = (np.diagonal(covariance, axis1=1, axis2=2) > 0).all(0)
    free &= np.array([name not in ANGLE_PARAMETERS for name in names])
    error, covariance = error[:, free], covariance[:, free][:, :, free]
    squared = np.array([e @ np.linalg.solve(c, e) for e, c in zip(error, covariance, strict=True)]) / error.shape[1]
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    count = len(error)
    return Honesty(
        tuple(np.array(names)[free]),
        *_root_mean_square(error**2 / variance),
        *_root_mean_square((error - error.mean(0)) ** 2 / variance * count / (count - 1)),
        float(squared.mean()),
        float(squared.std(ddof=1) / np.sqrt(count)),
    )


def _root_mean_square(squares: np.ndarray) -> tuple[float, float]:
    """Of squares [draws, parameters], with its standard error; draws are independent, parameters are not."""
    root = float(np.sqrt(squares.mean()))
    return root, float(squares.mean(1).std(ddof=1) / np.sqrt(len(squares)) / (2 * root))
