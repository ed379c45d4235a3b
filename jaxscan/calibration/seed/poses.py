"""First poses of boards before a camera that is known."""

import jax
import numpy as np

from jaxscan.calibration.seed.closed_form import fit_homography, pose_from_homography
from jaxscan.calibration.solve.prepare import Prepared
from jaxscan.errors import CalibrationError
from jaxscan.geometry import AbstractCamera


# A board is looked at along its middle ray: beyond this cosine of the angle from it, tangents mean nothing.
_MIN_COSINE = 0.1
MIN_SHARE = 0.9
"""Share of a view's corners that must be rays on one side of the camera: the rest may be wrong."""


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
