"""The joint solve round the solver: robust start, rejection of outliers, estimate of the noise."""

from dataclasses import dataclass, replace

import equinox as eqx
import jax
import numpy as np

from jaxscan.calibration.covariance import Linearised, linearise
from jaxscan.calibration.parameters import block_of
from jaxscan.calibration.prepare import Prepared
from jaxscan.calibration.residuals import Measured, Problem, prior_names
from jaxscan.calibration.settings import Block, CalibrationSettings
from jaxscan.calibration.solve import solve
from jaxscan.errors import CalibrationError
from jaxscan.geometry import Array


# The noise of data without any is taken as this share of the given sigma, so that weights stay finite.
_MIN_NOISE = 1e-3
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


@dataclass(frozen=True)
class Adjustment:
    """The minimum, and what was kept to get there."""

    problem: Problem
    """Seen from the minimum, with its final weights."""
    linearised: Linearised
    corner_error: np.ndarray
    """Projected minus observed corners [views, corners, 2], px; rejected ones too."""
    stripe_error: np.ndarray
    """Sampson error of the stripe points [stripes, points], px; rejected ones too."""
    corner_keep: np.ndarray
    stripe_keep: np.ndarray
    corner_noise: float
    """Estimated noise over the given sigma [1]."""
    stripe_noise: float
    corner_rms: float
    """Whitened by the given sigmas, kept ones, per degree of freedom [1]."""
    stripe_rms: float
    steps: int


@dataclass(frozen=True)
class _State:
    problem: Problem
    corner_keep: np.ndarray
    stripe_keep: np.ndarray
    corner_noise: float = 1.0
    stripe_noise: float = 1.0
    steps: int = 0


def adjust(problem: Problem, data: Prepared, settings: CalibrationSettings, *, rejection: bool = True) -> Adjustment:
    """Solve robustly, drop outliers, estimate the noise of each group, solve to the end.

    Plain least squares at the end keeps the estimate that of maximum likelihood, and its
    covariance meaningful. With `rejection` False only the robust part runs.

    Raises:
        CalibrationError: If the solve breaks down.
    """
    state = _State(problem, data.corner_valid, data.stripe_valid)
    for _ in range(_ROBUST_ROUNDS if rejection else 2):
        corner, stripe, slopes = _whitened(_linearised(state.problem).measured, data)
        state = replace(state, corner_noise=_spread(corner[data.corner_valid]))
        state = replace(state, stripe_noise=_spread(stripe[data.stripe_valid]))
        corner_damp = _huber(np.abs(corner).max(-1) / state.corner_noise, settings.huber)
        stripe_damp = _huber(np.abs(stripe) / state.stripe_noise, settings.huber)
        state = _solved(state, data, slopes, settings, corner_damp, stripe_damp, _ROUGH)
    if rejection:
        state = _reject(state, data, settings)
    linearised = _linearised(state.problem)
    corner, stripe, _ = _whitened(linearised.measured, data)
    corner_rms, stripe_rms = _noise(corner, stripe, linearised, state)
    return Adjustment(
        problem=state.problem,
        linearised=linearised,
        corner_error=corner * data.corner_sigma[..., None],
        stripe_error=stripe * data.stripe_sigma,
        corner_keep=state.corner_keep,
        stripe_keep=state.stripe_keep,
        corner_noise=state.corner_noise,
        stripe_noise=state.stripe_noise,
        corner_rms=corner_rms,
        stripe_rms=stripe_rms,
        steps=state.steps,
    )


def prior_weights(names: tuple[str, ...], lasers: int, free: tuple[Block, ...], settings: CalibrationSettings) -> Array:
    """1 / standard deviation of every prior; 0 for what is held."""
    priors = settings.priors
    sigma = {
        "cx": priors.centre_px,
        "cy": priors.centre_px,
        "fx": priors.aspect,
        "p1": priors.tangential,
        "p2": priors.tangential,
        "k3": priors.k3,
        "gain": priors.gain,
        **dict.fromkeys(("c1", "s1", "c2", "s2"), priors.harmonics),
        **dict.fromkeys(("b2", "b3"), priors.bow),
        **dict.fromkeys(("warp.x", "warp.y"), priors.warp),
    }
    return np.array([1.0 / sigma[name] if block_of(name) in free else 0.0 for name in prior_names(lasers)])


