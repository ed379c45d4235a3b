"""Where the eye of a picture stands, and what of the picture's canvas a room takes."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np


FOV_DEG = 26.0
TALL = 0.85
"""Greatest height of a canvas that fits a room, over its width."""


@dataclass(frozen=True)
class View:
    """A perspective camera of the picture."""

    eye: tuple[float, float, float]
    """Position of the camera [m]."""
    target: tuple[float, float, float]
    """Point in the middle of the picture [m]."""
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    fov_deg: float = FOV_DEG
    """Field of view across the picture's width."""
    cut_away: bool = True
    """Leave out surfaces that are seen from behind, and the ceiling and near walls, which hide the room."""


def room_view(xyz: np.ndarray, size: tuple[int, int] = (1600, 900)) -> View:
    """The view into a room from above one of its corners.

    Args:
        xyz: Points [n, 3], m, z up.
        size: Width and height of the picture [px].
    """
    axes, low, high = room_box(xyz)
    corners = np.stack(np.meshgrid(*zip(low, high, strict=True), indexing="ij"), -1).reshape(-1, 3) @ axes
    extent = np.maximum(high - low, 0.1)
    # From a corner, looking more along the longer side, so that both far walls are seen.
    sideways = np.array([-0.62, -0.78]) if extent[0] < extent[1] else np.array([-0.78, -0.62])
    away = np.array([*sideways, 0.62]) @ axes
    away = away / np.linalg.norm(away)
    right = np.cross(-away, (0.0, 0.0, 1.0))
    right = right / np.linalg.norm(right)
    down = np.cross(-away, right)
    reach = np.tan(0.5 * np.radians(FOV_DEG)) * 0.96
    shape = np.array([1.0, size[1] / size[0]])
    # The corner nearest the eye is cut away with the ceiling and the near walls.
    corners = np.delete(corners, np.argmax(corners @ away), axis=0)
    target, distance = corners.mean(0), float(np.linalg.norm(extent))
    for _ in range(20):
        # Put the middle of the projected box into the middle of the picture, and fill it.
        local = (corners - target - distance * away) @ np.stack([right, down, -away], 1)
        seen = local[:, :2] / local[:, 2:] / shape
        middle = 0.5 * (seen.min(0) + seen.max(0)) * shape * distance
        target = target + middle[0] * right + middle[1] * down
        distance *= 1.0 + 0.7 * (0.5 * np.ptp(seen, axis=0).max() / reach - 1.0)
        distance = float(np.clip(distance, 0.6 * np.linalg.norm(extent), 6.0 * np.linalg.norm(extent)))
    return View(_triple(target + distance * away), _triple(target))


class Frame(NamedTuple):
    """A view on a canvas."""

    view: View
    focal: float
    """Of the camera [px]."""
    middle: tuple[float, float]
    """Column and row of the point that the view looks at [px]."""
    size: tuple[int, int]
    """Width and height of the canvas [px]."""

    def local(self, points: np.ndarray) -> np.ndarray:
        """Points [n, 3], m, in the frame of the camera: right, down, ahead [n, 3], m."""
        forward = np.array(self.view.target) - np.array(self.view.eye)
        forward = forward / np.linalg.norm(forward)
        right = np.cross(forward, self.view.up)
        right = right / np.linalg.norm(right)
        axes = np.stack([right, np.cross(forward, right), forward])
        return (points - np.array(self.view.eye, points.dtype)) @ axes.T.astype(points.dtype)

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Columns and rows [n, 2], px, of points [n, 3], m, that are ahead of the camera."""
        local = self.local(points)
        return self.focal * local[:, :2] / local[:, 2:] + np.array(self.middle, points.dtype)


def frame_of(view: View, size: tuple[int, int]) -> Frame:
    """A view in the middle of a canvas of this width and height [px]."""
    width, height = size
    return Frame(view, 0.5 * width / np.tan(0.5 * np.radians(view.fov_deg)), (0.5 * width, 0.5 * height), size)


def fitted_frame(view: View, points: np.ndarray, width: int, margin: int) -> Frame:
    """A view on a canvas that the points just fill.

    Args:
        view: Eye and direction.
        points: What must be on the canvas [n, 3], m, ahead of the eye.
        width: Of the canvas [px]; its height follows from the points, `TALL` times as much at most.
        margin: Left free at each edge [px].
    """
    unit = Frame(view, 1.0, (0.0, 0.0), (1, 1))
    seen = unit.pixels(points)
    low, high = seen.min(0), seen.max(0)
    # A single point would be infinitely large.
    across, down = np.maximum(high - low, 0.02)
    inner = width - 2 * margin
    focal = inner / max(across, down / TALL)
    height = round(focal * down) + 2 * margin
    middle = np.array([0.5 * width, 0.5 * height]) - focal * 0.5 * (low + high)
    return Frame(view, float(focal), (float(middle[0]), float(middle[1])), (width, height))


def _triple(vector: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in vector)
    return x, y, z


def room_box(xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The upright box of the smallest area around a cloud: its axes [3, 3], and its ends along them [3].

    Half a per cent of the points may lie outside on every side.
    """
    some = xyz[:: max(1, len(xyz) // 30_000)].astype(np.float64)

    def box(yaw: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        c, s = np.cos(yaw), np.sin(yaw)
        axes = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        low, high = np.percentile(some @ axes.T, [0.5, 99.5], axis=0)
        return axes, low, high

    boxes = [box(yaw) for yaw in np.radians(np.arange(0.0, 90.0, 2.0))]
    return min(boxes, key=lambda one: float(np.prod((one[2] - one[1])[:2])))
