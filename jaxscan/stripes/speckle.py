r"""Speckle of the laser, learned from the stripes of a sweep's first frames.

Coherent light on a rough surface varies by its contrast C from pixel to pixel, in proportion to itself. A stripe's
centre and its width then scatter from line to line by more than photons explain. The scatter is that of second
differences along the line, without its outliers: shape, slope and edges of surfaces fall out of it, and a profile that
is no Gaussian does so too, because it is the same on all lines. For rows of one class

$$\frac{\mathrm{scatter}^2}{\sigma^2} = 1 + C^2 q, \qquad q = \frac{k}{\sigma^2},$$

with the variance $\sigma^2$ by photons and read noise, and k C^2 that of independent speckle on every pixel. Widths
are asked too: of a rough surface the centres scatter, the widths do not.

Source:
    R. G. Dorsch, G. Haeusler, J. M. Herrmann, Laser triangulation: fundamental uncertainty in distance measurement,
    Applied Optics 33, 1994.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float


_LAGS = (2, 3)
"""Distances of lines over which scatter is measured: grains of up to two lines are no more alike there."""
_CLASSES = 6
"""Classes of rows by their q."""
_FEWEST = 60
"""Rows of a class, and smallest number of all that tell anything."""
_SURE = 2.5
"""Standard deviations by which both the centres' and the widths' scatter must exceed that of photons: noise alone does
that once in 25 000 sweeps."""
_DOUBT = 0.05
"""Relative doubt about the variance by photons: a contrast within it cannot be distinguished from none [1]."""
_SURFACE, _ROUGH = 3.0, 8.0
"""How much more the centres may scatter than the widths allow, in variance: the rest is the surface's;
beyond the second nothing is learned about speckle. Grains of a third to three pixels reach 2."""
_CUT = 4.0
"""Standard deviations beyond which a second difference is an edge."""
_REACH = 10
"""Samples on either side of the middle that a profile is made of."""
_LARGEST = 2.0

REASONS = (
    "not asked for",
    "found",
    "too few stripes",
    "lost in the other noise",
    "the surface scatters the centres more than the widths",
)
"""Why a contrast is as it is; `learn_speckle` gives the number of one."""


class Rows(NamedTuple):
    """Stripes of some frames on the lines of the laser's plane, [frames, lines]."""

    u: Float[np.ndarray, "frames lines"]
    sigma: Float[np.ndarray, "frames lines"]
    amplitude: Float[np.ndarray, "frames lines"]
    width: Float[np.ndarray, "frames lines"]
    dark: Float[np.ndarray, "frames lines"]
    """Variance of a sample without the stripe [DN^2]."""
    valid: Bool[np.ndarray, "frames lines"]
    """Stripes that are believed."""
    usable: Bool[np.ndarray, "frames lines"]
    """Believed stripes that were fitted and are not clipped."""


class Scatters(NamedTuple):
    """Variances of a fit's results, by photons and by speckle of contrast 1."""

    width_over_centre: Float[np.ndarray, "*n"]
    """Variance of the logarithm of the width over that of the centre, by photons [1/px^2]."""
    centre: Float[np.ndarray, "*n"]
    """Variance of the centre by speckle of contrast 1 on every sample [px^2]."""
    width: Float[np.ndarray, "*n"]
    """Variance of the logarithm of the width by the same [1]."""


def scatters(rows: Rows, electrons_per_dn: float, pitch: int) -> Scatters:
    """Variances of centre and width by propagation, with the weights of a fit that knows photons alone."""
    seen = np.sqrt(rows.width**2 + 1 / 12)[..., None]
    # Both halves of a profile are alike.
    z = pitch * np.arange(_REACH + 1) / seen
    light = (rows.amplitude * rows.width)[..., None] / seen * np.exp(-0.5 * z * z)
    weight = 1.0 / (rows.dark[..., None] + light / electrons_per_dn)
    part = weight * light * light
    twice = np.where(np.arange(_REACH + 1) > 0, 2.0, 1.0)
    square, parts = z * z, part * part
    zero, two, four = part @ twice, (part * square) @ twice, (part * square * square) @ twice
    zeros, twos, fours = parts @ twice, (parts * square) @ twice, (parts * square * square) @ twice
    free = np.maximum(zero * four - two * two, 1e-12)
    seen = seen[..., 0]
    centre = seen**2 / np.maximum(two, 1e-12)
    pull = twos * (seen / np.maximum(two, 1e-12)) ** 2
    stretch = (zero * zero * fours - 2.0 * zero * two * twos + two * two * zeros) / free**2
    return Scatters(zero / free / centre, pull, np.maximum(stretch, 0.0))


