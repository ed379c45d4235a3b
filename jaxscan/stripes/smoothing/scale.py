"""How the centres of neighbouring rows scatter, compared with what their sigmas promise."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float


_CLASSES = 8
"""Classes of amplitude with a scale of their own."""
_LEAST = 200
"""Rows that a class needs."""
_MOST = 30_000
"""Rows that are looked at, about."""
_LARGEST, _MOST_ALIKE = 3.0, 0.4


class Scatter(NamedTuple):
    """The scatter of rows around a smooth surface."""

    scale: Float[np.ndarray, "profiles lines"]
    """Factor by which the sigma of every row is too small [1]."""
    correlation: float
    """Of the noise of neighbouring rows [1]: blur spreads the grains of speckle over both."""


def row_scatter(
    u: Float[np.ndarray, "profiles lines"],
    sigma: Float[np.ndarray, "profiles lines"],
    valid: Bool[np.ndarray, "profiles lines"],
    amplitude: Float[np.ndarray, "profiles lines"],
) -> Scatter:
    r"""The scatter of rows, from second differences along the stripe.

    $u_{i-k} - 2 u_i + u_{i+k}$ of a smooth surface is noise alone. Its median for k = 2 over its promised standard
    deviation, in classes of amplitude, is the scale; rows on edges may be many, but not half. With a correlation r of
    next neighbours its variance is $6 - 8 r$ for k = 1, and 6 for k = 2. Neither is believed to be good news: a scale
    below 1 is 1, a correlation below 0 is 0.

    Args:
        u: Stripe centres of the rows [px].
        sigma: Their standard deviations [px].
        valid: Which of them exist.
        amplitude: Of the stripes [DN].
    """
    every = max(1, u.size // _MOST)
    some = tuple(np.asarray(field)[::every] for field in (u, sigma, valid, amplitude))
    lines = np.flatnonzero(np.asarray(valid).any(0))
    step = int(np.gcd.reduce(np.diff(lines))) if len(lines) > 1 else 1
    scattered, level = _second_differences(some, 2 * step)
    classes = int(np.clip(len(level) // _LEAST, 0, _CLASSES))
    if classes == 0:
        return Scatter(np.ones_like(sigma), 0.0)
    ranks = np.array_split(np.argsort(level, kind="stable"), classes)
    middle = [float(np.median(level[rank])) for rank in ranks]
    # Median of a half normal distribution: 0.6745 sigma.
    scale = [float(np.median(scattered[rank])) / 0.6745 for rank in ranks]
    near, far = (float(np.median(one)) ** 2 for one in (_second_differences(some, step)[0], scattered))
    correlation = float(np.clip(0.75 * (1.0 - near / far), 0.0, _MOST_ALIKE)) if far > 0 else 0.0
    grid = np.interp(amplitude, middle, np.clip(scale, 1.0, _LARGEST)).astype(sigma.dtype)
    return Scatter(grid, correlation)


def _second_differences(stripes: tuple[np.ndarray, ...], apart: int) -> tuple[np.ndarray, np.ndarray]:
    """Absolute second differences over their promised standard deviation, and amplitudes, of rows so far apart."""
    u, sigma, valid, amplitude = stripes
    a, b, c = (np.s_[:, start : max(u.shape[1] - 2 * apart, 0) + start] for start in (0, apart, 2 * apart))
    whole = valid[a] & valid[b] & valid[c]
    difference = np.abs(u[a] - 2.0 * u[b] + u[c])[whole]
    promised = np.sqrt(sigma[a] ** 2 + 4.0 * sigma[b] ** 2 + sigma[c] ** 2)[whole]
    return difference / np.maximum(promised, 1e-9), amplitude[b][whole]
