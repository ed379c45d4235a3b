"""The stripe of one view fitted through the print: light of the sheet times paper, seen through the lens."""

import math
from typing import NamedTuple

import numpy as np

from jaxscan.observation.printed.lattice import Lattice, Shared, collected
from jaxscan.observation.printed.room_light import RoomLight
from jaxscan.observation.printed.windows import Windows


_ROUNDS = 5
_STEP = 0.04
_LARGEST_STEP = 0.3
# Standard deviations of the priors: width and its change as logarithms, light of the ink [1].
_PRIORS = (0.5, 0.1, 0.15)
_LEAST_WIDTH_PX, _MOST_WIDTH_PX = 0.25, 15.0
# Error of the model from line to line: width as a logarithm, its change, light of the ink [1], blur as a logarithm,
# place of an edge across and along [px].
_LEFT = (0.02, 0.0, 0.01, 0.05, 0.02, 0.02)
# The room's light shows blur and place with half of these errors, which all lines of a view share.
_SHARED_PART = 0.5
# Chi-squared over the median from which a line does not follow the model; it has little weight in shared parameters.
_ODD_CHI2 = 3.0
# Distance from the centre at which only stray light is left, in widths; lines over which it is smoothed.
_FAR, _SMOOTHED = 4.0, 31
_NEAR_PX = 4.0
# Growth of a centre's variance beyond the linear model, in squares of its error over the stripe's width: measured on
# boards under faint light.
_FAINT = 3.0
# Pixels of a view for which the contrast of speckle that all boards showed counts, where they showed any.
_KNOWN_PIXELS = 200.0


class LaserLight(NamedTuple):
    """The stripe of one view."""

    centre: np.ndarray
    """Centre of the stripe, counted from the middle of the window [lines], px."""
    sigma: np.ndarray
    """Its standard deviation by noise [lines], px."""
    doubt: np.ndarray
    """Its standard deviation by errors of the model [lines], px."""
    chi2: np.ndarray
    """Chi-squared per degree of freedom [lines]."""
    contrast: np.ndarray
    """Range of the print within 4 px, seen through the lens [lines], 0 to 1."""
    shared: Shared
    speckle: float
    """Scatter of the light beyond noise, over its mean [1]."""


class _Model(NamedTuple):
    """Expected light and its derivatives, for an amplitude of 1."""

    unit: np.ndarray
    by_centre: np.ndarray
    by_shared: np.ndarray
    """[lines, samples, unknowns]."""