def _reject(state: _State, data: Prepared, settings: CalibrationSettings) -> _State:
    for round_number in range(_REJECTION_ROUNDS):
        linearised = _linearised(state.problem)
        corner, stripe, slopes = _whitened(linearised.measured, data)
        noise = _noise(corner, stripe, linearised, state) if settings.estimate_noise else (1.0, 1.0)
        room = lambda leverage: np.sqrt(np.clip(1.0 - leverage, 0.05, 1.0))
        corner_room = room(np.asarray(linearised.corner_leverage)).reshape(corner.shape)
        corner_size = (np.abs(corner) / corner_room).max(-1) / noise[0]
        stripe_size = np.abs(stripe) / room(np.asarray(linearised.stripe_leverage)) / noise[1]
        corner_keep = _keep(corner_size, data.corner_valid, state.corner_keep, settings)
        stripe_keep = _keep(stripe_size, data.stripe_valid, state.stripe_keep, settings)
        last = round_number == _REJECTION_ROUNDS - 1
        same = np.array_equal(corner_keep, state.corner_keep) and np.array_equal(stripe_keep, state.stripe_keep)
        settled = max(abs(noise[0] / state.corner_noise - 1.0), abs(noise[1] / state.stripe_noise - 1.0)) < 0.01
        state = replace(
            state,
            corner_keep=corner_keep,
            stripe_keep=stripe_keep,
            corner_noise=noise[0],
            stripe_noise=noise[1],
        )
        state = _solved(state, data, slopes, settings, 1.0, 1.0, _FINE if last or (same and settled) else _ROUGH)
        if same and settled:
            break
    return state


def _keep(size: np.ndarray, valid: np.ndarray, kept: np.ndarray, settings: CalibrationSettings) -> np.ndarray:
    # Two thresholds: honest data with its few 4 sigma values is left whole, and where anything
    # is plainly wrong its smaller neighbours go too. Source: mrcal, markOutliers.
    if not np.any(valid & kept & (size > settings.reject_any)) and kept[valid].all():
        return kept
    return valid & (size <= settings.reject_all)


def _noise(corner: np.ndarray, stripe: np.ndarray, linearised: Linearised, state: _State) -> tuple[float, float]:
    """Root of each group's variance component: squares over redundancy (count less leverage)."""
    corner_keep = np.repeat(state.corner_keep[..., None], 2, -1)
    corner_leverage = np.asarray(linearised.corner_leverage).reshape(corner.shape)
    return (
        _component(corner[corner_keep], corner_leverage[corner_keep]),
        _component(stripe[state.stripe_keep], np.asarray(linearised.stripe_leverage)[state.stripe_keep]),
    )


def _component(residual: np.ndarray, leverage: np.ndarray) -> float:
    redundancy = len(residual) - leverage.sum()
    if redundancy < 1.0:
        return 1.0
    return max(float(np.sqrt(np.sum(residual**2) / redundancy)), _MIN_NOISE)


def _spread(values: np.ndarray) -> float:
    # The median is not moved by outliers; 1.4826 makes it a standard deviation.
    return max(1.4826 * float(np.median(np.abs(values))), _MIN_NOISE) if values.size else 1.0


def _huber(size: np.ndarray, threshold: float) -> np.ndarray:
    return np.sqrt(np.minimum(1.0, threshold / np.maximum(size, threshold)))


def _whitened(measured: Measured, data: Prepared) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Residuals in units of the given sigmas, and |grad_q e|; 0 and 1 where there is nothing."""
    corner = np.where(data.corner_valid[..., None], measured.corner / data.corner_sigma[..., None], 0.0)
    slopes = np.where(data.stripe_valid & (measured.slope > 0), measured.slope, 1.0)
    stripe = np.where(data.stripe_valid, measured.offset / (slopes * data.stripe_sigma), 0.0)
    if not (np.isfinite(corner).all() and np.isfinite(stripe).all()):
        raise CalibrationError("The solve left the range of numbers: the observations contradict each other.")
    return corner, stripe, slopes


def _weighted(
    state: _State,
    data: Prepared,
    slopes: np.ndarray,
    settings: CalibrationSettings,
    corner_damp: np.ndarray | float,
    stripe_damp: np.ndarray | float,
) -> Problem:
    corner = state.corner_keep * corner_damp / (data.corner_sigma * state.corner_noise)
    stripe = state.stripe_keep * stripe_damp / (data.stripe_sigma * state.stripe_noise * slopes)
    stripe = stripe / np.sqrt(settings.stripe_correlation)
    return eqx.tree_at(lambda p: (p.corner_weight, p.stripe_weight), state.problem, (corner, stripe))


def _solved(
    state: _State,
    data: Prepared,
    slopes: np.ndarray,
    settings: CalibrationSettings,
    corner_damp: np.ndarray | float,
    stripe_damp: np.ndarray | float,
    tolerance: float,
) -> _State:
    damping = np.asarray(_SEED_DAMPING if state.steps == 0 else _NEAR_DAMPING)
    weighted = _weighted(state, data, slopes, settings, corner_damp, stripe_damp)
    solution = solve(weighted, damping, np.asarray(tolerance), settings.max_steps)
    return replace(state, problem=solution.problem, steps=state.steps + int(solution.steps))


def _linearised(problem: Problem) -> Linearised:
    return jax.tree.map(np.asarray, linearise(problem))
