"""Shift of stripe centres by the print under them, predicted from the laser-off image."""

from typing import NamedTuple

import numpy as np

from jaxscan.geometry import median_sigma


_REACH = 12
"""Samples used on either side of the centre."""
_PAD = _REACH + 4
# Rounds of the alternation between true centre and shift, and Gauss-Newton steps of the Gaussian fit.
_ROUNDS = 6
_STEPS = 6
# The stripe's own width is the median of this many lines with a shift smaller than this [px].
_EVEN_PX = 0.02
_EVEN_LINES = 15
# Errors of the prediction: a constant [px], a share of the shift, and a share of the stripe's width
# times the relative noise of the image.
_PREDICTION_PX = 0.07
_PREDICTION_SHARE = 0.25
_PREDICTION_NOISE = 1.0


class InkShift(NamedTuple):
    """Shift of a stripe's centre by the print under it."""

    predicted: np.ndarray
    """float64 [lines]: predicted difference of measured and true centre [px]."""
    correction: np.ndarray
    """float64 [lines]: part of it to subtract from the measured centre [px]."""
    sigma: np.ndarray
    """float64 [lines]: standard deviation after the correction [px]."""


def ink_shift(image: np.ndarray, line: np.ndarray, centre: np.ndarray, width: np.ndarray, blur: float) -> InkShift:
    r"""Shift of stripe centres by the print under them.

    Laser light and room light meet the same paper, and the lens blurs both. A sheet of laser
    light of width $w_l$ seen through a blur $b$ has the width $w^2 = w_l^2 + b^2$, and paper $a$
    lends it the shape

    $$D(u) = G_w(u - c)\; (a * G_\tau)\bigl(c + \rho (u - c)\bigr),
      \qquad \rho = w_l^2 / w^2, \quad \tau^2 = \rho b^2,$$

    exactly. The laser-off image shows $a * G_b$, so its blur is first reduced from $b$ to $\tau$.
    (The product of the image itself and the stripe would predict a shift several times too large
    where the stripe is little wider than the blur.) A Gaussian is fitted to $D$ as in the
    extraction; its centre minus $c$ is the shift.

    Most lines lie on plain paper, and the prediction has errors of some hundredths of a pixel:
    small shifts are mostly error, so only a part of them is subtracted.

    Args:
        image: Laser-off image [lines, samples], DN of 8 bits.
        line: Line of each point [points].
        centre: Measured centre of the stripe [points], px.
        width: Measured standard deviation of its profile [points], px.
        blur: Standard deviation of the lens's blur [px].

    Source: Curless and Levoy, Better optical triangulation through spacetime analysis (1995), for
    the error at edges of reflectance; the identity is that of a product of two Gaussians.
    """
    # Rounding to whole DN gives at least 0.3 DN; more than 8 bits are rounded far below their noise.
    rounding = 0.3 if image.dtype == np.uint8 else 0.0
    image = np.asarray(image, np.float64)
    error = np.hypot(_PREDICTION_PX, _PREDICTION_NOISE * width * _relative_noise(image, line, centre, rounding))
    # The mean of three lines: the print hardly changes within them, and the noise is averaged.
    image = np.pad(image, ((1, 1), (_PAD, _PAD)), mode="edge")
    image = (image[:-2] + image[1:-1] + image[2:]) / 3.0
    spread = _own_width(line, width, 0.7 * _shift(image, line, centre, width, blur))
    shift = np.zeros(len(line))
    for _ in range(_ROUNDS):
        shift = 0.3 * shift + 0.7 * _shift(image, line, centre - shift, spread, blur)
    believed = shift**2 / (shift**2 + error**2)
    left = np.hypot(error * np.sqrt(believed), _PREDICTION_SHARE * shift)
    return InkShift(shift, believed * shift, left)


