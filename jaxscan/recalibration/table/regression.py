"""A step in the table's angle as one more unknown of a linear least squares, for every record at once."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


class Rows(NamedTuple):
    """Whitened equations `error = nuisance @ unknowns + turn * (angle of the record)`, sorted by record."""

    error: Float[np.ndarray, " rows"]
    turn: Float[np.ndarray, " rows"]
    """Derivative by the angle about the axis of the row's record [1/rad]."""
    nuisance: Float[np.ndarray, "rows unknowns"]
    record: Int[np.ndarray, " rows"]


class Prior(NamedTuple):
    """Prior knowledge of the unknowns."""

    mean: Float[np.ndarray, " unknowns"]
    sigma: Float[np.ndarray, " unknowns"]


class StepTest(NamedTuple):
    """The step that each record would need."""

    size: Float[np.ndarray, " records"]
    """Angle by which this and all later records stand ahead of their angle [rad]."""
    sigma: Float[np.ndarray, " records"]
    """Its standard deviation; infinite where nothing tells it [rad]."""


def solve(rows: Rows, prior: Prior) -> Float[np.ndarray, " unknowns"]:
    """The unknowns of least squares; errors that are larger than noise widen all that is learned from them."""
    n = rows.nuisance
    weight = max(1.0, float(np.mean(rows.error**2))) / prior.sigma**2
    return np.linalg.solve(n.T @ n + np.diag(weight), n.T @ rows.error + weight * prior.mean)


def fit_steps(rows: Rows, records: int, prior: Prior) -> tuple[StepTest, Float[np.ndarray, " rows"]]:
    r"""The step of every record, each fitted with all other unknowns but without the other steps.

    With N the nuisance, r the error after their fit, and c the column of a step (`turn` from its record on),
    $$\delta = c^T r / (c^T c - c^T N (N^T N)^{-1} N^T c)$$
    where all products are sums from the last record back.

    Args:
        rows: Equations.
        records: How many records there are.
        prior: Of the unknowns.

    Returns:
        The steps, and the errors after the fit of the nuisance.
    """
    n = rows.nuisance
    normal = n.T @ n + np.diag(1.0 / prior.sigma**2)
    scale = np.sqrt(np.diag(normal))
    inverse = np.linalg.inv(normal / np.outer(scale, scale)) / np.outer(scale, scale)
    left = rows.error - n @ (inverse @ (n.T @ rows.error + prior.mean / prior.sigma**2))
    score = backwards(rows.turn * left, rows.record, records)
    own = backwards(rows.turn**2, rows.record, records)
    shared = backwards(rows.turn[:, None] * n, rows.record, records)
    power = own - np.sum((shared @ inverse) * shared, axis=1)
    known = power > 1e-6 * own[:1]
    safe = np.where(known, power, 1.0)
    size = np.where(known, score / safe, 0.0)
    return StepTest(size, np.where(known, 1.0 / np.sqrt(safe), np.inf)), left


def backwards(values: np.ndarray, record: np.ndarray, records: int) -> np.ndarray:
    """Sums over each record and all later ones."""
    if len(record) == 0:
        return np.zeros((records, *values.shape[1:]))
    starts = np.searchsorted(record, np.arange(records))
    whole = np.concatenate([values, np.zeros_like(values[:1])])
    sums = np.add.reduceat(whole, starts, axis=0)
    sums[np.diff(np.append(starts, len(record))) == 0] = 0.0
    return np.cumsum(sums[::-1], axis=0)[::-1]
