"""The rounds of the joint solve: robust start, rejection of outliers, noise, and how well the unknowns are known."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from jaxscan.calibration.joint import Linearised, Solution, linearise, solve
from jaxscan.calibration.problem import LEAST_STOP_SIGMA, Prepared, Problem, with_stop_sigma
from jaxscan.calibration.settings import CalibrationSettings, is_mode
from jaxscan.calibration.stops import learn_stop_sigma
from jaxscan.errors import CalibrationError
from jaxscan.geometry import Array
from jaxscan.leastsq import Huber, keep_inliers, noise_component, robust_noise, undetermined
from jaxscan.observation import CONTRAST_CLASSES


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
    # The product of a matrix and its transpose is symmetric to the last digit, however weak a direction is.
    half = axes / np.sqrt(eigenvalues) / size[:, None]
    inverse = half @ half.T
    covariance[np.ix_(free, free)] = inverse * np.outer(scales[free], scales[free])
    # Shares of the prior in the information: generalised eigenvalues, 0 (data only) ... 1. Modes of the board
    # are nuisances, which may depend mostly on the priors.
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


# A class with fewer points than this shows no noise of its own.
_CLASS_POINTS = 60
# The correlation along a stripe is summed up to the lag where it is lost in its own noise, at most here.
_MAX_LAG = 128
_MAX_CORRELATION = 64.0


def noise_by_class(size: Callable[[np.ndarray], float], contrast: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Noise of the stripe points of every contrast class.

    Returns:
        One number for each class. A class with few points has that of all points of its kind, fitted through the
        print or not; where these are few too, that of all points.
    """
    kinds = CONTRAST_CLASSES // 2

    def noise(number: int) -> float:
        first = number // kinds * kinds
        groups = contrast == number, (contrast >= first) & (contrast < first + kinds)
        enough = (group & count for group in groups if np.count_nonzero(group & count) >= _CLASS_POINTS)
        return size(next(enough, count))

    return np.array([noise(number) for number in range(CONTRAST_CLASSES)])


def correlation_along(residual: np.ndarray, keep: np.ndarray) -> float:
    """How many neighbours along a stripe share one error: 1 + 2 * (sum of autocorrelations).

    Speckle moves neighbouring centres together, and then n of them are worth n over this.
    Summed up to the first lag whose correlation is within two standard errors of none.

    Returns:
        The correlation length [points], 1 for white noise.
    """
    value = np.where(keep, residual, 0.0)
    count = int(keep.sum())
    if count < 100:
        return 1.0
    variance = float(np.sum(value**2)) / count
    total = 1.0
    for lag in range(1, min(_MAX_LAG, value.shape[1] - 1)):
        pairs = int(np.sum(keep[:, lag:] & keep[:, :-lag]))
        if pairs < 100:
            break
        correlation = float(np.sum(value[:, lag:] * value[:, :-lag])) / pairs / variance
        if correlation < 2.0 / np.sqrt(pairs):
            break
        total += 2.0 * correlation
    return min(total, _MAX_CORRELATION)


class Errors(NamedTuple):
    """Residuals in units of the given sigmas, and |grad_q e|; 0 and 1 where there is nothing."""

    corner: np.ndarray
    stripe: np.ndarray
    slope: np.ndarray


