"""Roots of covariances and of informations, in units of each parameter's own size."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


# Relative eigenvalue of a matrix of unit diagonal that counts as rounding: its direction is dropped.
_SINGULAR = 1e-13


class Root(NamedTuple):
    """A square root R of a matrix, R' R, by its eigenvectors; the smallest eigenvalues come first."""

    steps: Float[np.ndarray, "params params"]
    """R: one direction a row, of the length of one standard deviation where the matrix is a covariance; 0 where there
    is none."""
    inverse: Float[np.ndarray, "params params"]
    """Its pseudo-inverse."""


def square_root(matrix: Float[np.ndarray, "params params"]) -> Root:
    """The root of a symmetric matrix without negative directions; rows of 0 are parameters that are held."""
    size = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    # Pixels and radians differ by a million: in units of their own sizes all directions are comparable.
    unit = np.where(size > 0, size, 1.0)
    values, axes = np.linalg.eigh(np.where(np.outer(size, size) > 0, matrix / np.outer(unit, unit), 0.0))
    there = values > _SINGULAR * max(values[-1], 1.0) if len(values) else values > 0
    root = np.sqrt(np.where(there, values, 1.0))
    return Root(np.where(there, axes * root, 0.0).T * size, np.where(there, axes / root, 0.0) / unit[:, None])


def root_of(covariance: Float[np.ndarray, "params params"]) -> Float[np.ndarray, "params params"]:
    """Steps, one a row, whose outer products add up to a covariance."""
    return square_root(covariance).steps