def learn_speckle(rows: Rows, electrons_per_dn: float, pitch: int) -> tuple[float, int, Rows]:
    """Contrast on a pixel by which the centres' scatter is explained; 0 where photons explain it.

    Args:
        rows: Stripes of the first frames, fitted without speckle and without a prior of the width.
        electrons_per_dn: Conversion gain [e-/DN].
        pitch: Distance between samples [px].

    Returns:
        The contrast, the number of one of `REASONS`, and the stripes with the part of speckle in their sigmas.
    """
    expected = scatters(rows, electrons_per_dn, pitch)
    photons = rows.sigma**2
    of_centre = _contrast(rows.u, photons, expected.centre, rows.usable)
    logarithm = 0.5 * np.log(np.where(rows.usable, rows.width, 1.0) ** 2 + 1 / 12)
    of_width = _contrast(logarithm, photons * expected.width_over_centre, expected.width, rows.usable)
    if of_centre is None or of_width is None:
        return 0.0, 2, rows
    (centre, centre_sigma), (width, width_sigma) = of_centre, of_width
    if centre <= _SURE * centre_sigma:
        return 0.0, 3, rows
    if centre > _ROUGH * max(width, _SURE * width_sigma):
        return 0.0, 4, rows
    if width <= _SURE * width_sigma:
        return 0.0, 3, rows
    square = min(centre, _SURFACE * width, _LARGEST**2)
    return float(np.sqrt(square)), 1, rows._replace(sigma=np.sqrt(photons + square * expected.centre))


def correct_speckle(rows: Rows, photons: Float[np.ndarray, "frames lines"], contrast: float) -> float:
    """The contrast with which the stated sigmas are those of the centres' scatter.

    Args:
        rows: Stripes of the first frames, fitted with the contrast.
        photons: Their variances by photons alone [px^2]; 0 where it is not known.
    """
    usable = rows.usable & (photons > 0)
    stated = rows.sigma**2
    alone = np.minimum(photons, stated)
    far = _contrast(rows.u, alone, stated - alone, usable)
    if far is None:
        return contrast
    return contrast * float(np.sqrt(np.clip(far[0], 0.3**2, 3.0**2)))


def _contrast(
    value: Float[np.ndarray, "frames lines"],
    photons: Float[np.ndarray, "frames lines"],
    speckle: Float[np.ndarray, "frames lines"],
    usable: Bool[np.ndarray, "frames lines"],
) -> tuple[float, float] | None:
    """Squared contrast by the scatter of a value along the lines, and its sigma; None where there are too few."""
    normal, relative = [], []
    for lag in _LAGS:
        before, here, after = np.s_[:, : -2 * lag], np.s_[:, lag:-lag], np.s_[:, 2 * lag :]
        both = usable[before] & usable[here] & usable[after]
        bent = (value[before] - 2.0 * value[here] + value[after])[both]
        mean = ((photons[before] + 4.0 * photons[here] + photons[after]) / 6.0)[both]
        share = ((speckle[before] + 4.0 * speckle[here] + speckle[after]) / 6.0)[both]
        normal.append(bent / np.sqrt(6.0 * np.maximum(mean, 1e-12)))
        relative.append(share / np.maximum(mean, 1e-12))
    scattered, q = np.concatenate(normal), np.concatenate(relative)
    if len(scattered) < _FEWEST:
        return None
    order = np.argsort(q)
    classes = np.array_split(order, min(_CLASSES, len(order) // _FEWEST))
    spread = np.array([_variance(scattered[rows]) for rows in classes])
    level = np.array([q[rows].mean() for rows in classes])
    # Rows of several lags, and neighbours, tell the same noise again.
    count = np.array([len(rows) for rows in classes]) / (3.0 * len(_LAGS))
    variance = 2.0 * spread**2 / count + _DOUBT**2
    information = np.sum(level**2 / variance)
    if information <= 0:
        return None
    return float(np.sum(level * (spread - 1.0) / variance) / information), float(1.0 / np.sqrt(information))


def _variance(values: Float[np.ndarray, " n"]) -> float:
    """Variance about 0 of the values within 4 standard deviations, by iteration from their median."""
    square = values**2
    found = float(np.median(square)) / 0.455
    for _ in range(4):
        found = float(np.mean(square[square <= _CUT**2 * found])) if found > 0 else 0.0
    return found
