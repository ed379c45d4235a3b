"""Roots of covariances: steps along independent directions."""

import numpy as np
from jaxtyping import Float


def root_of(covariance: Float[np.ndarray, "params params"]) -> Float[np.ndarray, "params params"]:
    """Steps, one a row, whose outer products add up to a covariance."""
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    # Pixels and radians differ by a million: in units of sigma all directions are of one size.
    unit = np.where(sigma > 0, sigma, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))
    return (unit[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))).T