@dataclass(frozen=True)
class Adjustment:
    """A solve between its rounds, and at last the minimum; arrays padded as `Prepared` is."""

    linearised: Linearised
    """Where the solve ended, with its last weights."""
    errors: Errors
    """Errors of everything valid, rejected ones too."""
    data: Prepared
    corner_inlier: np.ndarray
    stripe_inlier: np.ndarray
    view_inlier: np.ndarray
    """Views [views] that were not dropped as a whole."""
    corner_noise: float = 1.0
    """Estimated noise over the given sigma [1]."""
    stripe_noise: np.ndarray = field(default_factory=lambda: np.ones(CONTRAST_CLASSES))
    """Estimated noise of the points of each contrast class over the given sigma [1]."""
    stripe_correlation: float = 1.0
    """Neighbours along a stripe that share one error [1]."""
    steps: int = 0
    """Steps of the solver in all rounds."""
    converged: bool = False
    """Whether the last round ended at a minimum rather than after its last step."""

    @property
    def problem(self) -> Problem:
        """Seen from where the solve ended, with its last weights; NumPy arrays."""
        return self.linearised.problem

    @property
    def angle_sigma(self) -> float | None:
        """Standard deviation of the motion's stops [rad or m]; 0 where they are as good as exact."""
        if not np.any(self.problem.stop) or not self.problem.turntable.blocks:
            return None
        sigma = float(self.problem.stop_sigma)
        return sigma if sigma > LEAST_STOP_SIGMA else 0.0

    @property
    def corner_error(self) -> np.ndarray:
        """Projected minus observed corners [views, corners, 2], px; rejected ones too."""
        return self.errors.corner * self.data.corner_sigma[..., None]

    @property
    def stripe_error(self) -> np.ndarray:
        """Sampson error of the stripe points [stripes, points], px; rejected ones too."""
        return self.errors.stripe * self.data.stripe_sigma

    @property
    def corner_sigma(self) -> np.ndarray:
        """Given sigma times the estimated noise [px]."""
        return self.data.corner_sigma * self.corner_noise

    @property
    def stripe_sigma(self) -> np.ndarray:
        """Given sigma times the estimated noise [px]."""
        return self.data.stripe_sigma * self.stripe_point_noise

    @property
    def stripe_point_noise(self) -> np.ndarray:
        """Estimated noise over the given sigma of every stripe point [stripes, points], 1."""
        return self.stripe_noise[self.data.stripe_contrast]

    @property
    def stripe_noise_rms(self) -> float:
        """Estimated noise over the given sigma of all kept stripe points [1]."""
        kept = self.stripe_point_noise[self.stripe_inlier]
        return float(np.sqrt(np.mean(kept**2))) if kept.size else 1.0

    def whitened_rms(self) -> tuple[float, float]:
        """RMS of the kept corners and stripes in units of the given sigmas, per degree of freedom [1]."""
        corner_inlier = np.repeat(self.corner_inlier[..., None], 2, -1)
        corner_leverage = self.linearised.corner_leverage.reshape(self.errors.corner.shape)
        corner = noise_component(self.errors.corner[corner_inlier], corner_leverage[corner_inlier])
        return corner, self.stripe_component(self.stripe_inlier)

    def stripe_component(self, some: np.ndarray) -> float:
        """RMS of some stripe points [stripes, points] in units of the given sigmas, per degree of freedom [1]."""
        leverage = self.linearised.stripe_leverage[some]
        return noise_component(self.errors.stripe[some], leverage, self.stripe_correlation)

    def robust_stripe_noise(self) -> np.ndarray:
        """Noise of each contrast class by the median of its points, in units of the given sigmas [1]."""
        size = lambda some: robust_noise(self.errors.stripe[some])
        return noise_by_class(size, self.data.stripe_contrast, self.data.stripe_valid)

    def kept_stripe_noise(self) -> np.ndarray:
        """Noise of each contrast class by the squares of its kept points, in units of the given sigmas [1]."""
        return noise_by_class(self.stripe_component, self.data.stripe_contrast, self.stripe_inlier)


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
    kept = data.corner_valid, data.stripe_valid, data.fixes_pose
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
        corner_inlier = keep_inliers(corner_size, data.corner_valid, state.corner_inlier, **limits)
        stripe_inlier = keep_inliers(stripe_size, data.stripe_valid, state.stripe_inlier, **limits)
        lost = (data.corner_valid & ~corner_inlier).sum(1) > _MAX_LOST * data.corner_valid.sum(1)
        view_inlier = state.view_inlier & ~lost
        if view_inlier.sum() < 3 <= state.view_inlier.sum():
            raise _too_few_views(int(view_inlier.sum()), state, settings)
        corner_inlier = corner_inlier & view_inlier[:, None]
        stripe_inlier = stripe_inlier & view_inlier[data.stripe_view][:, None]
        cleaned = replace(state, corner_inlier=corner_inlier, stripe_inlier=stripe_inlier)
        noise = 1.0, np.ones(CONTRAST_CLASSES)
        if settings.estimate_noise:
            noise = cleaned.whitened_rms()[0], cleaned.kept_stripe_noise()
        correlation = state.stripe_correlation
        if settings.stripe_correlation is None:
            # Classes of unlike noise would hide the noise that neighbours share.
            correlation = correlation_along(errors.stripe / noise[1][data.stripe_contrast], stripe_inlier)
        before, stop_sigma = float(state.problem.stop_sigma), _stop_sigma(state, settings)
        same = np.array_equal(corner_inlier, state.corner_inlier) and np.array_equal(stripe_inlier, state.stripe_inlier)
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
            view_inlier=view_inlier,
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
        f"Only {kept} of {state.view_inlier.sum()} views agree with each other, and a camera needs at least 3: check "
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
    corner = state.corner_inlier * damp[0] / state.corner_sigma
    stripe = state.stripe_inlier * damp[1] / (state.stripe_sigma * state.errors.slope)
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
