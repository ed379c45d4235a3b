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
_WEIGHTS = (np.array([1.0, -2.0, 1.0]), np.array([1.0, -4.0, 6.0, -4.0, 1.0]))
_CUT = 4.0
"""Standard deviations beyond which a difference is an edge."""


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
    line_step: int = 1,
) -> Scatter:
    r"""The scatter of rows, from fourth differences along the stripe.

    $u_{i-2k} - 4 u_{i-k} + 6 u_i - 4 u_{i+k} + u_{i+2k}$ of a smooth and curved surface is noise alone. Its spread
    for k = 2 over its promised standard deviation, in classes of amplitude, is the scale; what is far beyond the
    spread of the others is an edge, and left out. With a correlation r of next neighbours its variance is
    $70 - 112 r$ for k = 1, and 70 for k = 2. Neither is believed to be good news: a scale below 1 is 1, a correlation
    below 0 is 0.

    Args:
        u: Stripe centres of the rows [px].
        sigma: Their standard deviations [px].
        valid: Which of them exist.
        amplitude: Of the stripes [DN].
        line_step: Distance of the lines on which the laser's colour is seen.
    """
    # Evenly spread: records of one kind may come in turn with others.
    count = int(np.clip(-(-_MOST // max(u.shape[1], 1)), 1, max(len(u), 1)))
    chosen = np.unique(np.linspace(0, max(len(u) - 1, 0), count).round().astype(int)) if len(u) else np.arange(0)
    some = tuple(np.asarray(field)[chosen] for field in (u, sigma, valid, amplitude))
    scales = []
    for weights in _WEIGHTS:
        scattered, level = _differences(some, 2 * line_step, weights)
        classes = int(np.clip(len(level) // _LEAST, 0, _CLASSES))
        if classes == 0:
            return Scatter(np.ones_like(sigma), 0.0)
        ranks = np.array_split(np.argsort(level, kind="stable"), classes)
        middle = [float(np.median(level[rank])) for rank in ranks]
        scales.append(np.interp(_levels := np.asarray(amplitude,np.float32), middle, [_spread(scattered[rank]) for rank in ranks]))
    scale = np.minimum(*scales)
    near, far = (_spread(one) ** 2 for one in (_differences(some, line_step,weights)[0], scattered))
    correlation = float(np.clip(0.625 * (1.0 - near / far), 0.0, _MOST_ALIKE)) if far > 0 else 0.0
    grid = np.clip(scale, 1.0, _LARGEST)
    return Scatter(grid.astype(sigma.dtype), correlation)


def _differences(stripes: tuple[np.ndarray, ...], apart: int, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Absolute differences over their promised standard deviation, and amplitudes, of rows so far apart."""
    u, sigma, valid, amplitude = stripes
    reach = (len(weights) - 1) * apart
    parts = [np.s_[:, k * apart : max(u.shape[1] - reach, 0) + k * apart] for k in range(len(weights))]
    whole = np.logical_and.reduce([valid[part] for part in parts])
    difference = sum(w * u[part][whole] for w, part in zip(weights, parts, strict=True))
    variance = sum(w * w * sigma[part][whole] ** 2 for w, part in zip(weights, parts, strict=True))
    return np.abs(difference) / np.sqrt(np.maximum(variance, 1e-18)), amplitude[parts[len(weights) // 2]][whole]


def _spread(values: Float[np.ndarray, " n"]) -> float:
    """Standard deviation about 0 of the values within three of them, by iteration from the smallest fifth."""
    found = float(np.quantile(values, 0.2)) / 0.2533
    for _ in range(10):
        near = values[values <= 3.0 * found]
        found = 1.0136 * float(np.sqrt(np.mean(near**2))) if len(near) else 0.0
    return found
