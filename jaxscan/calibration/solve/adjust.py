"""The joint solve round the solver: robust start, rejection of outliers, estimate of the noise."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np

from jaxscan.calibration.settings import CalibrationSettings
from jaxscan.calibration.solve.covariance import Linearised, linearise
from jaxscan.calibration.solve.levenberg_marquardt import Solution, solve
from jaxscan.calibration.solve.noise import (
    correlation_along,
    huber_weights,
    keep_inliers,
    noise_component,
    robust_noise,
)
from jaxscan.calibration.solve.prepare import Prepared
from jaxscan.calibration.solve.problem import Problem
from jaxscan.errors import CalibrationError
from jaxscan.geometry import Array


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


@dataclass(frozen=True)
class Adjustment:
    """The minimum, and what was kept to get there; arrays padded as `Prepared` is."""

    problem: Problem
    """Seen from the minimum, with its final weights."""
    linearised: Linearised
    corner_error: np.ndarray
    """Projected minus observed corners [views, corners, 2], px; rejected ones too."""
    stripe_error: np.ndarray
    """Sampson error of the stripe points [stripes, points], px; rejected ones too."""
    corner_sigma: np.ndarray
    """Given sigma times the estimated noise [px]."""
    stripe_sigma: np.ndarray
    corner_keep: np.ndarray
    stripe_keep: np.ndarray
    view_keep: np.ndarray
    """Views [views] that were not dropped as a whole."""
    corner_noise: float
    """Estimated noise over the given sigma [1]."""
    stripe_noise: float
    stripe_correlation: float
    """Neighbours along a stripe that share one error [1]."""
    corner_rms: float
    """Whitened by the given sigmas, kept ones, per degree of freedom [1]."""
    stripe_rms: float
    steps: int


class _Errors(NamedTuple):
    """Residuals in units of the given sigmas, and |grad_q e|; 0 and 1 where there is nothing."""

    corner: np.ndarray
    stripe: np.ndarray
    slope: np.ndarray


@dataclass(frozen=True)
class _State:
    problem: Problem
    corner_keep: np.ndarray
    stripe_keep: np.ndarray
    view_keep: np.ndarray
    corner_noise: float = 1.0
    stripe_noise: float = 1.0
    stripe_correlation: float = 1.0
    steps: int = 0


def adjust(problem: Problem, data: Prepared, settings: CalibrationSettings, *, rejection: bool = True) -> Adjustment:
    """Solve robustly, drop outliers, estimate the noise of each group, solve to the end.

    Plain least squares at the end keeps the estimate that of maximum likelihood, and its
    covariance meaningful. With `rejection` False only the robust part runs.

    Raises:
        CalibrationError: If the solve breaks down.
    """
    state = _State(problem, data.corner_valid, data.stripe_valid, data.usable)
    if settings.stripe_correlation is not None:
        state = replace(state, stripe_correlation=settings.stripe_correlation)
    linearised, errors = _at(problem, data)
    for _ in range(_ROBUST_ROUNDS):
        state = replace(
            state,
            corner_noise=robust_noise(errors.corner[data.corner_valid]),
            stripe_noise=robust_noise(errors.stripe[data.stripe_valid]),
        )
        corner_damp = huber_weights(np.abs(errors.corner).max(-1) / state.corner_noise, settings.huber)
        stripe_damp = huber_weights(np.abs(errors.stripe) / state.stripe_noise, settings.huber)
        state, linearised, errors = _solved(state, data, errors, corner_damp, stripe_damp, _ROUGH, settings)
        # Without outliers there is nothing to be robust against.
        largest = max(_largest(errors.corner, data.corner_valid), _largest(errors.stripe, data.stripe_valid))
        if largest < settings.reject_any:
            break
    if rejection:
        state, linearised, errors = _reject(state, linearised, errors, data, settings)
    corner_rms, stripe_rms = _noise(errors, linearised, state)
    return Adjustment(
        problem=jax.tree.map(np.asarray, state.problem),
        linearised=linearised,
        corner_error=errors.corner * data.corner_sigma[..., None],
        stripe_error=errors.stripe * data.stripe_sigma,
        corner_sigma=data.corner_sigma * state.corner_noise,
        stripe_sigma=data.stripe_sigma * state.stripe_noise,
        corner_keep=state.corner_keep,
        stripe_keep=state.stripe_keep,
        view_keep=state.view_keep,
        corner_noise=state.corner_noise,
        stripe_noise=state.stripe_noise,
        stripe_correlation=state.stripe_correlation,
        corner_rms=corner_rms,
        stripe_rms=stripe_rms,
        steps=state.steps,
    )


def _reject(
    state: _State, linearised: Linearised, errors: _Errors, data: Prepared, settings: CalibrationSettings
) -> tuple[_State, Linearised, _Errors]:
    limits = {"reject_any": settings.reject_any, "reject_all": settings.reject_all}
    for round_number in range(_REJECTION_ROUNDS):
        size = (1.0, 1.0)
        if settings.estimate_noise:
            # Outliers that are still in must not make room for themselves; honest noise with long
            # tails may.
            robust = robust_noise(errors.corner[data.corner_valid]), robust_noise(errors.stripe[data.stripe_valid])
            kept = _noise(errors, linearised, state)
            size = min(kept[0], _LONG_TAILS * robust[0]), min(kept[1], _LONG_TAILS * robust[1])
        corner_room = _room(np.asarray(linearised.corner_leverage)).reshape(errors.corner.shape)
        corner_size = (np.abs(errors.corner) / corner_room).max(-1) / size[0]
        stripe_size = np.abs(errors.stripe) / _room(np.asarray(linearised.stripe_leverage)) / size[1]
        corner_keep = keep_inliers(corner_size, data.corner_valid, state.corner_keep, **limits)
        stripe_keep = keep_inliers(stripe_size, data.stripe_valid, state.stripe_keep, **limits)
        lost = (data.corner_valid & ~corner_keep).sum(1) > _MAX_LOST * data.corner_valid.sum(1)
        view_keep = state.view_keep & ~lost
        _check_views(view_keep, state.view_keep)
        corner_keep = corner_keep & view_keep[:, None]
        stripe_keep = stripe_keep & view_keep[data.stripe_view][:, None]
        cleaned = replace(state, corner_keep=corner_keep, stripe_keep=stripe_keep)
        noise = _noise(errors, linearised, cleaned) if settings.estimate_noise else (1.0, 1.0)
        correlation = state.stripe_correlation
        if settings.stripe_correlation is None:
            correlation = correlation_along(errors.stripe, stripe_keep)
        same = np.array_equal(corner_keep, state.corner_keep) and np.array_equal(stripe_keep, state.stripe_keep)
        ratios = (noise[0] / state.corner_noise, noise[1] / state.stripe_noise, correlation / state.stripe_correlation)
        settled = same and max(abs(ratio - 1.0) for ratio in ratios) < _SETTLED
        if settled and round_number > 0:
            break
        state = replace(
            state,
            corner_keep=corner_keep,
            stripe_keep=stripe_keep,
            view_keep=view_keep,
            corner_noise=noise[0],
            stripe_noise=noise[1],
            stripe_correlation=correlation,
        )
        state, linearised, errors = _solved(state, data, errors, 1.0, 1.0, _FINE, settings)
    return state, linearised, errors


def solve_compiled(problem: Problem, settings: CalibrationSettings) -> Solution:
    """Solve again from near the minimum, by the function that `adjust` has compiled; call in 64 bit."""
    return _solve(problem, np.asarray(_NEAR_DAMPING), np.asarray(_FINE), settings.max_steps)


def _check_views(kept: np.ndarray, before: np.ndarray) -> None:
    if kept.sum() < 3 <= before.sum():
        raise CalibrationError(
            f"Only {kept.sum()} of {before.sum()} views agree with each other, and a camera needs at least 3: check "
            "that all views show the board that [board] in capture.toml describes, sharp and flat, and capture more."
        )


def _room(leverage: np.ndarray) -> np.ndarray:
    return np.sqrt(np.clip(1.0 - leverage, 0.05, 1.0))


def _largest(residual: np.ndarray, valid: np.ndarray) -> float:
    values = np.abs(residual[valid])
    return float(values.max() / robust_noise(values)) if values.size else 0.0


def _noise(errors: _Errors, linearised: Linearised, state: _State) -> tuple[float, float]:
    """Root of each group's variance component."""
    corner_keep = np.repeat(state.corner_keep[..., None], 2, -1)
    corner_leverage = np.asarray(linearised.corner_leverage).reshape(errors.corner.shape)
    stripe_leverage = np.asarray(linearised.stripe_leverage)
    return (
        noise_component(errors.corner[corner_keep], corner_leverage[corner_keep]),
        noise_component(errors.stripe[state.stripe_keep], stripe_leverage[state.stripe_keep], state.stripe_correlation),
    )


