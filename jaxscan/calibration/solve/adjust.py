"""The joint solve round the solver: robust start, rejection of outliers, estimate of the noise."""

from dataclasses import replace

import numpy as np

from jaxscan.calibration.settings import CalibrationSettings
from jaxscan.calibration.solve.adjustment import Adjustment, Errors, correlation_along
from jaxscan.calibration.solve.covariance import undetermined_shares
from jaxscan.calibration.solve.joint import Linearised, Solution, linearise, solve
from jaxscan.calibration.solve.prepare import Prepared
from jaxscan.calibration.solve.problem import Problem, with_stop_sigma
from jaxscan.calibration.solve.stops import learn_stop_sigma
from jaxscan.errors import CalibrationError
from jaxscan.geometry import Array
from jaxscan.leastsq import Huber, keep_inliers, robust_noise
from jaxscan.observation import CONTRAST_CLASSES


# Damping at the start of a solve, relative to J'J: cautious from a seed, a plain Gauss-Newton
# step where the last solve ended beside the minimum.
_SEED_DAMPING = 1e-4
_NEAR_DAMPING = 1e-10
# Root mean square change of whitened residuals and scaled unknowns at which a solve stops: while
# weights still change, and at the end (convergence is nearly quadratic, so less than that is left).
_ROUGH = 1e-3
_FINE = 1e-7
_ROBUST_ROUNDS = 3
_REJECTION_ROUNDS = 6
# A view that loses more of its corners than this is wrong as a whole.
_MAX_LOST = 0.2
_SETTLED = 0.01
# Standard deviation of noise with long tails over that by the median, at most.
_LONG_TAILS = 1.5


def adjust(problem: Problem, data: Prepared, settings: CalibrationSettings, *, rejection: bool = True) -> Adjustment:
    """Solve robustly, drop outliers, estimate the noise of each group, solve to the end.

    Plain least squares at the end keeps the estimate that of maximum likelihood, and its
    covariance meaningful. With `rejection` False only the robust part runs. Nothing is rejected
    where the observations leave parameters undetermined: further solves would drift along those,
    and their residuals would condemn good views.

    Raises:
        CalibrationError: If the solve breaks down.
    """
    kept = data.corner_valid, data.stripe_valid, data.usable
    state = Adjustment(*_at(problem, data), data, *kept)
    if settings.stripe_correlation is not None:
        state = replace(state, stripe_correlation=settings.stripe_correlation)
    for round_number in range(_ROBUST_ROUNDS):
        corner, stripe = state.errors.corner, state.errors.stripe
        noise = robust_noise(corner[data.corner_valid]), state.robust_stripe_noise()
        damp = (
            Huber(settings.huber).weights(np.abs(corner).max(-1) / noise[0]),
            Huber(settings.huber).weights(np.abs(stripe) / noise[1][data.stripe_contrast]),
        )
        # A view whose stop errs is no outlier; nothing is learned from first values.
        stop_sigma = _stop_sigma(state, settings) if round_number > 0 else None
        state = replace(state, corner_noise=noise[0], stripe_noise=noise[1])
        state = _solved(state, settings, _ROUGH, damp, stop_sigma)
        # Without outliers there is nothing to be robust against.
        largest = max(
            _largest(state.errors.corner, data.corner_valid), _largest(state.errors.stripe, data.stripe_valid)
        )
        if largest < settings.reject_any:
            break
    if rejection and not undetermined_shares(state.linearised, np.asarray(problem.scales)).any():
        state = _reject(state, settings)
    return state


def adjust_further(result: Adjustment, problem: Problem, settings: CalibrationSettings) -> Adjustment:
    """Solve on from where a solve ended, with other unknowns; outliers and noise are found again.

    Args:
        result: The finished solve.
        problem: The same observations, seen from the same point.
        settings: Of the solve.

    Raises:
        CalibrationError: If the solve breaks down.
    """
    start = replace(result, linearised=linearise(problem))
    return _reject(_solved(start, settings, _ROUGH), settings)


