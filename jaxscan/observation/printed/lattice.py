"""Samples of print and light round a stripe, and how the lens and the pixels collect them."""

import math
from typing import NamedTuple

import numpy as np


# Distance of samples along a line and from line to line [px].
_STEP = 1.0 / 3.0
# Reach of the lens's blur and the pixel beyond the window, and along the stripe [px].
_SPREAD, _SPREAD_ALONG = 3.0, 8.0 / 3.0


class Shared(NamedTuple):
    """Unknowns that all lines of a view share."""

    width: float
    """Logarithm of the standard deviation of the light on the board, without the lens's blur [log px]."""
    taper: float
    """Change of that from the middle of the stripe to its end [log px]."""
    ink: float
    """Light that ink sends back, over that of paper [1]."""
    blur: float
    """Logarithm of the lens's blur, before the pixel [log px]."""
    across: float
    """How far the print lies beside its prediction across the lines [px]."""
    along: float
    """And along the stripe [px]."""


class Lattice(NamedTuple):
    """Where print and light are sampled: rows along the stripe, sheared so that they follow it."""

    along: np.ndarray
    """Distance from the line, along the stripe [j], px."""
    across: np.ndarray
    """Distance from the middle of the window, across the stripe, without the shear [k], px."""
    slope: float
    """Shear: pixels across for one pixel along."""
    pixels: np.ndarray
    """Where the pixels of a window lie, from its middle [samples], px."""

    @staticmethod
    def around(half: int, pitch: int, slope: float) -> "Lattice":
        """For windows of `half` samples, `pitch` pixels apart, on either side of the middle."""
        pixels = pitch * np.arange(-half, half + 1, dtype=np.float64)
        rows, columns = round(_SPREAD_ALONG / _STEP), math.ceil((pixels[-1] + _SPREAD) / _STEP)
        return Lattice(_STEP * np.arange(-rows, rows + 1), _STEP * np.arange(-columns, columns + 1), slope, pixels)

    def kernel(self, shared: Shared) -> np.ndarray:
        """Share of the light of a sample that each pixel collects, float32 [k, j, samples]."""
        blur = math.exp(shared.blur)
        down = _STEP * _share(self.along + shared.along, blur)
        x = self.across[:, None, None] + self.slope * self.along[:, None] + shared.across - self.pixels
        return (_STEP * _share(x, blur) * down[:, None]).astype(np.float32)

    def offsets(self, shared: Shared, centre: np.ndarray) -> np.ndarray:
        """Distance of the samples across from the stripe's centre on their line [lines, k], px."""
        moved = self.across + shared.across - self.slope * shared.along
        return (moved - centre[:, None]).astype(np.float32)


def collected(paper: np.ndarray, kernel: np.ndarray) -> np.ndarray:
    """The share of each sample across that pixels collect, where the light is 1 everywhere [lines, samples, k].

    Args:
        paper: Reflectance at the samples of a lattice [k, lines, j].
        kernel: Of the lattice.
    """
    return np.ascontiguousarray(np.matmul(paper, kernel).transpose(1, 2, 0))


def _share(x: np.ndarray, blur: float) -> np.ndarray:
    """Share of the light of a point at distance x that a pixel collects, per pixel."""
    return _normal((x + 0.5) / blur) - _normal((x - 0.5) / blur)


def _normal(x: np.ndarray) -> np.ndarray:
    """Distribution function of the normal law to 1e-7. Source: Abramowitz and Stegun, 7.1.26."""
    z = 1.0 / (1.0 + 0.23164189 * np.abs(x))
    series = z * (0.254829592 + z * (-0.284496736 + z * (1.421413741 + z * (-1.453152027 + z * 1.061405429))))
    return 0.5 + np.copysign(0.5 - 0.5 * series * np.exp(-0.5 * x * x), x)
