"""Closed-form first values: camera, board poses, laser planes."""

import jax
import numpy as np

from jaxscan.calibration.solve.prepare import Prepared
from jaxscan.errors import CalibrationError
from jaxscan.geometry import (
    AbstractCamera,
    LaserSheet,
    apply_homography,
    direct_homography,
    fit_plane,
    nearest_rotation,
)
from jaxscan.leastsq import MEDIAN_TO_SIGMA


# A board is looked at along its middle ray: beyond this cosine of the angle from it, tangents mean nothing.
_MIN_COSINE = 0.1
MIN_SHARE = 0.9
"""Share of a view's corners that must be rays on one side of the camera: the rest may be wrong."""
# Boards whose normals differ by less show the camera one vanishing line: focal length and
# principal point cannot be told apart.
_MIN_TILT_DEG = 5.0
# Stripe points reaching less far across than this share of their length are one line.
_MIN_PLANE_SPREAD = 0.02


def seed_narrow(data: Prepared) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The lens and the board poses from homographies, without distortion.

    Square pixels and a centred principal point are assumed, which keeps the estimate sound under
    strong distortion; the solve frees both.

    Returns:
        theta: Angles of the corners to the optical axis [n], rad.
        radius: Distances of the corners from the middle of the image [n], px.
        poses: T_cam_board of every view [views, 4, 4] (identity where not usable).

    Raises:
        CalibrationError: If the views do not determine a camera.

    Source: Zhang, A flexible new technique for camera calibration (2000), section 3.1.
    """
    views, corners = centred_corners(data)
    homographies = [fit_homography(*seen) for seen in corners]
    found = _focal_length(homographies)
    # Even with a wrong focal length the normals show whether the boards are tilted.
    focal = found or 1.2 * max(data.size)
    poses = np.tile(np.eye(4), (len(data.usable), 1, 1))
    for view, homography in zip(views, homographies, strict=True):
        poses[view] = pose_from_homography(homography, focal)
    check_tilts(poses[views], determined=found is not None)
    radius = np.hypot(*np.concatenate([q for _, q in corners]).T)
    return np.arctan2(radius, focal), radius, poses


def centred_corners(data: Prepared) -> tuple[np.ndarray, list[tuple[np.ndarray, np.ndarray]]]:
    """Numbers of the views that fix a pose, and of each the corners on the board [n, 2] (m) and in the image.

    Pixels [n, 2] are counted from the middle of the image.

    Raises:
        CalibrationError: If they are too few for any camera.
    """
    views = np.flatnonzero(data.usable)
    if len(views) == 0:
        raise CalibrationError(
            "The board was not found in any view: "
            "check `[board]` in capture.toml (type, columns, rows) and the exposure."
        )
    if len(views) < 3:
        raise CalibrationError(
            f"The board was found in {len(views)} view(s) and a camera needs at least 3: "
            "capture 10 or more, tilted by 20 to 45 degrees in different directions."
        )
    middle = (np.array(data.size) - 1) / 2
    seen = data.corner_valid
    return views, [(data.board[seen[view], :2], data.corner_q[view, seen[view]] - middle) for view in views]


def check_tilts(poses: np.ndarray, *, determined: bool = True) -> None:
    """See that boards at T_cam_board [views, 4, 4] are tilted differently.

    Raises:
        CalibrationError: If they are not, or the focal length was not `determined`.
    """
    normals = poses[:, :3, 2]
    tilt = np.degrees(np.arccos(np.clip(normals @ normals.T, -1.0, 1.0))).max()
    if not determined or tilt < _MIN_TILT_DEG:
        raise CalibrationError(
            f"All {len(poses)} views show the board at the same tilt (within {tilt:.1f} degrees), which determines no "
            "camera: tilt the board by 20 to 45 degrees in different directions."
        )


def seed_plane(points: np.ndarray, name: str) -> LaserSheet:
    """The laser plane through stripe points lifted to their boards [n, 3].

    Raises:
        CalibrationError: If there are no points, or they all lie on one line.

    Source: the paper, equation (8), as total least squares.
    """
    if len(points) < 10:
        raise CalibrationError(
            f"No stripe of laser {name!r} was seen on the board, so its plane cannot be determined: "
            "capture each board pose with the laser on and off."
        )
    for _ in range(5):
        plane = fit_plane(points)
        distance = np.abs(points @ plane.normal - plane.distance)
        keep = distance <= 3.5 * MEDIAN_TO_SIGMA * np.median(distance) + 1e-9
        if keep.all():
            break
        points = points[keep]
    plane = fit_plane(points)
    if plane.spread[1] < _MIN_PLANE_SPREAD * plane.spread[0]:
        raise CalibrationError(
            f"All stripes of laser {name!r} lie on one line in space, so its plane cannot be determined: "
            "capture the stripe on board poses at different distances or tilts."
        )
    if plane.distance <= 0:
        raise CalibrationError(f"The plane of laser {name!r} contains the camera centre: it shows no depth.")
    return LaserSheet.from_plane(plane.normal, plane.distance)


def fit_homography(points: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Homography [3, 3] from board points [n, 2] to pixels [n, 2], robust against a few wrong corners.

    Source: Hartley and Zisserman, Multiple View Geometry, normalised direct linear transformation.
    """
    keep = np.ones(len(points), bool)
    for _ in range(3):
        homography = direct_homography(points[keep], q[keep])
        distance = np.hypot(*(apply_homography(homography, points) - q).T)
        # Lens distortion is no error here, so only corners far beyond the usual misfit are dropped.
        trimmed = distance <= 6.0 * np.median(distance) + 1e-9
        if trimmed.sum() < max(6, len(points) // 2) or np.array_equal(trimmed, keep):
            break
        keep = trimmed
    return homography


def pose_from_homography(homography: np.ndarray, focal: float) -> np.ndarray:
    """T_cam_board [4, 4] from a homography to pixels about the principal point."""
    columns = homography / np.array([[focal], [focal], [1.0]])
    columns = columns * (2.0 / (np.linalg.norm(columns[:, 0]) + np.linalg.norm(columns[:, 1])))
    columns = columns * (1.0 if columns[2, 2] >= 0 else -1.0)
    pose = np.eye(4)
    across = np.cross(columns[:, 0], columns[:, 1])
    pose[:3, :3] = nearest_rotation(np.column_stack([columns[:, 0], columns[:, 1], across]))
    pose[:3, 3] = columns[:, 2]
    return pose


def _focal_length(homographies: list[np.ndarray]) -> float | None:
    a, b = [], []
    for homography in homographies:
        x, y = homography[:, 0], homography[:, 1]
        size = max(np.linalg.norm(x[:2]) * np.linalg.norm(y[:2]), 1e-300)
        # The columns are images of perpendicular vectors of equal length.
        a += [x[:2] @ y[:2] / size, (x[:2] @ x[:2] - y[:2] @ y[:2]) / size]
        b += [-x[2] * y[2] / size, (y[2] ** 2 - x[2] ** 2) / size]
    inverse_square = np.dot(a, b) / max(np.dot(a, a), 1e-300)
    return float(1.0 / np.sqrt(inverse_square)) if inverse_square > 0 else None


def seed_poses(data: Prepared, camera: AbstractCamera) -> np.ndarray:
    """T_cam_board of every view [views, 4, 4], identity where not usable.

    Seen along the middle ray of its view, a flat board is a homography, whatever its angle to the optical axis.

    Raises:
        CalibrationError: If no view shows the board where this camera has rays.
    """
    poses = np.tile(np.eye(4), (len(data.usable), 1, 1))
    rays = np.asarray(jax.tree.map(np.asarray, camera).unproject(data.corner_q))
    found = 0
    for view in np.flatnonzero(data.usable):
        seen = data.corner_valid[view]
        pose, share = pose_from_rays(data.board[seen, :2], rays[view, seen])
        poses[view], found = pose, found + (share >= MIN_SHARE)
    if not found:
        raise CalibrationError(
            "The known camera sees the board in no view: check that it is the calibration of this camera, or calibrate "
            "the camera too."
        )
    return poses


def pose_from_rays(points: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, float]:
    """T_cam_board [4, 4] of board points [n, 2] seen along unit rays [n, 3], and the share of the rays that it is from.

    Where they are too few, the pose of any board in the direction of the rays.
    """
    towards = _facing(rays.mean(0) if len(rays) else np.array([0.0, 0.0, 1.0]))
    turned = rays @ towards.T
    usable = turned[:, 2] > _MIN_COSINE
    share = float(usable.mean()) if len(rays) else 0.0
    pose, back = np.eye(4), np.eye(4)
    pose[2, 3], back[:3, :3] = 1.0, towards.T
    if share >= MIN_SHARE:
        pose = pose_from_homography(fit_homography(points[usable], turned[usable, :2] / turned[usable, 2:]), 1.0)
    return back @ pose, share


def _facing(direction: np.ndarray) -> np.ndarray:
    """A rotation [3, 3] that turns `direction` to +z."""
    z = direction / np.linalg.norm(direction)
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])
