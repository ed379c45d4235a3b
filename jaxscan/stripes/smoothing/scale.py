"""How much the centres of neighbouring rows scatter, over what their sigmas promise."""

import numpy as np
from jaxtyping import Bool, Float


_CLASSES = 8
"""Classes of amplitude with a scale of their own."""
_LEAST = 200
"""Rows that a class needs."""
_MOST = 100_000
"""Rows that are looked at."""
_LARGEST = 3.0


def sigma_scale(
    u: Float[np.ndarray, "profiles lines"],
    sigma: Float[np.ndarray, "profiles lines"],
    valid: Bool[np.ndarray, "profiles lines"],
    amplitude: Float[np.ndarray, "profiles lines"],
) -> Float[np.ndarray, "profiles lines"]:
    r"""Factor by which the sigma of every row is too small [1], from second differences along the stripe.

    $u_{i-1} - 2 u_i + u_{i+1}$ of a smooth surface is noise alone. Its median over its promised standard deviation, in
    classes of amplitude, is the scale; half of the rows may lie on edges. It is never below 1: where rows share their
    noise, second differences are too small.

    Args:
        u: Stripe centres of the rows [px].
        sigma: Their standard deviations [px].
        valid: Which of them exist.
        amplitude: Of the stripes [DN].
    """
    u, sigma, valid, amplitude = (np.asarray(field) for field in (u, sigma, valid, amplitude))
    lines = np.flatnonzero(valid.any(0))
    step = int(np.gcd.reduce(np.diff(lines))) if len(lines) > 1 else 1
    every = max(1, u.size // _MOST)
    a, b, c = (np.s_[::every, start : u.shape[1] - 2 * step + start] for start in (0, step, 2 * step))
    whole = valid[a] & valid[b] & valid[c]
    difference = np.abs(u[a] - 2.0 * u[b] + u[c])[whole]
    promised = np.sqrt(sigma[a] ** 2 + 4.0 * sigma[b] ** 2 + sigma[c] ** 2)[whole]
    level = amplitude[b][whole]
    classes = int(np.clip(len(level) // _LEAST, 0, _CLASSES))
    if classes == 0:
        return np.ones_like(sigma)
    ranks = np.array_split(np.argsort(level, kind="stable"), classes)
    middle = [float(np.median(level[rank])) for rank in ranks]
    # Median of a half normal distribution: 0.6745 sigma.
    scale = [float(np.median(difference[rank] / np.maximum(promised[rank], 1e-9))) / 0.6745 for rank in ranks]
    return np.interp(amplitude, middle, np.clip(scale, 1.0, _LARGEST)).astype(sigma.dtype)
