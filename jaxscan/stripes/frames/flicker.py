"""How much brighter the lamps of the room were in the laser-on frame than in the laser-off frame.

Lamps on alternating current flicker; where an exposure is no whole number of their periods, the two
frames of a pair differ by a factor, and the difference is no longer the laser alone.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from jaxscan.geometry import Array, namespace


NO_INFORMATION = 1.0
"""Standard deviation of a ratio about which the frames say nothing [1]."""
SMALLEST_CHANGE = 0.005
"""Change of the ratio below which the frames are left as they are [1]: an eighth of a DN at 25 DN."""
_CERTAIN = 4.0
"""Standard deviations that a change must stand out by."""
_CUT = 3.0
"""Residual from which a pixel counts for nothing, in standard deviations (Tukey's weight): little of
the laser's glow is then taken for ambient light."""
_HASTE = 1.58
"""Mean weight over mean slope of the weighted residual, in Gaussian noise: makes Newton's step of a
reweighted one."""
_EFFICIENCY = 0.949
"""Information that is left with these weights, over the sum of the weighted information."""
_GLOW = 0.03
"""Largest pull of glow on the ratio, in the noise of a pixel: light of 1 to 3 standard deviations on a tenth of the
pixels cannot be told from lamps and moves their mean by a tenth, of which this is a good quarter."""
_WIDENED = (0.08, 0.02)
"""Error of the ratio that the first steps allow for [1]."""
_CLIPPED = 6.0
"""Residual at which a pixel's share in the unrest is cut off, in standard deviations."""
_EVERY = 4
"""The first steps look at every fourth pixel."""
_START = (0.6, 1.5)
"""Ratios between which a pixel may vote for the start."""
_LANES = 64
_SATURATED = 250
"""Level from which a pixel does not count [DN]."""


class LampRatio(NamedTuple):
    """Brightness of the room in a laser-on frame, in that of its laser-off frame."""

    ratio: Float[Array, " frames"]
    """Factor by which ambient light is brighter in the laser-on frame [1]; 1 where it is not known."""
    sigma: Float[Array, " frames"]
    """Standard deviation of `ratio` [1], with the pull of faint glow of the laser; `NO_INFORMATION`
    where it is not known."""
    unrest: Float[Array, " frames"]
    """Robust root mean square of the residuals, over that of the noise [1]:
    1 where all is still; 0 where nothing is known."""


def lamp_ratio(
    on: UInt8[Array, "frames n"],
    off: UInt8[Array, "frames n"],
    read_dn: Float[Array, ""] | float,
    electrons_per_dn: Float[Array, ""] | float,
) -> LampRatio:
    r"""Ratio of the ambient light between the frames of each pair.

    $\mathrm{on} = g\,\mathrm{off}$ but for the few pixels that the laser reaches. Both sides are noisy, so
    the slope is taken with $x = (\mathrm{on} + \mathrm{off}) / (1 + g)$ as instrument, whose noise is not
    correlated with that of the residual $r$ (exactly for shot noise, nearly for read noise),

    $$g \leftarrow \frac{\sum w\,x\,\mathrm{on} / s^2}{\sum w\,x\,\mathrm{off} / s^2}, \qquad
      w = (1 - r^2 / (c s)^2)_+^2, \qquad s^2 = (1 + g^2)(\mathrm{read}^2 + 1/12) + g (1 + g) x / K,$$

    in three steps that narrow down on the bulk of the pixels. Dark pixels, which are cut off at zero,
    and saturated ones do not count. The laser only adds light: the unrest is that of the pixels
    that are darker than expected. Glow within the noise is taken for lamps; the standard deviation knows.

    Args:
        on: Pixels of each laser-on frame, about 10^4 of them, spread over it.
        off: The same pixels with the laser off.
        read_dn: Read noise of one frame [DN].
        electrons_per_dn: Conversion gain K [e-/DN].

    Returns:
        Ratio, its standard deviation and the unrest of each pair; ratios between 0.6 and 1.5 are found. Of NumPy arrays
            in NumPy, which compiles nothing.

    Source:
        A. E. Beaton and J. W. Tukey, The fitting of power series, Technometrics 16, 1974 (the weight);
        W. A. Fuller, Measurement Error Models, 1987, section 1.4 (the instrument).
    """
    xp = namespace(on, off, read_dn, electrons_per_dn)
    frames, count = on.shape
    floor = xp.asarray(read_dn, np.float32) ** 2 + 1.0 / 12
    per_dn = 1.0 / xp.asarray(electrons_per_dn, np.float32)
    # A sum of two levels below this may have lost its lower part to the cut at zero.
    dark = 6.0 * xp.sqrt(floor)
    # Sums along a leading axis compile to vector instructions, sums along the last do not.
    padding = -count % (_LANES * _EVERY)
    on, off = (xp.pad(xp.asarray(a), ((0, 0), (0, padding))).reshape(frames, -1, _LANES) for a in (on, off))

    def total(values: Float[Array, "frames m lanes"]) -> Float[Array, " frames"]:
        return xp.sum(xp.sum(values, 1), 1)

    def levels(stride: int) -> tuple[Array, Array, Array]:
        a, b = (frame[:, ::stride].astype(np.float32) for frame in (on, off))
        usable = (a + b > dark) & (xp.maximum(a, b) < _SATURATED)
        return a, b, usable

    def step(pixels, ratio, widened):
        a, b, usable = pixels
        g = ratio[:, None, None]
        x = (a + b) / (1.0 + g)
        variance = (1.0 + g * g) * floor + (g * (1.0 + g) * per_dn) * x + (widened * widened) * (x * x)
        residual = a - g * b
        per_variance = 1.0 / variance
        square = residual * residual * per_variance
        weight = xp.maximum(1.0 - square * (1.0 / _CUT**2), 0.0)
        weight = xp.where(usable, weight * weight * x * per_variance, 0.0)
        return a, b, x, residual, square, weight

    few = levels(_EVERY)
    a, b, usable = few
    slack = 3.0 * xp.sqrt(floor)
    voted = xp.clip(a, _START[0] * b - slack, _START[1] * b + slack)
    first = total(xp.where(usable, voted, 0.0)), total(xp.where(usable, b, 0.0))
    ratio = _towards(xp.ones(frames, np.float32), *first, haste=1.0)
    for widened in _WIDENED:
        a, b, _, _, _, weight = step(few, ratio, widened)
        ratio = _towards(ratio, total(weight * a), total(weight * b))
    every = levels(1)
    a, b, x, residual, square, weight = step(every, ratio, 0.0)
    darker = every[2] & (residual < 0.0)
    information = total(weight * x)
    spread = total(xp.where(darker, xp.minimum(square, _CLIPPED**2), 0.0))
    number = total(darker.astype(np.float32))
    ratio = _towards(ratio, total(weight * a), total(weight * b))
    information = _EFFICIENCY * information
    known = (information * NO_INFORMATION**2 > 1.0) & (number > 0)
    unrest = xp.sqrt(xp.where(known, spread / xp.maximum(number, 1.0), 0.0))
    glow = 2.0 * _GLOW**2 * number
    sigma = xp.sqrt((xp.maximum(unrest, 1.0) ** 2 + glow) / xp.where(known, information, 1.0))
    return LampRatio(
        ratio=xp.where(known, ratio, 1.0),
        sigma=xp.where(known, xp.minimum(sigma, NO_INFORMATION), NO_INFORMATION),
        unrest=unrest,
    )


def applied_ratio(pair: LampRatio) -> Float[Array, " frames"]:
    """The factor by which laser-off frames are multiplied before they are subtracted.

    Returns:
        The ratio where it differs from 1 by more than 4 of its standard deviations and 0.005;
        elsewhere exactly 1, so that frames under steady light stay as they are.
    """
    xp = namespace(pair)
    change = abs(pair.ratio - 1.0)
    return xp.where(change > xp.maximum(SMALLEST_CHANGE, _CERTAIN * pair.sigma), pair.ratio, 1.0)


def _towards(
    ratio: Float[Array, " frames"], top: Float[Array, " frames"], bottom: Float[Array, " frames"], haste: float = _HASTE
) -> Float[Array, " frames"]:
    """The ratio moved towards that of two sums, within bounds; as it was where nothing counted."""
    xp, some = namespace(ratio, top), bottom > 0
    step = top / xp.where(some, bottom, 1.0) - ratio
    return xp.clip(ratio + xp.where(some, haste * step, 0.0), 0.5, 2.0)