def fit_laser_light(
    windows: Windows,
    paper: np.ndarray,
    lattice: Lattice,
    room: RoomLight,
    start: tuple[np.ndarray, float],
    contrast: float = 0.0,
) -> LaserLight:
    r"""Centre and amplitude of the stripe on every line, and the unknowns that all lines share.

    $$F(q) = A \iint K(q - q')\, e^{-(u' - c - k v')^2 / 2 w^2}\, [\rho + (1 - \rho) P(q')]\, dq'$$

    with the print P, the collection K by lens and pixel, and the slope k of the stripe. Sheet and print are
    multiplied before the lens blurs them. Scoring, with the unknowns of single lines eliminated; blur and place of
    the print have the room's light as a prior.

    Args:
        paper: The print at the samples of the lattice [k, lines, j].
        room: Of `fit_room_light`.
        start: Centres from the middles of the windows [lines], and the width of the stripe as seen [px].
        contrast: Contrast of speckle, as other boards showed it [1]; 0 where none did.

    Source: Curless and Levoy, Better optical triangulation through spacetime analysis (1995), for the error at
    edges of reflectance.
    """
    centre, width = np.array(start[0], np.float64), start[1]
    own = max(width**2 - math.exp(2 * room.shared.blur), 0.16 * width**2)
    shared = room.shared._replace(width=0.5 * math.log(own))
    expected, prior = np.array(shared), _prior(room)
    shown = collected(paper, lattice.kernel(shared)).sum(-1)
    light = windows.light - _stray_light(windows, shown, shared, lattice, (centre, width))
    amplitude, speckle2, derivatives, say = None, contrast**2, None, np.ones(len(centre))
    for number in range(_ROUNDS):
        # Blur and place hardly move, and their derivatives cost most.
        again = number in (0, 2, _ROUNDS - 1)
        model = _model(paper, lattice, shared, centre, None if again else derivatives)
        derivatives = model.by_shared[..., 3:]
        if amplitude is None:
            weight = windows.used / (windows.variance + 1.0)
            best = np.sum(weight * model.unit * light, 1) / np.maximum(np.sum(weight * model.unit**2, 1), 1e-12)
            amplitude = np.maximum(best, 1.0)
        seen = amplitude[:, None] * model.unit
        left, positive = light - seen, np.maximum(seen, 0.0)
        variance = windows.variance + positive / windows.electrons_per_dn
        slopes = amplitude[:, None, None] * model.by_shared
        own_slopes = np.stack([model.unit, amplitude[:, None] * model.by_centre], -1)
        weight = windows.used / (variance + speckle2 * positive**2)
        normal = np.matmul(np.swapaxes(own_slopes * weight[..., None], 1, 2), own_slopes) + 1e-9 * np.eye(2)
        inverse = np.linalg.inv(normal)
        if number:
            leverage = weight * np.einsum("npi,nij,npj->np", own_slopes, inverse, own_slopes)
            leverage = np.where(windows.used & (say[:, None] == 1.0), leverage, 1.0)
            speckle2 = _speckle2((left, positive, variance), leverage, speckle2, contrast**2)
            weight = windows.used / (variance + speckle2 * positive**2)
        chi2 = np.sum(weight * left**2, 1) / np.maximum(windows.used.sum(1) - 2.0, 1.0)
        ratio = chi2 / (_ODD_CHI2 * max(float(np.median(chi2)), 1.0))
        say = room.explained / np.maximum(ratio, 1.0) ** 2
        weighted = np.swapaxes(own_slopes * weight[..., None], 1, 2)
        inverse = np.linalg.inv(np.matmul(weighted, own_slopes) + 1e-9 * np.eye(2))
        cross, pull = np.matmul(weighted, slopes), np.matmul(weighted, left[..., None])[..., 0]
        eliminated = np.matmul(inverse, cross)
        flat, weigh = slopes.reshape(-1, len(expected)), (say[:, None] * weight).reshape(-1)
        both = (flat * weigh[:, None]).T @ flat - np.einsum("n,nis,nit->st", say, cross, eliminated)
        push = flat.T @ (weigh * left.reshape(-1)) - np.einsum("n,nis,ni->s", say, eliminated, pull)
        covariance = np.linalg.inv(both + prior)
        step = covariance @ (push + prior @ (expected - np.array(shared)))
        step = np.clip(step, -_LARGEST_STEP, _LARGEST_STEP)
        own_step = np.matmul(inverse, (pull - cross @ step)[..., None])[..., 0]
        shared = _bounded(np.array(shared) + step)
        amplitude = np.maximum(amplitude + own_step[:, 0], 0.2 * amplitude)
        centre = centre + np.clip(own_step[:, 1], -1.0, 1.0)
    covariance = covariance + np.diag(np.square(_LEFT))
    doubt = np.sqrt(np.einsum("ns,st,nt->n", eliminated[:, 1], covariance, eliminated[:, 1]))
    shown = collected(paper, lattice.kernel(shared)).sum(-1)[:, np.abs(lattice.pixels) <= _NEAR_PX]
    sigma = np.sqrt(inverse[:, 1, 1])
    # The information is that at the centre found; beside edges it changes within the error of a faint line.
    sigma = sigma * np.sqrt(1.0 + _FAINT * (sigma / width) ** 2)
    return LaserLight(centre, sigma, doubt, chi2, np.ptp(shown, axis=1), shared, math.sqrt(speckle2))


