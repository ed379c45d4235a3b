"""What the sweeps added to the stored calibration: its covariance before and after, direction by direction."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscan.calibration import Lengths
from jaxscan.geometry import Scanner, Turntable, root_of, square_root
from jaxscan.measurement.systematic import point_gradient
from jaxscan.recalibration.grid import spread_over
from jaxscan.recalibration.observed import RoomObservations
from jaxscan.recalibration.result import Gain, LengthGain
from jaxscan.recalibration.triangulate import triangulate_points


# A ratio of variances below this is rounding.
_ROUNDING = 1e-13


class Compared(NamedTuple):
    r"""A prior and a posterior covariance in the directions in which they differ one by one.

    With $C_0 = L L^T$ and $L^{-1} C_1 L^{-T} = V \Lambda V^T$, a step $L v_i$ was one standard deviation before and is
    $\sqrt{\lambda_i}$ after. Parameters that are held have no part in any direction.
    """

    prior: Float[np.ndarray, "params params"]
    posterior: Float[np.ndarray, "params params"]
    direction: Float[np.ndarray, "params directions"]
    """Steps of one standard deviation of the prior, as columns; best known after last."""
    whiten: Float[np.ndarray, "directions params"]
    """Of a step: its part in each direction, in units of the prior's standard deviation."""
    ratio: Float[np.ndarray, " directions"]
    """Variance after over that before [1]."""

    @property
    def factor(self) -> Float[np.ndarray, " directions"]:
        """Old over new standard deviation of each direction [1]."""
        return 1.0 / np.sqrt(self.ratio)


def compare(prior: Float[np.ndarray, "params params"], posterior: Float[np.ndarray, "params params"]) -> Compared:
    """Two covariances [px, rad, m] by their generalised eigenvalues; a parameter without variance before is held."""
    prior, posterior = np.asarray(prior, np.float64), np.asarray(posterior, np.float64)
    root = square_root(prior)
    free = root.steps.any(1)
    steps, inverse = root.steps[free].T, root.inverse[:, free].T
    after = inverse @ posterior @ inverse.T
    ratio, turned = np.linalg.eigh((after + after.T) / 2.0)
    ratio, turned = ratio[::-1], turned[:, ::-1]
    return Compared(prior, posterior, steps @ turned, turned.T @ inverse, np.maximum(ratio, _ROUNDING))


def with_prior(
    loose: Compared, step: Float[np.ndarray, " params"], prior: Float[np.ndarray, "params params"]
) -> tuple[Compared, Float[np.ndarray, " params"]]:
    """A solve with a loose prior, and its step, as they would have come out with a tighter one, to first order.

    A scanner that moved beyond a tight prior would leave bent walls, which would be taken for noise. So the data speak
    by a solve that lets everything move.
    """
    information = np.maximum(1.0 / loose.ratio - 1.0, 0.0)
    gradient = (loose.whiten @ step) / loose.ratio
    root = root_of(loose.whiten @ np.asarray(prior, np.float64) @ loose.whiten.T).T
    inner = np.linalg.inv(np.eye(len(root)) + root.T @ (information[:, None] * root))
    posterior = loose.direction @ (root @ inner @ root.T) @ loose.direction.T
    return compare(prior, posterior), loose.direction @ (root @ (inner @ (root.T @ gradient)))


NAMES = ("radial scale", "height scale")
# More points say nothing new.
_POINTS = 512


def scale_slopes(
    scanner: Scanner, observations: RoomObservations, corrections: tuple[Float[np.ndarray, " records"], ...] = ()
) -> Float[np.ndarray, "2 params"]:
    """Radial and height scale of a room by a step of the scanner that measures it [1 per px, rad, m]."""
    points = observations.points.take(spread_over(np.arange(len(observations.points.q)), _POINTS))
    where = points.q, points.laser, observations.angles_of(points, corrections)
    arm, valid = triangulate_points(scanner, *where)
    slope = point_gradient(scanner.rig, *where)
    if not isinstance(scanner.turntable, Turntable):
        raise TypeError(f"found {type(scanner.turntable).__name__}, expected a turntable")
    # The axis is the z axis of the scanner's frame.
    arm, slope = arm[valid], slope[valid]
    up = arm * np.array([0.0, 0.0, 1.0])
    turns = [np.cross(unit, arm) for unit in np.eye(3)]
    shifts = [np.broadcast_to(unit, arm.shape) for unit in np.eye(3)]
    fields = np.stack([field.ravel() for field in (arm - up, up, *shifts, *turns)], axis=-1)
    return np.linalg.pinv(fields)[:2] @ slope.reshape(len(fields), -1)


# A direction whose gain is below this counts as held by the stored calibration alone.
_OBSERVED = 2.0
# A direction that lies so far within the space of the scales is not named by itself.
_SAME = 0.8
# Components of a direction that are named: at most so many, and none much smaller than the largest.
_NAMED, _SHARE = 3, 0.4


class Scales(NamedTuple):
    """Radial and height scale by a step of the scanner, and how far they are known."""

    before: Float[np.ndarray, "2"]
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
    return Scales(before, after, np.sqrt(new / np.where(old > 0, old, 1.0)), left)


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
    """What determines a scale; walls also determine parameters that bend them, on which it depends too."""
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


def length_gains(before: Lengths, after: Lengths) -> tuple[LengthGain, ...]:
    """The lengths that are in reach of both calibrations, with their standard deviations."""
    new = {(laser.name, one.name, one.depth_m): one for laser in after.lasers for one in laser.lengths}
    return tuple(
        LengthGain(laser.name, one.name, one.depth_m, one.length_m, one.sigma_mm, found.sigma_mm)
        for laser in before.lasers
        for one in laser.lengths
        if (found := new.get((laser.name, one.name, one.depth_m))) is not None
    )
