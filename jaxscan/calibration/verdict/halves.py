"""Cross-validation: two halves of the records, solved apart, must give the same rig."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from jaxscan.calibration.settings import CalibrationSettings
from jaxscan.calibration.solve.adjust import solve_again
from jaxscan.calibration.solve.adjustment import Adjustment


# Directions of which one half of the records knows less than this share beyond the priors.
_PRIOR_HELD = 0.05


class Halves(NamedTuple):
    """Two calibrations from half of the records each; scaled units of the unknowns that are free."""

    difference: np.ndarray
    """Of the first and the second half's unknowns [free]."""
    free: np.ndarray
    """bool [shared]: which unknowns those are."""
    root: np.ndarray
    """Root of the covariance of the difference, with the priors' part [free, free]."""
    scatter: np.ndarray
    """Share of noise, in units of that root, along the independent directions [free]."""
    directions: np.ndarray
    """Those directions [free, free], as columns."""

    @property
    def dof(self) -> int:
        """Directions that the data know beyond the priors."""
        return int(np.count_nonzero(self.scatter > _PRIOR_HELD))

    def distance(self, systematic: np.ndarray | None = None) -> float:
        """Square of the difference in units of its standard deviation.

        Args:
            systematic: Covariance of the error of the whole calibration beside that of noise [free, free].
        """
        seen = self.scatter > _PRIOR_HELD
        whiten = self.directions[:, seen].T @ np.linalg.inv(self.root)
        covariance = np.diag(self.scatter[seen])
        if systematic is not None:
            # A mean of two errors that are independent has half the sigma of one, their difference twice that.
            covariance = covariance + 4.0 * whiten @ systematic @ whiten.T
        parts = whiten @ self.difference
        return float(parts @ np.linalg.solve(covariance, parts))


def compare_halves(
    result: Adjustment, settings: CalibrationSettings, promise: tuple[float, np.ndarray | float]
) -> Halves | None:
    """Two calibrations from half of the records each; None where they cannot be had.

    Records are dealt out in turn inside each placement, so that both halves keep several angles. Weights of corners
    and stripes are multiplied by `promise`.
    """
    half = deal_halves(np.asarray(result.data.placement), result.view_kept & result.data.usable)
    if min(np.count_nonzero(half == 0), np.count_nonzero(half == 1)) < 3:
        return None
    steps, sampling, total = [], [], []
    free = np.asarray(result.problem.scales) > 0
    for side in (0, 1):
        views = half == side
        stripes = views[result.data.stripe_view]
        problem = replace(
            result.problem,
            seen=result.problem.seen & views,
            lit=result.problem.lit & stripes,
            corner_weight=result.problem.corner_weight * views[:, None] * promise[0],
            stripe_weight=result.problem.stripe_weight * stripes[:, None] * promise[1],
        )
        solution = solve_again(problem, settings)
        known = solution.linearised
        reduced, prior = (part[np.ix_(free, free)] for part in (known.reduced, known.prior))
        # Rounding may leave a little less than 0 for unknowns that half of the records do not show.
        size = np.sqrt(np.maximum(np.diag(reduced), 0.0))
        if not np.all(size > 0) or not solution.converged:
            return None
        correlation = reduced / np.outer(size, size)
        if np.linalg.eigvalsh(correlation)[0] < len(size) * np.finfo(float).eps:
            return None
        covariance = np.linalg.inv(correlation) / np.outer(size, size)
        # Priors are the same in both halves, so they scatter nothing.
        sampling.append(covariance @ (reduced - prior) @ covariance)
        total.append(covariance)
        steps.append(solution.shared[free])
    root = np.linalg.cholesky(total[0] + total[1])
    scatter = np.linalg.solve(root, np.linalg.solve(root, sampling[0] + sampling[1]).T)
    return Halves(steps[0] - steps[1], free, root, *np.linalg.eigh(0.5 * (scatter + scatter.T)))


def deal_halves(placement: np.ndarray, used: np.ndarray) -> np.ndarray:
    """0 or 1 for every view that is used, else -1: in turn among views alone, and inside each placement."""
    half = np.full(len(placement), -1)
    count = np.bincount(placement[used], minlength=len(placement))
    alone = used & (count[placement] == 1)
    half[alone] = np.arange(alone.sum()) % 2
    for start, number in enumerate(np.flatnonzero(count > 1)):
        views = np.flatnonzero(used & (placement == number))
        half[views] = (np.arange(len(views)) + start) % 2
    return half