def _model(
    paper: np.ndarray,
    lattice: Lattice,
    shared: Shared,
    centre: np.ndarray,
    known: np.ndarray | None,
) -> _Model:
    """The expected light; derivatives by blur and place of the print may be known."""
    s = np.linspace(-1.0, 1.0, len(centre))
    width = np.exp(shared.width + shared.taper * s)[:, None].astype(np.float32)

    def see(at: Shared) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        kernel = lattice.kernel(at)
        # All light reaches the pixels from white paper, whatever the line.
        return collected(paper, kernel), kernel.sum(1).T, lattice.offsets(at, centre) / width

    by_paper, by_all, z = see(shared)
    bell = np.exp(-0.5 * z * z)
    mixed = by_paper + np.float32(shared.ink) * (by_all - by_paper)
    curves = np.stack([bell, bell * z / width, bell * z * z], -1)
    unit, by_centre, by_width = np.moveaxis(np.matmul(mixed, curves).astype(np.float64), -1, 0)
    by_ink = np.matmul(by_all - by_paper, bell[..., None])[..., 0].astype(np.float64)
    if known is None:
        steps = []
        for name in Shared._fields[3:]:
            paper_there, all_there, z_there = see(shared._replace(**{name: getattr(shared, name) + _STEP}))
            there = paper_there + np.float32(shared.ink) * (all_there - paper_there)
            moved = np.matmul(there, np.exp(-0.5 * z_there * z_there)[..., None])[..., 0]
            steps.append((moved - unit) / _STEP)
        known = np.stack(steps, -1)
    first = np.stack([by_width, s[:, None] * by_width, by_ink], -1)
    return _Model(unit, by_centre, np.concatenate([first, known], -1))


def _prior(room: RoomLight) -> np.ndarray:
    """Information on the shared unknowns before the stripe is looked at [6, 6]."""
    prior = np.zeros((len(_LEFT), len(_LEFT)))
    prior[:3, :3] = np.diag(1.0 / np.square(_PRIORS))
    prior[3:, 3:] = np.linalg.inv(room.covariance + np.diag(np.square(_SHARED_PART * np.array(_LEFT[3:]))))
    return prior


def _bounded(values: np.ndarray) -> Shared:
    shared = Shared(*values.tolist())
    width = min(max(shared.width, math.log(_LEAST_WIDTH_PX)), math.log(_MOST_WIDTH_PX))
    blur = min(max(shared.blur, math.log(0.3)), math.log(1.6))
    return shared._replace(width=width, blur=blur, ink=min(max(shared.ink, 0.0), 0.9))


def _stray_light(
    windows: Windows, seen: np.ndarray, shared: Shared, lattice: Lattice, stripe: tuple[np.ndarray, float]
) -> np.ndarray:
    """Laser light that the room sends back onto the board, from beside the stripe [lines, samples], DN."""
    centre, width = stripe
    seen = shared.ink + (1.0 - shared.ink) * seen
    far = windows.used & (np.abs(lattice.pixels - centre[:, None]) > _FAR * width + 0.5)
    weight = far / windows.variance
    box = np.ones(min(_SMOOTHED, len(seen)))
    top, bottom = (np.convolve(np.sum(weight * seen * part, 1), box, "same") for part in (windows.light, seen))
    level = np.where(bottom > 4.0, top / np.maximum(bottom, 1e-9), 0.0)
    return level[:, None] * seen


def _speckle2(
    pixels: tuple[np.ndarray, np.ndarray, np.ndarray], leverage: np.ndarray, before: float, known: float
) -> float:
    """Scatter of the light beyond noise, over its square, from residuals that lost their leverage to the fit.

    Args:
        pixels: Residuals, expected light, and variance without speckle [lines, samples].
        leverage: Of each pixel; 1 where it does not count.
        before: The value of the round before, by which residuals are weighed.
        known: The value of other boards; 0 for none.
    """
    left, seen, variance = pixels
    scale, rest = seen**2, np.maximum(1.0 - leverage, 0.0)
    good = (rest > 0.3) & (left**2 < 25.0 * (variance + max(before, 0.01) * scale))
    weight = np.where(good, 1.0 / np.square(variance + max(before, 0.0025) * scale), 0.0)
    bottom = float(np.sum(weight * rest * scale**2))
    top = float(np.sum(weight * scale * (left**2 - rest * variance)))
    if known > 0.0:
        share = _KNOWN_PIXELS / max(before, 0.0025) ** 2
        top, bottom = top + share * known, bottom + share
    return max(top / bottom, 0.0) if bottom > 0 else 0.0
