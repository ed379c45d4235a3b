"""How much better each direction is known than before, and which ones the captures say nothing of."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscan.recalibration.judge.compared import Compared
from jaxscan.recalibration.judge.scale import NAMES
from jaxscan.recalibration.result import Gain


# A direction that is known less than this much better is the stored calibration's.
_OBSERVED = 2.0
# A direction that lies so far within the scales is told with them.
_SAME = 0.8
# Components that are named: at most so many, and none that is much smaller than the largest.
_NAMED, _SHARE = 3, 0.4


class Scales(NamedTuple):
    """Radial and height scale by a step of the scanner, and how far they are known."""

    slope: Float[np.ndarray, "2 params"]
    before: Float[np.ndarray, "2"]
    """Standard deviation by the prior [1]."""
    after: Float[np.ndarray, "2"]
    factor: Float[np.ndarray, "2"]
    """Old over new standard deviation along the steps of the scanner that are left for each scale [1]; 1 where the
    captures say nothing of it, even if `before` is larger because of other parameters."""
    left: Float[np.ndarray, "params 2"]
    """Those steps, one standard deviation after."""


def scales_of(compared: Compared, slope: Float[np.ndarray, "2 params"]) -> Scales:
    """How far the two scales are known before and after."""
    before, after = (np.sqrt(np.einsum("si,ij,sj->s", slope, c, slope)) for c in (compared.prior, compared.posterior))
    left = compared.posterior @ slope.T / np.where(after > 0, after, 1.0)
    along = compared.whiten @ left
    old = np.sum(along**2, axis=0)
    new = np.sum(along**2 / compared.ratio[:, None], axis=0)
    return Scales(slope, before, after, np.sqrt(new / np.where(old > 0, old, 1.0)), left)


def gains_of(compared: Compared, scales: Scales, names: tuple[str, ...]) -> tuple[Gain, ...]:
    """Radial and height scale in ppm, then all directions, best known last."""
    found = [
        Gain(name, 1e6 * float(old), 1e6 * float(new), "ppm")
        for name, old, new in zip(NAMES, scales.before, scales.after, strict=True)
    ]
    order = np.argsort(compared.factor, kind="stable")
    directions = [Gain(_named(compared, i, names), 1.0, float(1.0 / compared.factor[i])) for i in order]
    return (*found, *directions)


def unobserved(compared: Compared, scales: Scales, names: tuple[str, ...]) -> tuple[str, ...]:
    """Sentences on the directions that the stored calibration alone holds: the scales, then all others."""
    seen = scales.factor >= _OBSERVED
    told = [
        f"{name}: {_ALIKE[name]}; {_holding(old, new)}"
        for name, old, new, good in zip(NAMES, scales.before, scales.after, seen, strict=True)
        if not good
    ]
    left, _ = np.linalg.qr(compared.whiten @ scales.left[:, ~seen])
    order = np.argsort(compared.factor, kind="stable")
    others = [i for i in order if compared.factor[i] < _OBSERVED and np.sum(left[i] ** 2) < _SAME]
    if others:
        some, more = others[:_TOLD], " and others" if len(others) > _TOLD else ""
        named = "; ".join(_named(compared, i, names) for i in some)
        told.append(
            f"{len(others)} directions are known less than twice as well as before ({named}{more}): the stored "
            "calibration holds them"
        )
    return tuple(told)


def _holding(before: float, after: float) -> str:
    """Who holds a scale; walls also tell of parameters that bend them, on which it hangs besides."""
    if before >= _OBSERVED * after:
        return f"the {1e6 * after:.0f} ppm that are left of its sigma are the stored calibration's"
    return f"the stored calibration alone holds it, to {1e6 * after:.0f} ppm"


_TOLD = 3
"""Directions that one sentence names."""
_ALIKE = {
    "radial scale": "planes look the same in a room that is wider in all directions by one share",
    "height scale": "planes look the same in a room that is higher by one share",
}


def _named(compared: Compared, index: int | np.integer, names: tuple[str, ...]) -> str:
    """The largest components of a direction, in units of the prior's standard deviations."""
    sigma = np.sqrt(np.maximum(np.diag(compared.prior), 0.0))
    part = np.abs(compared.direction[:, index]) / np.where(sigma > 0, sigma, np.inf)
    order = [i for i in np.argsort(-part, kind="stable")[:_NAMED] if part[i] >= _SHARE * part.max()]
    return ", ".join(names[i] for i in order)
