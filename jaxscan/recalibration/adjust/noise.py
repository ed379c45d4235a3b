"""Noise of points on walls, learned from their residuals: stripes, roughness, and the errors that neighbours share."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int


# First roughness of walls [m].
FIRST_WALL_M = 5e-4
# The noise of stripes over the given sigmas lies between these [1].
_LEAST, _MOST = 0.3, 5.0
_ROUNDS = 20
# Sizes of patches of a wall whose points may share an error [m].
_PATCHES = (0.3, 0.6, 1.2)


class Noise(NamedTuple):
    """Of points on surfaces: variance = (stripe * change of the distance by the stripe's sigma)^2 + wall^2."""

    stripe: float
    """Over the given sigmas [1]."""
    wall_m: float
    """Roughness [m]."""

    def sigma(self, stripe_m: Float[np.ndarray, " points"]) -> Float[np.ndarray, " points"]:
        """Standard deviation of distances [m] whose part from the stripe's given sigma is `stripe_m`."""
        return np.hypot(self.stripe * stripe_m, self.wall_m)


def learn_noise(
    error: Float[np.ndarray, " points"],
    stripe_m: Float[np.ndarray, " points"],
    redundancy: Float[np.ndarray, " points"],
    wall_m: float | None,
) -> Noise:
    """Variance components of the noise, by iterated weighted least squares of squared errors.

    Args:
        error: Distances from the surfaces [m].
        stripe_m: Their part by the given sigma of the stripe [m].
        redundancy: Share of each error that the fit left [1].
        wall_m: Roughness, where it is known [m].

    Source: Förstner's estimate of variance components.
    """
    square = error**2 / np.clip(redundancy, 0.05, 1.0)
    shapes = np.stack([stripe_m**2, np.ones_like(stripe_m)], 1)
    parts = np.array([1.0, (FIRST_WALL_M if wall_m is None else wall_m) ** 2])
    low = np.array([_LEAST**2, 0.0 if wall_m is None else wall_m**2])
    high = np.array([_MOST**2, np.inf if wall_m is None else wall_m**2])
    for _ in range(_ROUNDS):
        weight = 1.0 / np.maximum(shapes @ parts, 1e-16)
        # One after the other, each within its limits: both stay variances.
        before = parts.copy()
        for index in (0, 1):
            mine, rest = shapes[:, index] * weight, shapes[:, 1 - index] * parts[1 - index]
            size = float(mine @ mine)
            wanted = float(mine @ ((square - rest) * weight)) / size if size > 0 else parts[index]
            parts[index] = np.clip(wanted, low[index], high[index])
        if np.allclose(parts, before, rtol=1e-4, atol=1e-14):
            break
    return Noise(float(np.sqrt(parts[0])), float(np.sqrt(parts[1])))


def shared_errors(
    whitened: Float[np.ndarray, " points"],
    surface: Int[np.ndarray, " points"],
    place: Float[np.ndarray, "points 2"],
    kept: Bool[np.ndarray, " points"],
) -> float:
    """How much larger the variance of means is than that of independent errors [1], at least 1.

    Points of one patch of a wall share errors: the wall is not flat, or light comes back from the next one.

    Args:
        whitened: Errors over their standard deviations.
        surface: Number of the surface.
        place: Coordinates in the surface [m].
        kept: Points that count.
    """
    largest = 1.0
    for size in _PATCHES:
        cell = np.floor(place[kept] / size).astype(np.int64)
        key = np.column_stack([surface[kept], cell])
        _, patch = np.unique(key, axis=0, return_inverse=True)
        count = np.bincount(patch.ravel())
        total = np.bincount(patch.ravel(), whitened[kept])
        several = count >= 4
        if several.sum() >= 8:
            largest = max(largest, float(np.sum(total[several] ** 2) / np.sum(count[several])))
    return largest


def cauchy_weights(size: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Roots of the weights of Cauchy's loss, for residuals of a size in standard deviations."""
    return 1.0 / np.sqrt(1.0 + (size / 2.385) ** 2)
