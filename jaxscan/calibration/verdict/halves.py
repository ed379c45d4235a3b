"""Cross-validation: two halves of the records, solved apart, must give the same rig."""

import equinox as eqx
import numpy as np

from jaxscan.calibration.settings import CalibrationSettings
from jaxscan.calibration.solve.adjust import Adjustment, linearise_compiled, solve_compiled


# Directions of which one half of the records knows less than this share beyond the priors.
_PRIOR_HELD = 0.05


def compare_halves(
    result: Adjustment, settings: CalibrationSettings, promise: tuple[float, float]
) -> tuple[float, int] | None:
    """Distance of two calibrations from half of the records each, chi-squared; None where they cannot be had.

    Records are dealt out in turn inside each placement, so that both halves keep several angles.
    """
    half = deal_halves(np.asarray(result.data.placement), result.view_kept & result.data.usable)
    if min(np.count_nonzero(half == 0), np.count_nonzero(half == 1)) < 3:
        return None
    steps, sampling, total = [], [], []
    for side in (0, 1):
        views = half == side
        stripes = views[result.data.stripe_view]
        problem = eqx.tree_at(
            lambda p: (p.corner_weight, p.stripe_weight),
            result.problem,
            (
                result.problem.corner_weight * views[:, None] * promise[0],
                result.problem.stripe_weight * stripes[:, None] * promise[1],
            ),
        )
        solution = solve_compiled(problem, settings)
        known = linearise_compiled(solution.problem)
        free = np.asarray(problem.scales) > 0
        reduced, prior = (np.asarray(part)[np.ix_(free, free)] for part in (known.reduced, known.prior))
        # Rounding may leave a little less than 0 for unknowns that half of the records do not show.
        size = np.sqrt(np.maximum(np.diag(reduced), 0.0))
        if not np.all(size > 0) or not bool(solution.converged):
            return None
        correlation = reduced / np.outer(size, size)
        if np.linalg.eigvalsh(correlation)[0] < len(size) * np.finfo(float).eps:
            return None
        covariance = np.linalg.inv(correlation) / np.outer(size, size)
        # Priors are the same in both halves, so they scatter nothing.
        sampling.append(covariance @ (reduced - prior) @ covariance)
        total.append(covariance)
        steps.append(np.asarray(solution.step.shared)[free])
    root = np.linalg.cholesky(total[0] + total[1])
    scatter = np.linalg.solve(root, np.linalg.solve(root, sampling[0] + sampling[1]).T)
    values, vectors = np.linalg.eigh(0.5 * (scatter + scatter.T))
    seen = values > _PRIOR_HELD
    parts = (vectors.T @ np.linalg.solve(root, steps[0] - steps[1]))[seen] ** 2 / values[seen]
    return float(parts.sum()), int(seen.sum())


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
