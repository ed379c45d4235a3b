"""Noise of points on walls, learned from their residuals: that of stripes, and roughness."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


# First roughness of walls [m].
FIRST_WALL_M = 5e-4
# The noise of stripes over the given sigmas lies between these [1].
_LEAST, _MOST = 0.3, 5.0
_ROUNDS = 20


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
    wall_m: float | None,
) -> Noise:
    """Variance components of the noise, by iterated weighted least squares of squared errors.

    Args:
        square: Squared errors over the share that the fit left [px^2].
        given_px: Given standard deviations of the centres [px].
        reach: Change of the distance from the surface by one pixel [m / px].
        wall_m: Roughness, where it is known [m].

    Source: Förstner's estimate of variance components.
    """
    shapes = given_px**2, 1.0 / reach**2
    parts = np.array([1.0, (FIRST_WALL_M if wall_m is None else wall_m) ** 2])
    low = np.array([_LEAST**2, 0.0 if wall_m is None else wall_m**2])
    high = np.array([_MOST**2, np.inf if wall_m is None else wall_m**2])
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


def cauchy_weights(size: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Roots of the weights of Cauchy's loss, for residuals of a size in standard deviations."""
    return 1.0 / np.sqrt(1.0 + (size / 2.385) ** 2)
