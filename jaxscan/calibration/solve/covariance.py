"""Covariance and weak directions from the information at the minimum."""

from typing import NamedTuple

import numpy as np

from jaxscan.calibration.parameters import is_mode
from jaxscan.calibration.solve.joint import Linearised
from jaxscan.leastsq import undetermined


# Directions of which the priors know less than this share are the data's alone.
_LEAST_SHARE = 1e-6


class Determination(NamedTuple):
    """How well the shared unknowns are known."""

    covariance: np.ndarray
    """[shared, shared], in px, rad, m; zero for held unknowns."""
    condition: float
    """Condition number of the information scaled to a unit diagonal."""
    spectrum: tuple[tuple[float, dict[str, float]], ...]
    """Independent directions that priors speak of: the standard deviation along each over that of
    its prior [1], and its largest components by name, in units of their standard deviations."""
    prior_share: float
    """Largest share of the information in any one direction that is the priors' own."""


def undetermined_shares(linearised: Linearised, scales: np.ndarray) -> np.ndarray:
    """How much of each shared unknown is undetermined [shared], 0 ... 1; see `undetermined`."""
    free, shares = np.flatnonzero(scales), np.zeros(len(scales))
    shares[free] = undetermined(linearised.arrow, free)
    return shares


def determine(linearised: Linearised, scales: np.ndarray, names: tuple[str, ...]) -> Determination:
    """Covariance of the shared unknowns from their information, which must be regular."""
    reduced, prior = linearised.reduced, linearised.prior
    free = np.flatnonzero(scales)
    covariance = np.zeros_like(reduced)
    if len(free) == 0:
        return Determination(covariance, 1.0, (), 0.0)
    information = reduced[np.ix_(free, free)]
    size = np.sqrt(np.diag(information))
    eigenvalues, axes = np.linalg.eigh(information / np.outer(size, size))
    # As the product of a matrix and its transpose it is symmetric to the last digit, however weak a direction is.
    half = axes / np.sqrt(eigenvalues) / size[:, None]
    inverse = half @ half.T
    covariance[np.ix_(free, free)] = inverse * np.outer(scales[free], scales[free])
    # Shares of the prior in the information: generalised eigenvalues, 0 (data only) ... 1. Modes of the board
    # are nuisances: of those the priors may know most.
    told = np.array([not is_mode(names[index]) for index in free])
    free, inverse = free[told], inverse[np.ix_(told, told)]
    root = np.linalg.cholesky(inverse)
    shares, vectors = np.linalg.eigh(root.T @ prior[np.ix_(free, free)] @ root)
    sigma = np.sqrt(np.diag(inverse))
    spectrum = []
    for share, vector in zip(shares[::-1], vectors.T[::-1], strict=True):
        if share > _LEAST_SHARE:
            parts = _components((root @ vector) / sigma, free, names)
            spectrum.append((float(np.sqrt(min(share, 1.0))), parts))
    condition = float(eigenvalues[-1] / eigenvalues[0])
    return Determination(covariance, condition, tuple(spectrum), float(shares[-1]))


def _components(direction: np.ndarray, free: np.ndarray, names: tuple[str, ...]) -> dict[str, float]:
    largest = np.argsort(-np.abs(direction))[:3]
    return {names[free[i]]: round(float(direction[i]), 3) for i in largest if abs(direction[i]) > 0.1}
