"""Size of the noise, its correlation along a stripe, and residuals too large to be noise."""

from collections.abc import Callable

import numpy as np

from jaxscan.observation import CONTRAST_CLASSES


# A class with fewer points than this shows no noise of its own.
_CLASS_POINTS = 60
# The noise of data without any is taken as this share of the given sigma, so that weights stay finite.
_MIN_NOISE = 1e-3
# The correlation along a stripe is summed up to the lag where it is lost in its own noise, at most here.
_MAX_LAG = 128
_MAX_CORRELATION = 64.0


def robust_noise(values: np.ndarray) -> float:
    """Standard deviation by the median, which outliers do not move."""
    return max(1.4826 * float(np.median(np.abs(values))), _MIN_NOISE) if values.size else 1.0


def noise_component(residual: np.ndarray, leverage: np.ndarray, correlation: float = 1.0) -> float:
    """Root of a group's variance component: squares over redundancy.

    The redundancy is the count less the leverages; of rows that share errors, the fit takes up
    `correlation` times as much.

    Args:
        residual: Whitened residuals [n].
        leverage: Their shares taken up by the fit [n].
        correlation: How many neighbours share one error [1].

    Returns:
        The noise in units of the sigma that the residuals were whitened with; 1 where the data
        cannot say.

    Source: Förstner's estimate of variance components; research of bundle adjustment (Triggs et
    al., Bundle adjustment: a modern synthesis, 2000).
    """
    redundancy = len(residual) - correlation * leverage.sum()
    if redundancy < 1.0:
        return 1.0
    return max(float(np.sqrt(np.sum(residual**2) / redundancy)), _MIN_NOISE)


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


def huber_weights(size: np.ndarray, threshold: float) -> np.ndarray:
    """Roots of the weights of Huber's estimate, for residuals of a size in standard deviations."""
    return np.sqrt(np.minimum(1.0, threshold / np.maximum(size, threshold)))


def keep_inliers(
    size: np.ndarray, valid: np.ndarray, kept: np.ndarray, *, reject_any: float, reject_all: float
) -> np.ndarray:
    """Which observations stay: none goes unless one is plainly wrong, then all large ones do.

    Honest data with its few values of 4 standard deviations is left whole.

    Args:
        size: Standardised residuals, at least 0.
        valid: Which count at all.
        kept: Those kept so far.
        reject_any: Size from which one is plainly wrong.
        reject_all: Size beyond which all go then.

    Source: mrcal, `markOutliers`.
    """
    if not np.any(valid & kept & (size > reject_any)) and kept[valid].all():
        return kept
    return valid & (size <= reject_all)
