r"""The correlation of the errors of neighbouring rows, and what it does to the fits of a window.

Demosaicing, compression and blur make the errors of neighbouring rows alike. Least squares with the weights of
independent rows stay unbiased, but other figures follow: with the errors' covariance C, the weights h of the value and
the projection M onto the residuals, the value has the variance $h^\top C h$, and chi-squared the mean
$\mathrm{tr}\,MC$ and the variance $2\,\mathrm{tr}\,(MC)^2$. Windows are few and rows of one are about equally good, so
these are tabulated, over what they are of independent rows.

Source: G. E. P. Box, Some theorems on quadratic forms applied in the study of analysis of variance problems, Ann.
Math. Stat. 25, 1954.
"""

import functools
from typing import NamedTuple, TypeVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxscan.geometry import Array


SIZES = (3, 6, 10)
"""Half sizes of windows, and lines on either side of a possible edge: of fewer lines more noise would be left, of more
the surface itself would be smoothed."""
REACH = 20
"""Rows and lines that a window reaches to one side at most."""
STRAIGHT = 4500.0
"""How well it is known that surfaces are straight: information of a prior of the curvature, in that of two rows;
corners of a few standard deviations a line are still seen, and spheres are not cut into pieces."""
SLOPES = (0.0, 0.02, 0.05, 0.1, 0.2, 0.4, 0.8)
"""Slopes of a stripe that have tables of their own [px/line]."""
_ALIKE_ENOUGH = 1e-9
_MANY = 100
"""Rows whose mean is that of many: walls have about as many and more."""


_Count = TypeVar("_Count", int, Array)


class Correlation(NamedTuple):
    """Correlation of the errors of the rows of one profile. Hashable."""

    near: tuple[float, ...] = ()
    """Correlation of the noise of a row and of the k-th next one, from k = 1 on; 0 beyond [1]."""
    blocks: float = 0.0
    """Part of the variance that depends on where the stripe lies in the blocks of a compression, whose error is as
    large as noise is [1]: rows of an upright stripe share it, those of a steep one do not. That by a mosaic is
    beside it."""
    mosaic_px: float = 0.0
    """Standard deviation by where the stripe lies on a mosaic, however bright it is [px]: shared as well."""

    def by_light(self, lag: np.ndarray, slope: float) -> np.ndarray:
        """Correlation of the errors that are smaller in brighter rows, for a lag in rows and a slope [px/line]."""
        near = np.array([1.0, *self.near, 0.0])
        return (1.0 - self.blocks) * near[np.minimum(lag, len(near) - 1)] + self.blocks * alike_in_blocks(lag * slope)

    def by_mosaic(self, lag: np.ndarray, slope: float) -> np.ndarray:
        """Covariance of the errors by a mosaic, over their variance in an upright stripe."""
        return alike_on_mosaic(lag, slope, self.near)


INDEPENDENT = Correlation()
_BLOCK_PX = 0.5
"""Way of a stripe over which an error by compression stays alike, as a standard deviation."""
_LEAST_LEFT = 0.02
"""Least part of the variance by a mosaic that is left where demosaicing takes most of it away [1]."""


def alike_in_blocks(moved_px: np.ndarray) -> np.ndarray:
    """Correlation of the errors by compression of stripes that are `moved_px` apart."""
    return np.exp(-0.5 * (moved_px / _BLOCK_PX) ** 2)


def alike_on_mosaic(lag: np.ndarray, slope: np.ndarray | float, near: tuple[float, ...]) -> np.ndarray:
    """Covariance of errors by a mosaic, of rows so far apart, over their variance in an upright stripe.

    A mosaic has a colour on every second pixel, so its error has a period of two. It is there before demosaicing mixes
    rows: that filter, which makes noise alike, lets less of the error of steeper stripes pass.

    Args:
        slope: Of the stripe [px/row].
        near: Correlation of noise, as of `Correlation`.
    """
    filtered, turn = np.array(near), np.pi * np.asarray(slope)
    passed = 1.0 + 2.0 * np.cos(turn[..., None] * np.arange(1, len(near) + 1)) @ filtered
    return np.clip(passed / (1.0 + 2.0 * filtered.sum()), _LEAST_LEFT, 1.0) * np.cos(turn * lag)


class Tables(NamedTuple):
    """Figures of fits over those of independent rows, float32; 1 where a window has too few rows. First, by slope, of
    rows with errors by light alone, then of those with errors by a mosaic alone."""

    windows: Float[Array, "sizes windows 4"]
    """Variance of a parabola's value, mean of chi-squared, its standard deviation, and the variance of the value's
    difference to that of the next smaller window; by the rows that are free before and behind."""
    edges: Float[Array, " edges"]
    """Mean gain in chi-squared of two lines over a parabola; by the rows on both sides."""
    rows: Float[Array, "errors 3"]
    """Chi-squared of four neighbours about a line, variance of a row's distance from that line, and that of the mean of
    many rows."""
    mosaic: Array
    """Variance by a mosaic [px^2]."""
    correlated: Array
    """Whether any of them is not 1."""


