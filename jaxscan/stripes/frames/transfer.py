"""Photon transfer: the line of the noise over the level, and the model that it tells."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscan.stripes.stripes import NoiseModel


PerBin = Float[np.ndarray, " bins"]

_MIN_READ_DN = 0.2
_MIN_GAIN = 0.5
"""No sensor whose full scale is 255 DN has fewer electrons per DN: its whole well would be 130."""
_MIN_SPAN_DN = 10.0
"""Range of levels from which the gain can be told."""


class NoiseLine(NamedTuple):
    """The line through the bins."""

    start: float
    """Twice the variance of a frame at level 0 [DN^2]; below 0 where there is a black level."""
    slope: float
    """Twice the variance per level [DN]."""
    sigma: float
    """Standard deviation of `start` [DN^2]."""


def free_line(level: PerBin, variance: PerBin, sigma: PerBin) -> NoiseLine | None:
    """The line through the bins, wherever it starts; None where no slope is seen."""
    if len(level) < 2 or np.ptp(level) < _MIN_SPAN_DN:
        return None
    weight = 1.0 / sigma**2
    centre = np.average(level, weights=weight)
    spread = np.sum(weight * (level - centre) ** 2)
    slope = np.sum(weight * (level - centre) * variance) / spread
    if not 5.0 / np.sqrt(spread) < slope <= 2.0 / _MIN_GAIN:
        return None
    start = np.average(variance, weights=weight) - slope * centre
    return NoiseLine(float(start), float(slope), float(np.sqrt(1.0 / np.sum(weight) + centre**2 / spread)))


def photon_transfer(
    level: PerBin, variance: PerBin, sigma: PerBin, *, black_dn: float = 0.0
) -> tuple[NoiseModel, bool]:
    """The noise of such points with a known black level, and whether they tell the gain."""
    default = NoiseModel(black_dn=black_dn)
    if len(level) == 0:
        return default, False
    # The black level is no light: it has no shot noise.
    level = level - black_dn
    weight = 1.0 / sigma**2
    slope = _slope(level, variance, weight) if np.ptp(level) >= _MIN_SPAN_DN else 0.0
    centre = np.average(level, weights=weight)
    mean = np.average(variance, weights=weight)
    told = 0.0 < slope <= 2.0 / _MIN_GAIN
    if told:
        gain = 2.0 / slope
    else:
        # One level tells a sum only: keep the default gain, unless it alone explains too much.
        shot = mean - 2.0 * _MIN_READ_DN**2
        gain = max(default.electrons_per_dn, 2.0 * centre / shot) if shot > 0 else 1e6
    read = np.sqrt(max(0.5 * mean - centre / gain, _MIN_READ_DN**2))
    return NoiseModel(read_dn=float(read), electrons_per_dn=float(gain), black_dn=black_dn), told


def _slope(level: PerBin, variance: PerBin, weight: PerBin) -> float:
    """Slope of the line through the bins, which starts no lower than the least read noise; 0 where it is not seen."""
    centre = np.average(level, weights=weight)
    spread = np.sum(weight * (level - centre) ** 2)
    slope = np.sum(weight * (level - centre) * variance) / spread
    if slope * np.sqrt(spread) <= 5.0:
        return 0.0
    start = 2.0 * _MIN_READ_DN**2
    if np.average(variance, weights=weight) - slope * centre < start:
        # So steep that it passes below the levels with the most samples: it has to meet them.
        slope = np.sum(weight * level * (variance - start)) / np.sum(weight * level**2)
    return float(slope)
