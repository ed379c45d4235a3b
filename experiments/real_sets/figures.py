"""Figures of a calibration and of a cloud, the same for every method."""

from typing import Any, NamedTuple

import cv2
import numpy as np

from experiments.real_sets.plain.boards import Lens, pose_of, residuals, rms
from experiments.real_sets.plain.stripes import Plane, angle_deg, least_squares, spread


RIM = 0.115
"""Radius of the table that counts [m]."""
NEAR_TABLE = 0.015
"""The table's surface is looked for so near to its markers [m]: the camera was moved between calibration and sweep."""
ON_TABLE = 0.006
"""A point so near to the surface is on the table [m]."""
ABOVE = 0.2
"""Height of the part of the scene that counts [m]."""


class BoardLine(NamedTuple):
    """The line on one board: pixels [n, 2], row of the view, number of the laser."""

    q: np.ndarray
    view: int
    laser: int


class Solved(NamedTuple):
    """The result of one method for a capture of boards."""

    lens: Lens
    shape: np.ndarray
    """Corners of the board as the method takes them [n, 3]; m."""
    corners: list[np.ndarray]
    """Of each view [n, 2]; px, not finite where not found."""
    lines: list[BoardLine]
    sheets: list[Plane]


def board_figures(solved: Solved, halves: list[Solved] | None) -> dict[str, Any]:
    """Corners and lines against the calibration, and against the calibration of the other half of the views.

    Args:
        solved: From all views.
        halves: From the even and from the odd views, or None. Only their lens, shape and sheets are used.
    """
    own = [_residual(solved.lens, solved.shape, q) for q in solved.corners]
    matrix = solved.lens.matrix
    found: dict[str, Any] = {
        "views": len(solved.corners),
        "f_px": [float(matrix[0, 0]), float(matrix[1, 1])],
        "corner_rms_px": rms(np.concatenate(own)),
        "shape_mm": _off_plane(solved.shape),
    }
    if halves is not None:
        other = [_residual(halves[1 - k % 2].lens, halves[1 - k % 2].shape, q) for k, q in enumerate(solved.corners)]
        found["held_out_px"] = rms(np.concatenate(other))
    found["sheets"] = [_sheet(solved, halves, laser) for laser in range(len(solved.sheets))]
    return found


def _residual(lens: Lens, shape: np.ndarray, q: np.ndarray) -> np.ndarray:
    seen = np.isfinite(q).all(1)
    return residuals(lens, shape[seen], [q[seen]])[0]


def _off_plane(shape: np.ndarray) -> float:
    """RMS of the board's corners from their best plane; mm."""
    return 1e3 * float(np.sqrt(np.mean(least_squares(shape).off(shape) ** 2)))


def _sheet(solved: Solved, halves: list[Solved] | None, laser: int) -> dict[str, Any]:
    sheet, lines = solved.sheets[laser], [line for line in solved.lines if line.laser == laser and len(line.q)]
    off, beyond = [], []
    for line in lines:
        off.append(sheet.off(_lift(solved.lens, solved.shape, solved.corners[line.view], line)))
        other = None if halves is None else halves[1 - line.view % 2]
        if other is not None and laser < len(other.sheets):
            points = _lift(other.lens, other.shape, solved.corners[line.view], line)
            beyond.append(other.sheets[laser].off(points))
    found: dict[str, Any] = {
        "normal": [float(x) for x in sheet.normal],
        "distance_mm": 1e3 * float(sheet.distance),
        "lines": len(lines),
        "points": int(sum(len(line.q) for line in lines)),
        "spread_mm": 1e3 * around_zero(np.concatenate(off)) if off else None,
    }
    if beyond:
        found["held_out_mm"] = 1e3 * around_zero(np.concatenate(beyond))
        found["halves_deg"] = angle_deg(*(half.sheets[laser].normal for half in halves or ()))
    return found


def around_zero(distances: np.ndarray) -> float:
    """1.4826 times the median of the sizes: a standard deviation, whatever a few points do."""
    return float(1.4826 * np.median(np.abs(distances)))


def _lift(lens: Lens, shape: np.ndarray, q: np.ndarray, line: BoardLine) -> np.ndarray:
    """Points [n, 3] of a line on its board; m. The board's best plane is used, its shape only for the pose."""
    seen = np.isfinite(q).all(1)
    pose = pose_of(lens, shape[seen], q[seen])
    rotation, flat = cv2.Rodrigues(pose[:3])[0], least_squares(shape)
    normal = rotation @ flat.normal
    plane = Plane(normal, float(normal @ (rotation @ shape.mean(0) + pose[3:])))
    return plane.meet(lens.straight(line.q))


def table_figures(xyz: np.ndarray, height: float, normal: np.ndarray, inner: float) -> dict[str, Any]:
    """Points of a sweep of the turntable: all of the scene, and those on the table's surface.

    Args:
        xyz: Points [n, 3] in the table's coordinates: origin on the axis, z along it, up; m.
        height: Of the markers above the origin [m].
        normal: Of the plane of the markers [3].
        inner: Radius of the part of the table that is covered [m].
    """
    above, radius = xyz[:, 2] - height, np.hypot(xyz[:, 0], xyz[:, 1])
    scene = (radius < RIM + 0.01) & (above > -NEAR_TABLE) & (above < ABOVE)
    rim = xyz[(radius >= inner) & (radius < RIM) & (np.abs(above) < NEAR_TABLE)]
    found: dict[str, Any] = {"points": len(xyz), "scene": int(scene.sum()), "on_table": 0}
    if len(rim) < 50:
        return found
    # The height that most points share.
    heights = np.sort(rim[:, 2])
    counts = np.searchsorted(heights, heights + 0.002) - np.arange(len(heights))
    surface = Plane(np.array([0.0, 0.0, 1.0]), float(heights[counts.argmax()] + 0.001))
    for _ in range(5):
        on = np.abs(surface.off(rim)) < ON_TABLE
        surface = least_squares(rim[on])
    off = surface.off(rim[on])
    return found | {
        "on_table": int(on.sum()),
        "spread_mm": 1e3 * spread(off),
        "rms_mm": 1e3 * rms(off),
        "tilt_deg": angle_deg(surface.normal, normal),
        "height_mm": 1e3 * (float(np.median(rim[on][:, 2])) - height),
    }
