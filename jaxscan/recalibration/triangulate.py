"""Many points of one scanner at once, and how they follow from its parameters; NumPy on the host."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.geometry import Scanner, lit_points, lit_slopes, poses, transform
from jaxscan.recalibration.observed import RoomObservations, SurfacePoints


# Of differences, in units of the unknowns.
_STEP = 1e-3


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


def point_gradient(
    scanner: Scanner, q: Float[np.ndarray, "n 2"], laser: Int[np.ndarray, " n"], phi: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 3 params"]:
    """Derivatives of points in the scanner's frame by its minimal coordinates [m / px, m / rad, 1]; on the host.

    Central differences of what has a closed form: where a point is seen, its offset from its sheet, the pose. A point
    stays on the ray of its pixel and on its sheet, so a camera that sees it elsewhere moves it as that pixel does.
    """
    rig, layout, phi = scanner.rig, scanner.layout(), np.asarray(phi, np.float64)
    p_cam, incidence = lit_points(rig, q, laser)
    hits = incidence > 0
    by_q, normal = lit_slopes(rig, p_cam, incidence, laser), rig.laser(laser).slope(p_cam)
    along = np.where(hits, np.sum(normal * p_cam, axis=-1), 1.0)
    position, place = np.unique(phi, return_inverse=True)
    found = np.zeros((len(p_cam), 3, len(layout.names)))
    for k, block in enumerate(layout.blocks):
        step = np.zeros(len(layout.names))
        step[k] = _STEP * block.scale
        forth, back = rig.retract(step), rig.retract(-step)
        change = lambda of, forth=forth, back=back, size=step[k]: (of(forth) - of(back)) / (2.0 * size)
        if layout.turntable.start <= k < layout.turntable.stop:
            found[..., k] = transform(change(lambda rig: poses(rig, position))[place], p_cam)
        elif k >= layout.lasers.start:
            mine = np.flatnonzero(hits & (laser == (k - layout.lasers.start) // 5))
            offset = change(lambda rig, mine=mine: rig.laser(laser[mine]).offset(p_cam[mine]))
            found[mine, :, k] = p_cam[mine] * (-offset / along[mine])[:, None]
        else:
            seen = np.where(hits[:, None], change(lambda rig: rig.camera.project(p_cam)), 0.0)
            found[..., k] = -np.einsum("nij,nj->ni", by_q, seen)
    moving, rotation = layout.turntable.start, poses(rig, position)[place][:, :3, :3]
    found[..., :moving] = rotation @ found[..., :moving]
    return found
