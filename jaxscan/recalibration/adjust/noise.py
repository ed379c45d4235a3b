"""Noise of points on walls, learned from their residuals: that of stripes, and roughness."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


# First roughness of walls [m].
FIRST_WALL_M = 5e-4
# The noise of stripes over the given sigmas lies between these [1].
_LEAST, _MOST = 0.3, 5.0
_ROUNDS = 20
# Neighbours that share errors are at most so many profiles and lines apart.
_NEAR_PROFILES, _NEAR_LINES = 3, 3
# A correlation counts if it is so many of its own standard deviations.
_CERTAIN = 2.5


class Noise(NamedTuple):
    """Of centres of stripes on surfaces: variance = (stripe * given sigma)^2 + (wall / reach)^2."""

    stripe: float
    """Over the given sigmas [1]."""
    wall_m: float
    """Roughness [m]."""

    def sigma(
        self, given_px: Float[np.ndarray, " points"], reach: Float[np.ndarray, " points"]
    ) -> Float[np.ndarray, " points"]:
        """Standard deviations [px], from the given ones and the change of the distance by one pixel [m / px]."""
        return np.hypot(self.stripe * given_px, self.wall_m / reach)


def learn_noise(
    square: Float[np.ndarray, " points"],
    given_px: Float[np.ndarray, " points"],
    reach: Float[np.ndarray, " points"],
) -> Noise:
    """Variance components of the noise, by iterated weighted least squares of squared errors [px^2].

    Errors are over the share that the fit left, `reach` is the change of distance by a pixel [m / px].

    Source: Förstner's estimate of variance components.
    """
    shapes = given_px**2, 1.0 / reach**2
    parts = np.array([1.0, FIRST_WALL_M**2])
    low, high = np.array([_LEAST**2, 0.0]), np.array([_MOST**2, np.inf])
    for _ in range(_ROUNDS):
        weight = 1.0 / np.maximum(shapes[0] * parts[0] + shapes[1] * parts[1], 1e-12)
        # One after the other, each within its limits: both stay variances.
        before = parts.copy()
        for index in (0, 1):
            mine, rest = shapes[index] * weight, shapes[1 - index] * parts[1 - index]
            # Not by BLAS, whose threads wait for each other longer than the sum takes.
            size = float(np.sum(mine * mine))
            wanted = float(np.sum(mine * (square - rest) * weight)) / size if size > 0 else parts[index]
            parts[index] = np.clip(wanted, low[index], high[index])
        if np.allclose(parts, before, rtol=1e-4, atol=1e-14):
            break
    return Noise(float(np.sqrt(parts[0])), float(np.sqrt(parts[1])))


def shared_by_profiles(whitened: Float[np.ndarray, " points"], grid: Int[np.ndarray, "points 4"]) -> float:
    """Factor by which the variance of a sum over neighbouring profiles exceeds that of independent errors [1]; at least
    1.

    Along the line points are so far apart that their errors are independent. From profile to profile speckle and the
    paint of a wall change little where steps are small. The factor is 1 + 2 sum of r_i r_j / sum of r_i^2 over the
    pairs of neighbours, and 1 where that sum is no more than chance makes it. `grid` is sweep, surface, record, line.
    """
    square = float(whitened @ whitened)
    if square <= 0.0:
        return 1.0
    wall = np.unique(grid[:, :2], axis=0, return_inverse=True)[1].ravel().astype(np.int64)
    place = (grid[:, 2:] - grid[:, 2:].min(0)).astype(np.int64)
    # With room between walls and profiles, so that no pair reaches over two of them.
    length, height = place.max(0) + 1 + np.array([_NEAR_PROFILES, 2 * _NEAR_LINES])
    key = (wall * length + place[:, 0]) * height + place[:, 1]
    order = np.argsort(key)
    products, pairs = 0.0, 0
    for profiles in range(1, _NEAR_PROFILES + 1):
        for lines in range(-_NEAR_LINES, _NEAR_LINES + 1):
            wanted = key + profiles * height + lines
            other = order[np.minimum(np.searchsorted(key[order], wanted), len(key) - 1)]
            there = key[other] == wanted
            products += float(whitened[there] @ whitened[other[there]])
            pairs += int(there.sum())
    chance = np.sqrt(pairs) * square / len(key)
    return 1.0 + 2.0 * products / square if products > _CERTAIN * chance else 1.0
