"""The bow of a laser sheet: a stored calibration that holds it at 0 says that of the model, not of the rig.

Walls show the stripe over the whole field, from far away, so they see a bow that boards did not. Held at 0 it bends
every wall, and looks like a drift.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscan.calibration.chi_squared import chance_of
from jaxscan.calibration.parameters import PRIORS
from jaxscan.geometry import Scanner
from jaxscan.recalibration.judge.compared import Compared, compare


class Bow(NamedTuple):
    """Findings of a solve on bows that the stored calibration holds."""

    step: Float[np.ndarray, " held"]
    sigma: Float[np.ndarray, " held"]
    p: float
    """Chance of so large a bow on flat sheets [1]."""


def held_bow(stored: Scanner) -> list[int]:
    """Positions of the coefficients of bows that the covariance holds."""
    variance = np.diag(np.asarray(stored.covariance))
    names = [f"laser.{laser}.{key}" for laser in stored.laser_names for key in ("b2", "b3")]
    return [i for i, name in enumerate(stored.parameter_names()) if name in names and variance[i] <= 0.0]


def bow_variance(stored: Scanner) -> Float[np.ndarray, "params params"]:
    """Variance of held bows, as a calibration has it that knows nothing of them."""
    added = np.zeros_like(np.asarray(stored.covariance))
    at = held_bow(stored)
    added[at, at] = PRIORS["bow"] ** 2
    return added


def bow_of(compared: Compared, step: Float[np.ndarray, " params"], at: list[int]) -> Bow:
    """How far the bows are from 0 in a solve that had them free.

    Args:
        compared: Its prior and posterior.
        step: From the stored scanner to its result.
        at: Positions of the bows.
    """
    value, covariance = np.asarray(step)[at], compared.posterior[np.ix_(at, at)]
    p = chance_of(float(value @ np.linalg.solve(covariance, value)), len(at))
    return Bow(value, np.sqrt(np.diag(covariance)), p)


def without_bow(compared: Compared, at: list[int]) -> Compared:
    """The same of all other coordinates, whatever the bows are: a bow is no drift."""
    prior = compared.prior.copy()
    prior[at, :], prior[:, at] = 0.0, 0.0
    return compare(prior, compared.posterior)