def _reject(state: Adjustment, settings: CalibrationSettings) -> Adjustment:
    data = state.data
    limits = {"reject_any": settings.reject_any, "reject_all": settings.reject_all}
    for round_number in range(_REJECTION_ROUNDS):
        errors, size = state.errors, (1.0, np.ones(CONTRAST_CLASSES))
        if settings.estimate_noise:
            # Outliers that are still in must not make room for themselves; honest noise with long
            # tails may.
            robust = robust_noise(errors.corner[data.corner_valid]), state.robust_stripe_noise()
            kept = state.whitened_rms()[0], state.kept_stripe_noise()
            size = min(kept[0], _LONG_TAILS * robust[0]), np.minimum(kept[1], _LONG_TAILS * robust[1])
        corner_room = _room(state.linearised.corner_leverage).reshape(errors.corner.shape)
        corner_size = (np.abs(errors.corner) / corner_room).max(-1) / size[0]
        stripe_size = np.abs(errors.stripe) / _room(state.linearised.stripe_leverage)
        stripe_size = stripe_size / size[1][data.stripe_contrast]
        corner_kept = keep_inliers(corner_size, data.corner_valid, state.corner_kept, **limits)
        stripe_kept = keep_inliers(stripe_size, data.stripe_valid, state.stripe_kept, **limits)
        lost = (data.corner_valid & ~corner_kept).sum(1) > _MAX_LOST * data.corner_valid.sum(1)
        view_kept = state.view_kept & ~lost
        if view_kept.sum() < 3 <= state.view_kept.sum():
            raise _too_few_views(int(view_kept.sum()), state, settings)
        corner_kept = corner_kept & view_kept[:, None]
        stripe_kept = stripe_kept & view_kept[data.stripe_view][:, None]
        cleaned = replace(state, corner_kept=corner_kept, stripe_kept=stripe_kept)
        noise = 1.0, np.ones(CONTRAST_CLASSES)
        if settings.estimate_noise:
            noise = cleaned.whitened_rms()[0], cleaned.kept_stripe_noise()
        correlation = state.stripe_correlation
        if settings.stripe_correlation is None:
            # Classes of unlike noise would hide the noise that neighbours share.
            correlation = correlation_along(errors.stripe / noise[1][data.stripe_contrast], stripe_kept)
        before, stop_sigma = float(state.problem.stop_sigma), _stop_sigma(state, settings)
        same = np.array_equal(corner_kept, state.corner_kept) and np.array_equal(stripe_kept, state.stripe_kept)
        ratios = (
            noise[0] / state.corner_noise,
            *(noise[1] / state.stripe_noise),
            correlation / state.stripe_correlation,
            stop_sigma / before,
        )
        settled = same and max(abs(ratio - 1.0) for ratio in ratios) < _SETTLED
        if settled and round_number > 0:
            break
        cleaned = replace(
            cleaned,
            view_kept=view_kept,
            corner_noise=noise[0],
            stripe_noise=noise[1],
            stripe_correlation=correlation,
        )
        state = _solved(cleaned, settings, _FINE, stop_sigma=stop_sigma)
    return state


def _stop_sigma(state: Adjustment, settings: CalibrationSettings) -> float:
    scales = np.asarray(state.problem.scales)
    if settings.angle_sigma is not None or undetermined_shares(state.linearised, scales).any():
        return float(state.problem.stop_sigma)
    return learn_stop_sigma(state.linearised)


def solve_again(problem: Problem, settings: CalibrationSettings) -> Solution:
    """Solve again from near the minimum; call in 64 bit."""
    return solve(problem, _NEAR_DAMPING, _FINE, settings.max_steps)


def not_converged(settings: CalibrationSettings) -> str:
    """The one sentence about a solve that did not converge: from its numbers nothing follows."""
    return (
        f"The solve did not converge in {settings.max_steps} step{'s' if settings.max_steps > 1 else ''}, so its "
        "numbers say nothing: allow more (`max_steps` in Python), or capture more boards, tilted and at several "
        "distances."
    )


def _too_few_views(kept: int, state: Adjustment, settings: CalibrationSettings) -> CalibrationError:
    if not state.converged:
        return CalibrationError(not_converged(settings))
    return CalibrationError(
        f"Only {kept} of {state.view_kept.sum()} views agree with each other, and a camera needs at least 3: check "
        "that all views show the board that [board] in capture.toml describes, sharp and flat, and capture more."
    )


def _room(leverage: np.ndarray) -> np.ndarray:
    return np.sqrt(np.clip(1.0 - leverage, 0.05, 1.0))


def _largest(residual: np.ndarray, valid: np.ndarray) -> float:
    values = np.abs(residual[valid])
    return float(values.max() / robust_noise(values)) if values.size else 0.0


def _whitened(corner: Array, offset: Array, slope: Array, data: Prepared) -> Errors:
    slopes = np.where(data.stripe_valid & (slope > 0), slope, 1.0)
    pixels = np.asarray(corner).reshape(data.corner_q.shape)
    errors = Errors(
        np.where(data.corner_valid[..., None], pixels / data.corner_sigma[..., None], 0.0),
        np.where(data.stripe_valid, offset / (slopes * data.stripe_sigma), 0.0),
        slopes,
    )
    if not (np.isfinite(errors.corner).all() and np.isfinite(errors.stripe).all()):
        raise CalibrationError("The solve left the range of numbers: the observations contradict each other.")
    return errors


def _solved(
    state: Adjustment,
    settings: CalibrationSettings,
    tolerance: float,
    damp: tuple[np.ndarray | float, np.ndarray | float] = (1.0, 1.0),
    stop_sigma: float | None = None,
) -> Adjustment:
    """The state after one more solve, in which weights are damped by factors of the corners and the stripes."""
    data = state.data
    corner = state.corner_kept * damp[0] / state.corner_sigma
    stripe = state.stripe_kept * damp[1] / (state.stripe_sigma * state.errors.slope)
    stripe = stripe / np.sqrt(state.stripe_correlation)
    weighted = replace(state.problem, corner_weight=corner, stripe_weight=stripe)
    if stop_sigma is not None:
        weighted = with_stop_sigma(weighted, stop_sigma)
    damping = _SEED_DAMPING if state.steps == 0 else _NEAR_DAMPING
    solution = solve(weighted, damping, tolerance, settings.max_steps)
    return replace(
        state,
        linearised=solution.linearised,
        errors=_errors(solution.linearised, data),
        steps=state.steps + solution.steps,
        converged=solution.converged,
    )


def _at(problem: Problem, data: Prepared) -> tuple[Linearised, Errors]:
    """The problem to first order at the point that it holds."""
    linearised = linearise(problem)
    return linearised, _errors(linearised, data)


def _errors(linearised: Linearised, data: Prepared) -> Errors:
    return _whitened(linearised.corner_error, linearised.offset, linearised.slope, data)