def _whitened(corner: Array, offset: Array, slope: Array, data: Prepared) -> _Errors:
    slopes = np.where(data.stripe_valid & (slope > 0), slope, 1.0)
    pixels = np.asarray(corner).reshape(data.corner_q.shape)
    errors = _Errors(
        np.where(data.corner_valid[..., None], pixels / data.corner_sigma[..., None], 0.0),
        np.where(data.stripe_valid, offset / (slopes * data.stripe_sigma), 0.0),
        slopes,
    )
    if not (np.isfinite(errors.corner).all() and np.isfinite(errors.stripe).all()):
        raise CalibrationError("The solve left the range of numbers: the observations contradict each other.")
    return errors


def _solved(
    state: _State,
    data: Prepared,
    errors: _Errors,
    corner_damp: np.ndarray | float,
    stripe_damp: np.ndarray | float,
    tolerance: float,
    settings: CalibrationSettings,
) -> tuple[_State, Linearised, _Errors]:
    corner = state.corner_keep * corner_damp / (data.corner_sigma * state.corner_noise)
    stripe = state.stripe_keep * stripe_damp / (data.stripe_sigma * state.stripe_noise * errors.slope)
    stripe = stripe / np.sqrt(state.stripe_correlation)
    weighted = eqx.tree_at(lambda p: (p.corner_weight, p.stripe_weight), state.problem, (corner, stripe))
    damping = np.asarray(_SEED_DAMPING if state.steps == 0 else _NEAR_DAMPING)
    solution = _solve(weighted, damping, np.asarray(tolerance), settings.max_steps)
    state = replace(state, problem=solution.problem, steps=state.steps + int(solution.steps))
    return state, *_at(state.problem, data)


@eqx.filter_jit
def _solve(problem: Problem, damping: Array, tolerance: Array, max_steps: int) -> Solution:
    return solve(problem, damping, tolerance, max_steps)


@eqx.filter_jit
def linearise_compiled(problem: Problem) -> Linearised:
    """`linearise`, compiled; call in 64 bit."""
    return linearise(problem)


def _at(problem: Problem, data: Prepared) -> tuple[Linearised, _Errors]:
    """The problem to first order at the point that it holds, on the host."""
    linearised = jax.tree.map(np.asarray, linearise_compiled(problem))
    return linearised, _whitened(linearised.corner_error, linearised.offset, linearised.slope, data)