def _relative_noise(image: np.ndarray, line: np.ndarray, centre: np.ndarray, least: float) -> np.ndarray:
    """Noise of the mean of three lines, divided by the level under the stripe [points]; `least`: of one line [DN]."""
    first, last = np.clip(line - 1, 0, len(image) - 1), np.clip(line + 1, 0, len(image) - 1)
    sample = np.clip(np.rint(centre).astype(int)[:, None] + np.arange(-2, 3), 0, image.shape[1] - 1)
    above, here, below = (image[at[:, None], sample] for at in (first, line, last))
    # At least half of the points are not on an edge; there a line differs from the mean of its neighbours
    # by noise alone.
    noise = median_sigma(here - 0.5 * (above + below)) / np.sqrt(1.5)
    level = (above + here + below).mean(1) / 3.0
    return max(noise, least) / np.sqrt(3.0) / np.maximum(level, 1.0)


def _own_width(line: np.ndarray, width: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """The stripe's width without the effect of ink, from lines on plain paper near by."""
    even = np.flatnonzero(np.abs(shift) < _EVEN_PX)
    if len(even) < _EVEN_LINES:
        return width
    padded = np.pad(width[even], _EVEN_LINES // 2, mode="edge")
    median = np.median(np.lib.stride_tricks.sliding_window_view(padded, _EVEN_LINES), axis=1)
    return np.interp(line, line[even], median)


def _shift(image: np.ndarray, line: np.ndarray, centre: np.ndarray, width: np.ndarray, blur: float) -> np.ndarray:
    """Centre of the Gaussian fitted to a stripe, minus its given true centre [points], px."""
    first = np.rint(centre).astype(int)
    u = first[:, None] + np.arange(-_REACH, _REACH + 1) - centre[:, None]
    share = np.clip(1.0 - np.square(blur / width), 0.0, 1.0)[:, None]
    paper = _paper(image, line, first, (1.0 - share) * blur**2, (centre - first)[:, None] + share * u)
    profile = np.maximum(paper, 0.0) * np.exp(-0.5 * np.square(u / width[:, None]))
    profile = profile / np.maximum(profile.max(1), 1e-9)[:, None]
    height, place, spread = profile.max(1), np.zeros(len(line)), width.copy()
    for _ in range(_STEPS):
        d = (u - place[:, None]) / spread[:, None]
        bell = np.exp(-0.5 * d * d)
        slope = height[:, None] * bell / spread[:, None]
        jacobian = np.stack([bell, slope * d, slope * d * d], -1)
        normal = jacobian.transpose(0, 2, 1) @ jacobian + 1e-9 * np.eye(3)
        rest = jacobian.transpose(0, 2, 1) @ (profile - height[:, None] * bell)[..., None]
        step = np.linalg.solve(normal, rest)[..., 0]
        height = height + step[:, 0]
        place = np.clip(place + np.clip(step[:, 1], -1.0, 1.0), -_REACH / 2, _REACH / 2)
        spread = np.clip(spread + np.clip(step[:, 2], -0.5, 0.5), 0.4, _REACH / 1.5)
    return place


def _paper(image: np.ndarray, line: np.ndarray, first: np.ndarray, variance: np.ndarray, at: np.ndarray) -> np.ndarray:
    """The paper's brightness `at` pixels from `first`, its blur reduced by `variance` [px^2]."""
    index = first[:, None] + np.arange(-_PAD, _PAD + 1) + _PAD
    level = image[line[:, None], np.clip(index, 0, image.shape[1] - 1)]
    second = level[:, 2:] - 2.0 * level[:, 1:-1] + level[:, :-2]
    # To first order a blur adds half its variance times the second derivative; this undoes it.
    level = level[:, 1:-1] - 0.5 * variance * second
    x = np.clip(at + _PAD - 1, 1.0, level.shape[1] - 3.001)
    before = np.floor(x).astype(int)
    f, row = x - before, np.arange(len(line))[:, None]
    a, b, c, d = (level[row, before + k] for k in (-1, 0, 1, 2))
    # Cubic interpolation: linear interpolation would blur it again. Source: Keys (1981).
    return b + 0.5 * f * (c - a + f * (2 * a - 5 * b + 4 * c - d + f * (3 * (b - c) + d - a)))
