"""Many points of one scanner at once; NumPy on the host."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.geometry import Scanner, lit_points, points, poses, transform
from jaxscan.recalibration.observed import RoomObservations, SurfacePoints, SweepStripes


def triangulate_points(
    scanner: Scanner,
    q: Float[np.ndarray, "n 2"],
    laser: Int[np.ndarray, " n"],
    phi: Float[np.ndarray, " n"],
    station: Float[np.ndarray, "n 4 4"] | None = None,
) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """Points of stripes in the frame of the room [m], and whether the ray meets the sheet in front of the camera.

    Args:
        scanner: Any; its covariance is not used.
        q: Stripe centres (u, v) [px].
        laser: The scanner's sheet of each.
        phi: The table's angle of each, with corrections [rad from home].
        station: T_room_scanner of each; None for the scanner's own frame.
    """
    rig = scanner.rig
    p_cam, incidence = lit_points(rig, q, laser)
    point = transform(poses(rig, phi), p_cam)
    return np.asarray(point if station is None else transform(station, point)), np.asarray(incidence) > 0


def place_points(
    scanner: Scanner,
    observations: RoomObservations,
    corrections: Sequence[np.ndarray] = (),
    *,
    stations: Float[np.ndarray, "stations 4 4"] | None = None,
    points: SurfacePoints | None = None,
) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """`triangulate_points` of all points on surfaces, or of some, in the room or in each scanner's own frame."""
    points = observations.points if points is None else points
    pose = None if stations is None else np.asarray(stations)[np.asarray(observations.station)[points.sweep]]
    return triangulate_points(scanner, points.q, points.laser, observations.angles_of(points, corrections), pose)


def points_of_records(scanner: Scanner, sweep: SweepStripes) -> Callable[[int], Float[np.ndarray, "points 3"] | None]:
    """Points at angle 0 of the first stripe of each record, in the order along it; None for a record without one."""

    def of(record: int) -> Float[np.ndarray, "points 3"] | None:
        profiles = np.flatnonzero(sweep.record == record)
        if not len(profiles):
            return None
        line = np.flatnonzero(sweep.valid[profiles[0]])
        profile = np.full(len(line), profiles[0])
        return np.asarray(points(scanner.rig, sweep.pixels(profile, line), sweep.laser[profile], 0.0))

    return of