@functools.lru_cache(maxsize=16)
def tables_of(correlation: Correlation) -> Tables:
    """Tables for `smooth_profiles`."""
    lag = np.abs(np.subtract.outer(np.arange(_MANY), np.arange(_MANY)))
    covariances = [kind(lag, slope) for kind in (correlation.by_light, correlation.by_mosaic) for slope in SLOPES]
    windows, edges, rows = (np.stack(part).astype(np.float32) for part in zip(*map(_tables, covariances), strict=True))
    windows = windows.swapaxes(0, 1).reshape(len(SIZES), -1, 4)
    mosaic = np.asarray(correlation.mosaic_px**2, np.float32)
    return Tables(windows, edges.reshape(-1), rows, mosaic, np.asarray(correlation != INDEPENDENT))


def _tables(covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where many rows have such a covariance."""
    mean_of_many = _MANY * covariance.mean()
    covariance = covariance[: 2 * REACH + 1, : 2 * REACH + 1]
    fits, weights, before = _windows()
    shape = (len(SIZES), (REACH + 1) ** 2)
    quadratic = lambda h: np.einsum("...i,ij,...j->...", h, covariance, h)
    # For equal weights h it is the same as before.
    ratio = lambda h: np.where((h**2).sum(-1) > _ALIKE_ENOUGH, quadratic(h) / np.maximum((h**2).sum(-1), 1e-30), 1.0)
    size = fits.projections.shape[1]
    product = fits.projections @ covariance[:size, :size]
    free = np.maximum(fits.rows - 3.0, 1.0)
    mean = np.trace(product, axis1=1, axis2=2) / free
    spread = np.sqrt(np.maximum(np.einsum("wij,wji->w", product, product), 0.0) / free)
    known = fits.rows > 3
    own = [np.where(known, one, 1.0)[fits.number].reshape(shape) for one in (mean, spread)]
    windows = np.stack([ratio(weights), *own, ratio(weights - before)], -1)
    edges = np.ones((SIZES[-1] + 1, SIZES[-1] + 1))
    for (left, right), gain in _gains().items():
        edges[left, right] = np.sum(gain * covariance[: left + right, : left + right]) / np.trace(gain)
    around = np.array([-2, -1, 1, 2])
    line = _hat(np.stack([np.ones(4), around], 1))
    agree = np.sum((np.eye(4) - line) * covariance[np.ix_(around + 2, around + 2)]) / 2.0
    away = np.array([-0.25, -0.25, 1.0, -0.25, -0.25])
    stray = away @ covariance[:5, :5] @ away / (away @ away)
    return windows, edges, np.array([agree, stray, mean_of_many])


class _Fits(NamedTuple):
    projections: Float[np.ndarray, "windows rows rows"]
    """Onto the residuals of a parabola, for each kind of window."""
    rows: Float[np.ndarray, " windows"]
    number: Float[np.ndarray, " all"]
    """Which kind each size has, with the rows that are free before and behind."""


@functools.cache
def _windows() -> tuple[_Fits, np.ndarray, np.ndarray]:
    """All windows; the weights of their values; and those of the next smaller ones [sizes, windows, rows]."""
    kinds: dict[tuple[int, int], int] = {}
    number = []
    for size in SIZES:
        for left in range(REACH + 1):
            for right in range(REACH + 1):
                kind = window_of(left, right, size)
                number.append(kinds.setdefault(kind, len(kinds)))
    most = 2 * SIZES[-1] + 1
    projections, values = np.zeros((len(kinds), most, most)), np.zeros((len(kinds), 2 * REACH + 1))
    for (low, high), k in kinds.items():
        x, rows = np.arange(-low, high + 1), low + high + 1
        if rows < 3:
            values[k, REACH] = 1.0
            continue
        design = np.stack([np.ones(rows), x, x**2], 1)
        projections[k, :rows, :rows] = np.eye(rows) - _hat(design)
        values[k, REACH - low : REACH + high + 1] = _hat(design)[low]
    weights = values[number].reshape(len(SIZES), -1, 2 * REACH + 1)
    alone = np.zeros_like(weights[:1])
    alone[..., REACH] = 1.0
    lengths = np.array([low + high + 1.0 for low, high in kinds])
    return _Fits(projections, lengths, np.array(number)), weights, np.concatenate([alone, weights[:-1]])


@functools.cache
def _gains() -> dict[tuple[int, int], np.ndarray]:
    """Quadratic forms of the gain in chi-squared of two lines over a parabola, by the rows on both sides."""
    found = {}
    for left in range(2, SIZES[-1] + 1):
        for right in range(2, SIZES[-1] + 1):
            x = np.arange(1.0 - left, right + 1.0)
            ones, before = np.ones(left + right), np.arange(left + right) < left
            lines = np.stack([ones * before, x * before, ones * ~before, x * ~before], 1)
            curved = np.stack([ones, x, x**2], 1)
            found[left, right] = _hat(lines) - _hat(curved, np.diag([0.0, 0.0, 0.5 * STRAIGHT]))
    return found


def _hat(design: np.ndarray, prior: np.ndarray | float = 0.0) -> np.ndarray:
    return design @ np.linalg.solve(design.T @ design + prior, design.T)


def window_of(left: _Count, right: _Count, size: int) -> tuple[_Count, _Count]:
    """Rows of a window on both sides of a row with so many free ones: a side that ends early is made up for on the
    other."""
    least = min if isinstance(left, int) else jnp.minimum
    return least(left, 2 * size - least(right, size)), least(right, 2 * size - least(left, size))
