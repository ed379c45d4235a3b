"""How much of the stripe is in the laser-off frame too: a laser that glows on, a shutter that is late."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Bool, Float

from jaxscan.geometry import Array
from jaxscan.stripes.fit import DarkWindow, moments


NO_INFORMATION = 1e3
"""Standard deviation of a ratio of which the frames tell nothing [1]."""
_PIXEL = 1.0 / 12.0
"""Addition of a pixel's aperture to the square of a stripe's width [px^2]."""
_CUT = 3.0
"""Residual from which a line counts less in its frame, in the frame's standard deviations."""
_STEPS = 4


class Leak(NamedTuple):
    """Part of the stripe that is in the laser-off frame."""

    ratio: Float[Array, "*n"]
    """Its amplitude over the stripe's [1]; 0 where it is not known."""
    sigma: Float[Array, "*n"]
    """Standard deviation of `ratio` [1]; `NO_INFORMATION` where it is not known."""


def leak(dark: DarkWindow, u: Float[Array, " n"], width: Float[Array, " n"], amplitude: Float[Array, " n"]) -> Leak:
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
    seen = jnp.sqrt(width * width + _PIXEL)
    z = (dark.x - u[None, :]) * (1.0 / seen)[None, :]
    weight = jnp.where(dark.used, 1.0 / jnp.broadcast_to(jnp.asarray(dark.variance), z.shape), 0.0)
    h = jnp.exp(-0.5 * z * z) * (width / seen)[None, :]
    weight_h = weight * h
    count, count_s, count_ss = moments(weight, 3)
    sum_h, sum_hs = moments(weight_h, 2)
    (sum_hh,) = moments(weight_h * h, 1)
    # Levels from about their mean: squares of large numbers would cost the digits of small ones.
    level = dark.level - jnp.mean(dark.level, 0)[None, :]
    sum_d, sum_ds = moments(weight * level, 2)
    (sum_dh,) = moments(weight_h * level, 1)

    # The Gaussian, and the levels along it, without their straight lines.
    some = count > 0
    safe = jnp.where(some, count, 1.0)
    spread = count_ss - count_s * count_s / safe
    tilt_h, tilt_d = sum_hs - count_s * sum_h / safe, sum_ds - count_s * sum_d / safe
    straight = spread > 1e-4 * count_ss
    per_spread = jnp.where(straight, 1.0 / jnp.where(straight, spread, 1.0), 0.0)
    left = sum_hh - sum_h * sum_h / safe - tilt_h * tilt_h * per_spread
    along = sum_dh - sum_h * sum_d / safe - tilt_h * tilt_d * per_spread
    known = some & straight & (left > 1e-3 * sum_hh) & (amplitude > 0)
    left, tall = jnp.where(known, left, 1.0), jnp.where(known, amplitude, 1.0)
    return Leak(
        ratio=jnp.where(known, along / (left * tall), 0.0),
        sigma=jnp.where(known, 1.0 / (jnp.sqrt(left) * tall), NO_INFORMATION),
    )


def frame_leak(lines: Leak, valid: Bool[Array, "*frames n"]) -> Leak:
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
    information = jnp.where(valid & (lines.sigma < NO_INFORMATION), 1.0 / (lines.sigma * lines.sigma), 0.0)
    per_sigma = jnp.sqrt(information)
    known = jnp.sum(information, -1) > 0
    count = jnp.maximum(jnp.sum((information > 0).astype(information.dtype), -1), 1.0)
    weight = information

    def mean_of(weight):
        total = jnp.sum(weight, -1)
        return jnp.sum(weight * lines.ratio, -1) / jnp.where(known, total, 1.0)

    mean = mean_of(weight)
    scale = jnp.ones_like(mean)
    for _ in range(_STEPS):
        residual = jnp.abs(lines.ratio - mean[..., None]) * per_sigma
        # The scatter without the lines that the last step found far away.
        near = jnp.minimum(residual, _CUT * scale[..., None])
        scale = jnp.maximum(jnp.sqrt(jnp.sum(near * near, -1) / count), 1.0)
        far = residual / (_CUT * scale[..., None])
        weight = information / jnp.maximum(far, 1.0) ** 2
        mean = mean_of(weight)
    total = jnp.where(known, jnp.sum(weight, -1), 1.0)
    return Leak(
        ratio=jnp.where(known, mean, 0.0),
        sigma=jnp.where(known, scale / jnp.sqrt(total), NO_INFORMATION),
    )
