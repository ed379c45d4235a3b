"""Stripe points as the turning sheet has them: where they would be at angle 0."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxscan.geometry import Scanner, StripeAxis, points, slopes, stripe_pixel
from jaxscan.geometry.motions.turntable import ANGLE_PARAMETERS
from jaxscan.recalibration.adjust import point_gradient
from jaxscan.recalibration.observed import SweepStripes


SPREAD = (
    {"fx": 20.0, "fy": 20.0, "cx": 20.0, "cy": 20.0, "k1": 0.05, "k2": 0.1, "k3": 0.3, "p1": 2e-3, "p2": 2e-3}
    | {"n1": 3e-3, "n2": 3e-3, "d": 2e-3, "b2": 3e-3, "b3": 3e-3}
    | {"axis.d1": 5e-3, "axis.d2": 5e-3, "axis.p1": 3e-3, "axis.p2": 3e-3}
)
"""How far a coordinate of a poor calibration may be from the truth [px, rad, m]; 0.1 for others."""


class Stripes(NamedTuple):
    """Centres of stripes, in no order."""

    centre: Float[np.ndarray, " points"]
    """Across the line [px]."""
    line: Int[np.ndarray, " points"]
    laser: Int[np.ndarray, " points"]
    """The scanner's sheet."""
    axis: StripeAxis

    def seen(self) -> tuple[Float[np.ndarray, "points 2"], Int[np.ndarray, " points"]]:
        """Their pixels [px], and the sheet of each."""
        q = stripe_pixel(self.centre.astype(np.float64), self.line.astype(np.float64), self.axis)
        return np.asarray(q), self.laser

    def take(self, index: np.ndarray, shift: Float[np.ndarray, " taken"]) -> "Stripes":
        """The stripes at `index`, with centres that are `shift` px further."""
        return Stripes(self.centre[index] + shift, self.line[index], self.laser[index], self.axis)


def sheet_points(
    scanner: Scanner, stripes: Stripes
) -> tuple[Float[np.ndarray, "points 3"], Float[np.ndarray, "points 3"]]:
    """Points of stripes at angle 0 in the scanner frame, and how they move with the centre of the stripe.

    A table turns them about z: the point at angle theta is `Rz(theta) x`.

    Returns:
        x: Points [m].
        slope: Their derivative by the centre [m/px].
    """
    rig, (q, laser) = scanner.rig, stripes.seen()
    across = 0 if stripes.axis == "rows" else 1
    return np.asarray(points(rig, q, laser, 0.0)), np.asarray(slopes(rig, q, laser, 0.0))[..., across]


def points_of_records(scanner: Scanner, sweep: SweepStripes) -> Callable[[int], Float[np.ndarray, "points 3"] | None]:
    """`sheet_points` of the first stripe of each record, in the order along it; None for a record without a stripe."""

    def of(record: int) -> Float[np.ndarray, "points 3"] | None:
        profiles = np.flatnonzero(sweep.record == record)
        if not len(profiles):
            return None
        first = int(profiles[0])
        line = np.flatnonzero(sweep.valid[first])
        laser = np.full(len(line), sweep.laser[first])
        return sheet_points(scanner, Stripes(sweep.centre[first, line], line, laser, sweep.stripe_axis))[0]

    return of


def parameter_slopes(scanner: Scanner, stripes: Stripes) -> Float[np.ndarray, "points 3 params"]:
    """Derivatives of `sheet_points` by the coordinates of camera, sheets and axis [m per px, rad, m]."""
    q, laser = stripes.seen()
    return point_gradient(scanner, q, laser, np.zeros(len(q)))[..., : -len(ANGLE_PARAMETERS)]


def move(scanner: Scanner, step: Float[np.ndarray, " params"]) -> Scanner:
    """The scanner moved by `step` in the coordinates of camera, sheets and axis [px, rad, m]."""
    return scanner.retract(np.append(step, np.zeros(len(ANGLE_PARAMETERS))))


def parameter_spread(scanner: Scanner) -> Float[np.ndarray, " params"]:
    """How far the coordinates of `parameter_slopes` may be from the truth, generously [px, rad, m]."""
    names = scanner.parameter_names()[: -len(ANGLE_PARAMETERS)]
    return np.array([SPREAD.get(name, SPREAD.get(name.split(".")[-1], 0.1)) for name in names])
