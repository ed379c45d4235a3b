"""Outliers: robust losses, robust estimates of noise, and rejection."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.geometry import Array, median_sigma, namespace


# The noise of data without any is taken as this share of the given sigma, so that weights stay finite.
_LEAST_NOISE = 1e-3


@runtime_checkable
class Loss(Protocol):
    """How much large residuals count. Both forms are given in terms of the residual in standard deviations."""

    def root(self, residual: Float[Array, "..."]) -> Float[Array, "..."]:
        """The number with the residual's sign whose half square is the loss: least squares of it minimise the loss."""

    def weights(self, size: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Roots of the weights of iterated least squares with this loss, for residuals of a size."""


@dataclass(frozen=True)
class Huber:
    """Squares of small residuals, and the size of large ones."""

    threshold: float = 1.345
    """Size from which a residual is large [standard deviations]."""

    def root(self, residual: Float[Array, "..."]) -> Float[Array, "..."]:
        """See `Loss`."""
        xp, k = namespace(residual), self.threshold
        # The size is clamped from below within the root, or its derivative at 0 would be NaN.
        large = xp.sqrt(2.0 * k * xp.maximum(xp.abs(residual), k) - k * k)
        return xp.where(xp.abs(residual) <= k, residual, xp.sign(residual) * large)

    def weights(self, size: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """See `Loss`."""
        return np.sqrt(np.minimum(1.0, self.threshold / np.maximum(size, self.threshold)))


@dataclass(frozen=True)
class Cauchy:
    """The logarithm of large squares, so that far outliers hardly pull."""

    scale: float = 2.385
    """Size at which a residual has half its weight [standard deviations]."""

    def root(self, residual: Float[Array, "..."]) -> Float[Array, "..."]:
        """See `Loss`."""
        xp, ratio = namespace(residual), residual / self.scale
        square = ratio * ratio
        # log(1 + x) / x, by its first terms where x is small.
        some = xp.where(square > 1e-8, square, 1.0)
        return residual * xp.sqrt(xp.where(square > 1e-8, xp.log1p(some) / some, 1.0 - 0.5 * square))

    def weights(self, size: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """See `Loss`."""
        return 1.0 / np.sqrt(1.0 + (size / self.scale) ** 2)


def robust_noise(values: Float[np.ndarray, "..."]) -> float:
    """Standard deviation by the median, which outliers do not move; 1 of no values."""
    return max(median_sigma(values), _LEAST_NOISE) if values.size else 1.0


def noise_component(
    residual: Float[np.ndarray, " n"], leverage: Float[np.ndarray, " n"], correlation: float = 1.0
) -> float:
    """Root of a group's variance component: squares over redundancy.

    The redundancy is the count less the leverages; of rows that share errors, the fit takes up
    `correlation` times as much.

    Returns:
        The noise in units of the sigma that the residuals were whitened with; 1 where the data
        cannot say.

    Source: Förstner's estimate of variance components; research of bundle adjustment (Triggs et
    al., Bundle adjustment: a modern synthesis, 2000).
    """
    redundancy = len(residual) - correlation * leverage.sum()
    if redundancy < 1.0:
        return 1.0
    return max(float(np.sqrt(np.sum(residual**2) / redundancy)), _LEAST_NOISE)


def keep_inliers(
    size: Float[np.ndarray, "..."],
    valid: Bool[np.ndarray, "..."],
    kept: Bool[np.ndarray, "..."],
    *,
    reject_any: float,
    reject_all: float,
) -> Bool[np.ndarray, "..."]:
    """Which observations are kept: all, unless one is plainly wrong; then all large ones are rejected. So clean data
    keeps its few values of 4 standard deviations.

    Source: mrcal, `markOutliers`.
    """
    if not np.any(valid & kept & (size > reject_any)) and kept[valid].all():
        return kept
    return valid & (size <= reject_all)


def chance_of(chi2: float, freedom: int) -> float:
    """Probability of a larger chi-squared by chance [1]; 1 without any freedom."""
    # Here, because it takes longer to load than to compute.
    from scipy.special import chdtrc  # type: ignore[import-untyped]

    return float(chdtrc(freedom, max(chi2, 0.0))) if freedom > 0 else 1.0
