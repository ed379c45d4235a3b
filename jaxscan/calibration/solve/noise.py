"""Noise of classes of stripe points, and its correlation along a stripe."""

from collections.abc import Callable

import numpy as np

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
