"""How much of the stripe is in the laser-off frame too: a laser that glows on, a shutter that is late."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float


NO_INFORMATION = 1e3
"""Standard deviation of a ratio of which the frames tell nothing [1]."""
_PIXEL = 1.0 / 12.0
"""Addition of a pixel's aperture to the square of a stripe's width [px^2]."""
_CUT = 3.0
"""Residual from which a line counts less in its frame, in the frame's standard deviations."""
_STEPS = 4


class OffWindow(NamedTuple):
    """The laser-off frame around stripes."""

    level: Float[np.ndarray, "samples n"]
    """[DN]"""
    x: Float[np.ndarray, "samples n"]
    """Coordinates of the samples, evenly spaced and rising [px]."""
    used: Bool[np.ndarray, "samples n"]
    """Samples that count."""
    variance: Float[np.ndarray, "#samples #n"]
    """Variance of `level` [DN^2]."""


class Leak(NamedTuple):
    """Part of the stripe that is in the laser-off frame."""

    ratio: Float[np.ndarray, "*n"]
    """Its amplitude over the stripe's [1]; 0 where it is not known."""
    sigma: Float[np.ndarray, "*n"]
    """Standard deviation of `ratio` [1]; `NO_INFORMATION` where it is not known."""


def leak(
    dark: OffWindow, u: Float[np.ndarray, " n"], width: Float[np.ndarray, " n"], amplitude: Float[np.ndarray, " n"]
) -> Leak:
    r"""Amplitude of the stripe in the laser-off frame, line by line.

    Least squares of $\mathrm{dark}(x) = b_0 + b_1 x + r A h(x)$ with $h$ the Gaussian that was fitted to the
    difference. The light that leaks is missing in the difference: of the laser's light $r / (1 + r)$ is in the
    laser-off frame.

    Args:
        dark: The laser-off frame in the window of the fit.
        u: Fitted centre, in the coordinates of `dark.x` [px].
        width: Fitted standard deviation of the stripe [px].
        amplitude: Fitted amplitude of the stripe [DN].
    """
    seen = np.sqrt(width * width + _PIXEL)
    z = (dark.x - u[None, :]) * (1.0 / seen)[None, :]
    weight = np.where(dark.used, 1.0 / np.broadcast_to(np.asarray(dark.variance), z.shape), 0.0)
    h = np.exp(-0.5 * z * z) * (width / seen)[None, :]
    # Samples are counted from the middle, levels from their mean: squares of large numbers would cost the digits of
    # small ones.
    s = (np.arange(len(z)) - (len(z) - 1) // 2).astype(z.dtype)[:, None]
    level, weight_h = dark.level - np.mean(dark.level, 0)[None, :], weight * h
    count, count_s, count_ss = (np.sum(weight * s**power, 0) for power in range(3))
    sum_h, sum_hs, sum_hh = np.sum(weight_h, 0), np.sum(weight_h * s, 0), np.sum(weight_h * h, 0)
    sum_d, sum_ds, sum_dh = np.sum(weight * level, 0), np.sum(weight * level * s, 0), np.sum(weight_h * level, 0)

    # The Gaussian, and the levels along it, without their straight lines.
    some = count > 0
    safe = np.where(some, count, 1.0)
    spread = count_ss - count_s * count_s / safe
    tilt_h, tilt_d = sum_hs - count_s * sum_h / safe, sum_ds - count_s * sum_d / safe
    straight = spread > 1e-4 * count_ss
    per_spread = np.where(straight, 1.0 / np.where(straight, spread, 1.0), 0.0)
    left = sum_hh - sum_h * sum_h / safe - tilt_h * tilt_h * per_spread
    along = sum_dh - sum_h * sum_d / safe - tilt_h * tilt_d * per_spread
    known = some & straight & (left > 1e-3 * sum_hh) & (amplitude > 0)
    left, tall = np.where(known, left, 1.0), np.where(known, amplitude, 1.0)
    return Leak(
        ratio=np.where(known, along / (left * tall), 0.0),
        sigma=np.where(known, 1.0 / (np.sqrt(left) * tall), NO_INFORMATION),
    )


def frame_leak(lines: Leak, valid: Bool[np.ndarray, "*frames n"]) -> Leak:
    """The mean over the lines of a frame, of which texture may have spoilt some.

    Lines are weighted by their information; those that lie further from the mean than 3 standard
    deviations, as the frame itself shows them, count less the further they lie.

    Args:
        lines: Ratio and standard deviation of every line.
        valid: Lines that hold a stripe.

    Returns:
        Ratio of each frame, and its standard deviation, from the scatter of the lines where that is
        larger than their noise.
    """
    information = np.where(valid & (lines.sigma < NO_INFORMATION), 1.0 / (lines.sigma * lines.sigma), 0.0)
    per_sigma = np.sqrt(information)
    known = np.sum(information, -1) > 0
    count = np.maximum(np.sum((information > 0).astype(information.dtype), -1), 1.0)
    weight = information

    def mean_of(weight):
        total = np.sum(weight, -1)
        return np.sum(weight * lines.ratio, -1) / np.where(known, total, 1.0)

    mean = mean_of(weight)
    scale = np.ones_like(mean)
    for _ in range(_STEPS):
        residual = np.abs(lines.ratio - mean[..., None]) * per_sigma
        # The scatter without the lines that the last step found far away.
        near = np.minimum(residual, _CUT * scale[..., None])
        scale = np.maximum(np.sqrt(np.sum(near * near, -1) / count), 1.0)
        far = residual / (_CUT * scale[..., None])
        weight = information / np.maximum(far, 1.0) ** 2
        mean = mean_of(weight)
    total = np.where(known, np.sum(weight, -1), 1.0)
    return Leak(
        ratio=np.where(known, mean, 0.0),
        sigma=np.where(known, scale / np.sqrt(total), NO_INFORMATION),
    )
