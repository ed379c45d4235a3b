"""Blur of the lens and place of the print in one view, from the laser-off image beside the stripe."""

import math
from typing import NamedTuple

import numpy as np

from jaxscan.observation.printed.lattice import Lattice, Shared
from jaxscan.observation.printed.windows import Windows


# Blur that is expected before the image is looked at [px], its standard deviation as a logarithm, and its range.
_BLUR_PX, _BLUR_LOG = 0.75, 0.5
_LOG_BLURS = math.log(0.3), math.log(1.6)
# Distance of print and prediction that is expected [px].
_PLACE_PX = 0.2
# Light of the laser that ink sends back, over that of paper: expected [1].
_INK = 0.12
_STEP = 0.05
# Light of the room from which the print's colours can be told [DN].
_LEAST_LIGHT_DN = 1.0
# Significance at which the print's brightness is accepted, in its standard deviations; information that keeps the fit
# of columns that are alike finite [1 / DN^2].
_SIGNIFICANT, _RIDGE = 4.0, 1e-6
_LARGEST_STEP = 0.3
# Residuals beyond so many standard deviations get little weight.
_ODD, _ODD_WEIGHT = 5.0, 0.04
# Light of a line that neither the print nor noise explains, over that of the print: at most, round by round. A hand, a
# frame round the board or a reflection is more. In the first rounds the print stays where it is predicted, so that such
# lines do not draw it aside.
_UNEXPLAINED = (0.3, 0.25, 0.25, 0.2, 0.15, 0.12, 0.12)
_HELD_ROUNDS = 2
# The same limits for a print that lies far from its prediction because of a poor pose.
_UNEXPLAINED_FAR = (0.5, 0.5, 0.5, 0.3, 0.2, 0.12, 0.12)


class RoomLight(NamedTuple):
    """The print as the room's light shows it."""

    shared: Shared
    covariance: np.ndarray
    """Covariance of blur and place of the print [3, 3]."""
    explained: np.ndarray
    """bool [lines]: whether the print explains the light round the stripe on that line."""
    exchanged: bool
    """Whether black and white are exchanged: a turned chessboard looks the same, except for its colours."""


def fit_room_light(windows: Windows, paper: np.ndarray, lattice: Lattice, *, far: bool = False) -> RoomLight:
    r"""Fit black level, paper, blur and place of the print to the laser-off image.

    $O = a + a' s + (p + p' s + p'' s^2 + p''' u)\,(K * P)$ with the place s along the stripe, the print P and the
    collection K by lens and pixels. Black level and light of the ink are not told apart, and need not be.

    Args:
        paper: The print at the samples of the lattice [k, lines, j].
        far: The print may lie some tenths of a pixel from its prediction.
    """
    lines, samples = windows.dark.shape
    s = np.broadcast_to(np.linspace(-1.0, 1.0, lines)[:, None], (lines, samples))
    u = np.broadcast_to(lattice.pixels / lattice.pixels[-1], (lines, samples))
    flat = paper.transpose(1, 2, 0).reshape(lines, -1)
    variance = np.maximum(windows.dark_variance, 0.05)
    weight = np.where(windows.used, 1.0 / variance, 0.0)
    start = np.array([math.log(_BLUR_PX), 0.0, 0.0])
    prior = np.diag(1.0 / np.square([_BLUR_LOG, _PLACE_PX, _PLACE_PX]))
    place = start

    def see(blur: float, across: float, along: float) -> np.ndarray:
        kernel = lattice.kernel(Shared(0.0, 0.0, _INK, blur, across, along))
        return np.asarray(flat @ kernel.transpose(1, 0, 2).reshape(-1, samples), np.float64)

    rounds = _UNEXPLAINED_FAR if far else _UNEXPLAINED
    free = 0 if far else _HELD_ROUNDS
    for number, limit in enumerate(rounds):
        root = np.sqrt(weight)[..., None]
        # The print moves by a few hundredths of a pixel, over which its derivatives hardly change.
        if number == 0 or number > free:
            seen = see(*place)
        if number in (0, free + 1, len(rounds) - 1):
            by_place = np.stack([(see(*(place + _STEP * unit)) - seen) / _STEP for unit in np.eye(3)], -1)
        level = np.stack([np.ones_like(s), s, seen, s * seen, s * s * seen, u * seen], -1)
        basis, found, doubt = _fit_level(level, root, windows.dark)
        brightness = found[2] + found[3] * s + found[4] * s * s + found[5] * u
        typical = float(np.median(brightness))
        shown = abs(typical) > _SIGNIFICANT * doubt
        if not shown:
            # One colour, or no light: the image says nothing of the print.
            level, brightness = level[..., :2], np.zeros_like(brightness)
            basis, found, doubt = _fit_level(level, root, windows.dark)
        left = ((windows.dark - level @ found)[..., None] * root).reshape(-1)
        slopes = (brightness[..., None] * by_place * root).reshape(-1, 3)
        # The part that level and brightness cannot explain.
        slopes = slopes - basis @ (basis.T @ slopes)
        scale = max(1.0, float(left @ left) / max(int(np.count_nonzero(weight)), 1))
        information = slopes.T @ slopes / scale + prior
        step = np.linalg.solve(information, slopes.T @ left / scale + prior @ (start - place))
        place = place + (number >= free) * np.clip(step, -_LARGEST_STEP, _LARGEST_STEP)
        place[0] = np.clip(place[0], *_LOG_BLURS)
        odd = left.reshape(lines, samples) ** 2 > _ODD**2 * scale
        rest = np.where(windows.used, np.square(windows.dark - level @ found) - 2.0 * variance, 0.0).sum(1)
        print_light = float(np.median(np.abs(brightness)))
        explained = rest <= (limit * print_light) ** 2 * np.maximum(windows.used.sum(1), 1)
        weight = np.where(odd, _ODD_WEIGHT, 1.0) / variance * (windows.used & explained[:, None])
    shared = Shared(0.0, 0.0, _INK, *place.tolist())
    return RoomLight(shared, np.linalg.inv(information), explained, shown and typical < -_LEAST_LIGHT_DN)


def _fit_level(level: np.ndarray, root: np.ndarray, dark: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Least squares of the laser-off image on some columns [lines, samples, columns].

    Returns:
        An orthonormal basis of the columns, their factors, and the standard deviation of the print's brightness in
        the middle of the stripe, whose columns follow the first two [DN].
    """
    basis, triangle = np.linalg.qr((level * root).reshape(-1, level.shape[-1]))
    # Columns that are alike, as on a print of one colour, get a large doubt.
    covariance = np.linalg.inv(triangle.T @ triangle + _RIDGE * np.eye(len(triangle)))
    values = (dark[..., None] * root).reshape(-1)
    found = covariance @ (triangle.T @ (basis.T @ values))
    scale = max(
        1.0, float(np.sum((values - (level * root).reshape(len(values), -1) @ found) ** 2)) / max(len(values), 1)
    )
    return basis, found, math.sqrt(scale * covariance[2, 2]) if len(found) > 2 else 0.0
