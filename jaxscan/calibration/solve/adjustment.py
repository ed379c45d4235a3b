"""A solve between its rounds, and at its end."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from jaxscan.calibration.solve.joint import Linearised
from jaxscan.calibration.solve.prepare import Prepared
from jaxscan.calibration.solve.problem import LEAST_STOP_SIGMA, Problem
from jaxscan.leastsq import noise_component, robust_noise
from jaxscan.observation import CONTRAST_CLASSES


# A class with fewer points than this shows no noise of its own.
_CLASS_POINTS = 60
# The correlation along a stripe is summed up to the lag where it is lost in its own noise, at most here.
_MAX_LAG = 128
_MAX_CORRELATION = 64.0


def noise_by_class(size: Callable[[np.ndarray], float], contrast: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Noise of the stripe points of every contrast class.

    Args:
        size: Gives the noise of some points, bool, shaped like `contrast`.
        contrast: Class of every point.
        count: bool, shaped like `contrast`: points that count.

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

    Args:
        residual: Residuals along stripes [stripes, points], neighbours in order.
        keep: Which of them count.

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
    """Of everything valid, rejected ones too."""
    data: Prepared
    corner_kept: np.ndarray
    stripe_kept: np.ndarray
    view_kept: np.ndarray
    """Views [views] that were not dropped as a whole."""
    corner_noise: float = 1.0
    """Estimated noise over the given sigma [1]."""
    stripe_noise: np.ndarray = field(default_factory=lambda: np.ones(CONTRAST_CLASSES))
    """Of the points of each contrast class."""
    stripe_correlation: float = 1.0
    """Neighbours along a stripe that share one error [1]."""
    steps: int = 0
    """In all rounds."""
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
        kept = self.stripe_point_noise[self.stripe_kept]
        return float(np.sqrt(np.mean(kept**2))) if kept.size else 1.0

    def whitened_rms(self) -> tuple[float, float]:
        """RMS of the kept corners and stripes in units of the given sigmas, per degree of freedom [1]."""
        corner_kept = np.repeat(self.corner_kept[..., None], 2, -1)
        corner_leverage = self.linearised.corner_leverage.reshape(self.errors.corner.shape)
        corner = noise_component(self.errors.corner[corner_kept], corner_leverage[corner_kept])
        return corner, self.stripe_component(self.stripe_kept)

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
        return noise_by_class(self.stripe_component, self.data.stripe_contrast, self.stripe_kept)
