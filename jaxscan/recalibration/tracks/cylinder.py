"""Images unrolled on a cylinder about the turntable's axis, and where features go in them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscan.geometry import Scanner
from jaxscan.recalibration.tracks.seen import Cylinder
from jaxscan.recalibration.tracks.triangulate import project_all, rays_of


_MOST_PIXELS = 6_000_000
"""Of an unrolled image; those of wider lenses are reduced."""
_STEEPEST = 3.0
"""Tangent of elevation at the borders of an unrolled image, at most: the axis itself has no azimuth."""
_BORDER = 200
_CELL = 4
"""Pixels between the places of which the pixel is computed; it is linear between them, by definition."""
_FAR_OUTSIDE = -1e7
_BACK_PX = 0.5
"""Error with which the ray of a pixel must come back to that pixel: lens models fold beyond the image."""


class Turning(NamedTuple):
    """Numbers of the camera's motion, by which unrolled places are predicted."""

    centre: Float[np.ndarray, "3"]
    """The camera's place at angle 0, scanner frame [m]."""
    scale: float
    """Of the unrolled image."""

    @staticmethod
    def of(scanner: Scanner, scale: float) -> "Turning":
        """The motion of a scanner that a table turns."""
        return Turning(np.asarray(scanner.scanner_from_camera(), np.float64)[:3, 3], scale)

    def place(self, direction: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        """Unrolled places of directions in the scanner's frame at angle 0."""
        x, y, z = direction.T
        return self.scale * np.stack([np.arctan2(-y, x), -z / np.maximum(np.hypot(x, y), 1e-9)], -1)

    def direction(self, place: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
        """Directions in the scanner's frame at angle 0, of length 1 across the axis."""
        azimuth, height = -place[:, 0] / self.scale, -place[:, 1] / self.scale
        return np.stack([np.cos(azimuth), np.sin(azimuth), height], -1)

    def predict(
        self, place: Float[np.ndarray, "n 2"], turn: float, range_m: Float[np.ndarray, " n"] | float
    ) -> Float[np.ndarray, "n 2"]:
        """Where points go when the scanner turns by `turn` [rad]; `range_m` is across the axis, from the camera."""
        point = self.centre + self.direction(place) * np.asarray(range_m)[..., None]
        return self.place(turn_about_z(point, -turn) - self.centre)


def turn_about_z(p: Float[np.ndarray, "n 3"], angle: float | Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
    """Points turned about the axis."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * p[:, 0] - s * p[:, 1], s * p[:, 0] + c * p[:, 1], p[:, 2]], -1)


def unroll(scanner: Scanner, size: tuple[int, int]) -> Cylinder:
    """The unrolled image of a camera whose images have this width and height [px]."""
    width, height = size
    turning = Turning.of(scanner, 1.0)
    edge = turning.place(_directions(scanner, _border(width, height)))
    middle = turning.place(_directions(scanner, np.array([[width / 2.0, height / 2.0]])))[0, 0]
    # Azimuths are counted from the middle of the image, so that none jumps by a turn within it.
    azimuth = (edge[:, 0] - middle + np.pi) % (2 * np.pi) - np.pi + middle
    low = np.array([azimuth.min(), max(edge[:, 1].min(), -_STEEPEST)])
    high = np.array([azimuth.max(), min(edge[:, 1].max(), _STEEPEST)])
    focal = float(np.mean([scanner.camera.fx, scanner.camera.fy]))
    scale = min(focal, float(np.sqrt(_MOST_PIXELS / max(np.prod(high - low), 1e-9))))
    turning = turning._replace(scale=scale)
    cells = np.maximum(np.ceil((high - low) * scale / _CELL).astype(int), 1)
    row, column = np.mgrid[: cells[1] + 1, : cells[0] + 1] * float(_CELL)
    direction = turning.direction(np.stack([column.ravel(), row.ravel()], -1) + low * scale)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    count = len(direction)
    still = np.zeros(count), np.broadcast_to(np.eye(4), (count, 4, 4))
    q = project_all(scanner, turning.centre + direction, *still)
    inside = (q >= 0).all(1) & (q[:, 0] <= width - 1) & (q[:, 1] <= height - 1)
    back = _directions(scanner, np.where(inside[:, None], q, 0.0))
    inside &= np.linalg.norm(back - direction, axis=1) < _BACK_PX / focal
    u, v = np.where(inside[:, None], q, _FAR_OUTSIDE).T.reshape(2, *row.shape)
    return Cylinder(_finer(u), _finer(v), float(low[0] * scale), float(low[1] * scale), scale)


def _directions(scanner: Scanner, q: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
    """Directions of pixels in the scanner's frame at angle 0."""
    return rays_of(scanner, q, np.zeros(len(q)), np.broadcast_to(np.eye(4), (len(q), 4, 4))).direction


def _finer(values: Float[np.ndarray, "rows columns"]) -> Float[np.ndarray, "fine_rows fine_columns"]:
    """Values between those on a grid with cells of `_CELL` pixels, by linear interpolation; outside stays outside."""
    for axis in (0, 1):
        at = np.arange((values.shape[axis] - 1) * _CELL)
        low, part = at // _CELL, np.expand_dims(at % _CELL / _CELL, 1 - axis)
        values = np.take(values, low, axis) * (1 - part) + np.take(values, low + 1, axis) * part
    return values


def _border(width: int, height: int) -> Float[np.ndarray, "n 2"]:
    u, v = np.linspace(0, width - 1, _BORDER), np.linspace(0, height - 1, _BORDER)
    sides = [(u, 0 * u), (u, 0 * u + height - 1), (0 * v, v), (0 * v + width - 1, v)]
    return np.concatenate([np.stack(side, -1) for side in sides])
