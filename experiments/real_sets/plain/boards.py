"""The plain method for boards: OpenCV's corners, `cv2.calibrateCamera`, and `cv2.calibrateCameraRO` for the shape.

Nothing of jaxscan is used here. Coordinates are metres; pixel (0, 0) is the centre of the top-left pixel.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import cv2
import numpy as np


STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)
FISHEYE_FLAGS = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_RECOMPUTE_EXTRINSIC | cv2.CALIB_FIX_SKEW


class Lens(NamedTuple):
    """A camera of OpenCV."""

    matrix: np.ndarray
    distortion: np.ndarray
    is_fisheye: bool = False

    def straight(self, q: np.ndarray) -> np.ndarray:
        """Directions [n, 2] (x/z, y/z) of pixels [n, 2]."""
        points = np.ascontiguousarray(q, np.float64).reshape(-1, 1, 2)
        undo = cv2.fisheye.undistortPoints if self.is_fisheye else cv2.undistortPoints
        return undo(points, self.matrix, self.distortion).reshape(-1, 2)

    def project(self, points: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """Pixels [n, 2] of points [n, 3] of the board in a pose (rotation vector, translation) [6]."""
        shaped = np.ascontiguousarray(points, np.float64).reshape(-1, 1, 3)
        through = cv2.fisheye.projectPoints if self.is_fisheye else cv2.projectPoints
        return through(shaped, pose[:3], pose[3:], self.matrix, self.distortion)[0].reshape(-1, 2)


def grid(board: dict[str, Any]) -> np.ndarray:
    """Corners, or centres of circles, [n, 3]; m."""
    pitch = board["spacing_mm" if board["type"] == "circles" else "square_mm"] / 1000
    points = np.zeros((board["columns"] * board["rows"], 3))
    points[:, :2] = pitch * np.mgrid[: board["columns"], : board["rows"]].T.reshape(-1, 2)
    return points


def find(grey: np.ndarray, board: dict[str, Any]) -> np.ndarray | None:
    """Corners, or centres of circles, [n, 2] of a whole board, or None."""
    size = (board["columns"], board["rows"])
    if board["type"] == "circles":
        found, q = cv2.findCirclesGrid(grey, size)
        return q.reshape(-1, 2).astype(np.float64) if found else None
    found, q = cv2.findChessboardCorners(grey, size)
    if not found:
        return None
    lattice = q.reshape(board["rows"], board["columns"], 2)
    smallest = min(np.linalg.norm(np.diff(lattice, axis=axis), axis=-1).min() for axis in (0, 1))
    half = int(np.clip(smallest / 3, 2, 11))
    return cv2.cornerSubPix(grey, q, (half, half), (-1, -1), STOP).reshape(-1, 2).astype(np.float64)


def calibrate(views: list[np.ndarray], points: np.ndarray, size: tuple[int, int], kind: str) -> tuple[Lens, np.ndarray]:
    """A camera, and the board's shape.

    Args:
        views: Corners [n, 2] of each view; px.
        points: Corners of the flat board [n, 3]; m.
        size: Width and height; px.
        kind: "flat", "free" (every corner of the board is free), or "fisheye".

    Returns:
        The lens, and the corners of the board as used or found [n, 3]; m.
    """
    seen = [q.reshape(-1, 1, 2).astype(np.float32) for q in views]
    flat = [points.reshape(-1, 1, 3).astype(np.float32)] * len(views)
    if kind == "fisheye":
        f = max(size) / np.pi
        guess = np.array([[f, 0.0, size[0] / 2], [0.0, f, size[1] / 2], [0.0, 0.0, 1.0]])
        shaped, corners = [points[None].astype(np.float64)] * len(views), [q[None].astype(np.float64) for q in views]
        done = cv2.fisheye.calibrate(shaped, corners, size, guess, np.zeros((4, 1)), flags=FISHEYE_FLAGS)
        return Lens(done[1], done[2], True), points
    if kind == "flat":
        _, matrix, distortion, *_ = cv2.calibrateCamera(flat, seen, size, None, None)
        return Lens(matrix, distortion), points
    # The corner that is held with the first and the last: the end of the first row.
    fixed = int(np.flatnonzero(np.diff(points[:, 1]) > 0)[0])
    _, matrix, distortion, _, _, shape, *_ = cv2.calibrateCameraRO(flat, seen, size, fixed, None, None)
    return Lens(matrix, distortion), shape.reshape(-1, 3).astype(np.float64)


def levenberg(error: Callable[[np.ndarray], np.ndarray], x: np.ndarray) -> np.ndarray:
    """The parameters with the least sum of squared errors, by Levenberg and Marquardt with differences as slopes."""
    damping, now = 1e-4, error(x)
    for _ in range(50):
        slope = np.stack([(error(x + h) - now) / 1e-7 for h in 1e-7 * np.eye(len(x))], axis=1)
        normal = slope.T @ slope
        while damping < 1e8:
            move = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), -slope.T @ now)
            trial = error(x + move)
            if (trial**2).sum() <= (now**2).sum():
                break
            damping *= 10
        else:
            return x
        done = (now**2).sum() - (trial**2).sum() < 1e-10 * (now**2).sum()
        x, now, damping = x + move, trial, damping / 10
        if done:
            return x
    return x


def pose_of(lens: Lens, points: np.ndarray, q: np.ndarray) -> np.ndarray:
    """The pose (rotation vector, translation) [6] that shows the board's points at these pixels, by least squares."""
    _, turn, shift = cv2.solvePnP(points, lens.straight(q), np.eye(3), None)
    return levenberg(lambda x: (lens.project(points, x) - q).ravel(), np.concatenate([turn.ravel(), shift.ravel()]))


def residuals(lens: Lens, points: np.ndarray, views: list[np.ndarray]) -> np.ndarray:
    """Distances of corners from their predictions [views, n] where every view is given its best pose; px."""
    return np.array([np.linalg.norm(lens.project(points, pose_of(lens, points, q)) - q, axis=1) for q in views])


def rms(distances: np.ndarray) -> float:
    """Root mean square of distances; px."""
    return float(np.sqrt(np.mean(np.square(distances)))) if np.size(distances) else float("nan")


def held_out(views: list[np.ndarray], points: np.ndarray, size: tuple[int, int], kind: str) -> float:
    """RMS of the corners of views that had no part in the solve but for their pose; both halves, px."""
    parts = []
    for half in (0, 1):
        lens, shape = calibrate(views[half::2], points, size, kind)
        parts.append(residuals(lens, shape, views[1 - half :: 2]).ravel())
    return rms(np.concatenate(parts))
