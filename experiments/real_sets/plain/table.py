"""The plain method for a turntable with markers on it: the axis, the table's plane, and the angle of every step.

Four ArUco markers lie flat on the table of the desk scanner. Their corners at many steps give axis, angles and corner
positions at once, by least squares; the printed side of a marker gives the scale.
"""

from typing import NamedTuple

import cv2
import numpy as np

from experiments.real_sets.plain.boards import Lens, levenberg, pose_of, rms
from experiments.real_sets.plain.stripes import Plane, least_squares


RADIUS = 0.09
"""Nominal distance of the markers' centres from the axis [m]."""
CENTRES = {5: (RADIUS, 0.0), 42: (-RADIUS, 0.0), 27: (0.0, RADIUS), 18: (0.0, -RADIUS)}
SIDE = 0.03
"""Side of a marker [m]."""


class Table(NamedTuple):
    """A turntable in the coordinates of the camera, which stands still."""

    direction: np.ndarray
    """Of the axis, away from the table's plane towards the camera's side."""
    point: np.ndarray
    """Of the axis, in the table's plane [m]."""
    plane: Plane
    """The table's surface."""
    step_deg: float
    """Right-handed about `direction`."""
    step_scatter_deg: float
    rms_px: float
    sides_scatter_mm: float
    """Scatter of the 16 sides of the markers."""


def markers(grey: np.ndarray) -> np.ndarray | None:
    """The 16 corners [16, 2] of the four markers in the order of `CENTRES`, or None."""
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50), settings)
    found, names, _ = detector.detectMarkers(grey)
    seen = {} if names is None else {int(name): q.reshape(4, 2) for name, q in zip(names.ravel(), found, strict=True)}
    return np.concatenate([seen[name] for name in CENTRES]) if set(CENTRES) <= set(seen) else None


def fit_table(steps: np.ndarray, corners: np.ndarray, lens: Lens) -> Table:
    """The table from corners of markers at many steps.

    Args:
        steps: Number of the step of every picture [pictures].
        corners: Corners of the markers [pictures, 16, 2]; px.
        lens: The camera.
    """
    square = 0.5 * SIDE * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
    nominal = np.concatenate([square + np.array([*centre, 0.0]) for centre in CENTRES.values()])
    poses = np.array([pose_of(lens, nominal, q) for q in corners])
    turns = np.array([cv2.Rodrigues(pose[:3])[0] for pose in poses])
    axis = turns[:, :, 2].mean(0)
    axis /= np.linalg.norm(axis)
    first = turns[0, :, 0] - axis * (axis @ turns[0, :, 0])
    angles = np.unwrap(np.arctan2(turns[:, :, 0] @ np.cross(axis, first), turns[:, :, 0] @ first))
    start = nominal @ turns[0].T + poses[0, 3:]
    one, two = np.linalg.svd(axis[None])[2][1:]

    def parts(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        direction = axis + x[0] * one + x[1] * two
        centre = poses[:, 3:].mean(0) + x[2] * one + x[3] * two
        return direction / np.linalg.norm(direction), centre, x[4:52].reshape(16, 3), np.concatenate([[0.0], x[52:]])

    def error(x: np.ndarray) -> np.ndarray:
        direction, centre, points, turned = parts(x)
        arms = points - centre
        along = np.outer(arms @ direction, direction)
        across, side = arms - along, np.cross(direction, arms)
        cosine, sine = np.cos(turned)[:, None, None], np.sin(turned)[:, None, None]
        moved = centre + along + cosine * across + sine * side
        seen = lens.project(moved.reshape(-1, 3), np.zeros(6)).reshape(corners.shape)
        # All lengths may grow together: the mean side is held.
        return np.append((seen - corners).ravel(), 1e6 * (_sides(points).mean() - SIDE))

    x = levenberg(error, np.concatenate([np.zeros(4), start.ravel(), angles[1:] - angles[0]]))
    direction, centre, points, turned = parts(x)
    plane = least_squares(points)
    point = centre + direction * ((plane.distance - centre @ plane.normal) / (direction @ plane.normal))
    line = np.polyfit(steps, np.degrees(turned), 1)
    scatter = float(np.std(np.degrees(turned) - np.polyval(line, steps)))
    fit = rms(np.linalg.norm(error(x)[:-1].reshape(-1, 2), axis=1))
    return Table(direction, point, plane, float(line[0]), scatter, fit, 1e3 * float(_sides(points).std()))


def _sides(points: np.ndarray) -> np.ndarray:
    square = points.reshape(4, 4, 3)
    return np.linalg.norm(square - np.roll(square, 1, axis=1), axis=2)
