r"""The two stretches of a room that planes do not show: radial scale and height scale.

$\mathrm{diag}(a, a, b)$ about the axis commutes with the turning and carries planes to planes. The points of a sweep,
moved by a step of the scanner, are fitted with a stretch and a rigid motion, so each scale is linear in the step.
"""

import numpy as np
from jaxtyping import Float

from jaxscan.geometry import Scanner, Turntable
from jaxscan.recalibration.adjust import point_gradient, triangulate_points
from jaxscan.recalibration.judge.hold_out import angles_of
from jaxscan.recalibration.observed import RoomObservations


NAMES = ("radial scale", "height scale")
# More points say nothing new.
_POINTS = 512


def scale_slopes(
    scanner: Scanner, observations: RoomObservations, corrections: tuple[Float[np.ndarray, " records"], ...] = ()
) -> Float[np.ndarray, "2 params"]:
    """Radial and height scale of a room by a step of the scanner that measures it [1 per px, rad, m].

    Args:
        scanner: With a turntable; where the derivatives are taken.
        observations: Whose points stand for the room.
        corrections: Of the angles of each sweep [rad]; without any, none.
    """
    points = observations.points
    some = np.unique(np.linspace(0, len(points.q) - 1, _POINTS).round().astype(int))
    angle = angles_of(observations, corrections, points.take(some))
    where = points.q[some], points.laser[some], angle
    arm, valid = triangulate_points(scanner, *where)
    slope = point_gradient(scanner, *where)
    if not isinstance(scanner.turntable, Turntable):
        raise TypeError(f"found {type(scanner.turntable).__name__}, expected a turntable")
    # The axis is the z axis of the scanner's frame.
    arm, slope = arm[valid], slope[valid]
    up = arm * np.array([0.0, 0.0, 1.0])
    turns = [np.cross(unit, arm) for unit in np.eye(3)]
    shifts = [np.broadcast_to(unit, arm.shape) for unit in np.eye(3)]
    fields = np.stack([field.ravel() for field in (arm - up, up, *shifts, *turns)], axis=-1)
    return np.linalg.pinv(fields)[:2] @ slope.reshape(len(fields), -1)
