"""Stripe points lifted to the boards they lie on."""

from typing import NamedTuple

import jax
import numpy as np

from jaxscan.calibration.solve.prepare import Prepared
from jaxscan.geometry import AbstractCamera


class Lifted(NamedTuple):
    """Stripe points in space, camera frame."""

    points: np.ndarray
    """[stripes, points, 3], m; 0 on stripes without a point."""
    valid: np.ndarray
    """bool [stripes, points]: seen, and on a board before the camera."""
    camera: AbstractCamera
    pose: np.ndarray
    """T_cam_board of every stripe [stripes, 4, 4]."""
    q: np.ndarray
    """[stripes, points, 2], px."""

    def slopes(self, rows: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Derivatives of some points by the pixel, on their boards [rows, places, 3, 2], m per px.

        Args:
            rows: Some stripes [rows].
            places: Points of each [rows, places].
        """
        at, pose = (rows[:, None], places), self.pose[rows]
        steps = [_meet(self.camera, pose, self.q[at] + np.array(step))[0] for step in ((1.0, 0.0), (0.0, 1.0))]
        return np.stack([step - self.points[at] for step in steps], -1)


def lift_stripes(data: Prepared, camera: AbstractCamera, poses: np.ndarray) -> Lifted:
    """Stripe points where their rays meet the flat boards.

    Args:
        data: The stripes.
        camera: The camera.
        poses: T_cam_board of every view [views, 4, 4].

    Source: the paper, equations (5)-(7).
    """
    pose, lit = poses[data.stripe_view], np.any(data.stripe_valid, axis=1)
    points, ahead = np.zeros((*data.stripe_valid.shape, 3)), np.zeros(data.stripe_valid.shape, bool)
    points[lit], ahead[lit] = _meet(camera, pose[lit], data.stripe_q[lit])
    return Lifted(points, data.stripe_valid & ahead, camera, pose, data.stripe_q)


def _meet(camera: AbstractCamera, pose: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where rays of pixels [stripes, points, 2] meet boards [stripes, 4, 4], and whether they do."""
    ray = np.asarray(jax.tree.map(np.asarray, camera).unproject(q))
    normal = pose[:, None, :3, 2]
    level = np.einsum("si,si->s", pose[:, :3, 2], pose[:, :3, 3])[:, None]
    along = np.sum(normal * ray, axis=-1)
    range_m = level / np.where(along == 0, 1.0, along)
    return range_m[..., None] * ray, (along != 0) & (range_m > 0)
