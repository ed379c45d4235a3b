"""A rig drawn by chance: camera, laser sheet and turntable. NumPy alone, nothing of jaxscan.

Coordinates are metres; pixel (0, 0) is the centre of the top-left pixel; the camera looks along z, y points down.
"""

from typing import NamedTuple

import numpy as np


class Rig(NamedTuple):
    """A camera, a sheet of laser light, and the axis of the table under them, in the camera's frame at angle 0."""

    width: int
    height: int
    lens: np.ndarray
    """fx, fy, cx, cy [px], k1, k2, p1, p2 [1]."""
    source: np.ndarray
    """Where the sheet comes from [3], m."""
    normal: np.ndarray
    distance: float
    """The sheet: normal . p = distance."""
    direction: np.ndarray
    point: np.ndarray
    """The axis: its upward direction, and its point nearest the camera [m]."""
    gain: float
    harmonics: np.ndarray
    """c1, s1, c2, s2 [rad]."""

    def theta(self, phi: float) -> float:
        """Turned angle [rad] at the table's own angle [rad]."""
        c1, s1, c2, s2 = self.harmonics
        once = c1 * (np.cos(phi) - 1) + s1 * np.sin(phi)
        return float(self.gain * phi + once + c2 * (np.cos(2 * phi) - 1) + s2 * np.sin(2 * phi))

    def pose(self, phi: float) -> np.ndarray:
        """T_cam0_cam [4, 4] at the table's own angle [rad]."""
        turn = rotation(self.direction, self.theta(phi))
        return rigid(turn, self.point - turn @ self.point)


def rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    """Turn [3, 3] about an axis by an angle [rad] (Rodrigues)."""
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def rigid(turn: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """A motion [4, 4] from a turn [3, 3] and a shift [3]."""
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = turn, shift
    return motion


def project(lens: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Pixels [..., 2] of points [..., 3] in the camera's frame."""
    fx, fy, cx, cy = lens[:4]
    x, y = _bend(lens, points[..., 0] / points[..., 2], points[..., 1] / points[..., 2])
    return np.stack([fx * x + cx, fy * y + cy], -1)


def look(lens: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Directions [..., 3] with z = 1 of pixels, the lens's bend undone by a fixed point, to 1e-9."""
    fx, fy, cx, cy = lens[:4]
    seen_x, seen_y = (np.asarray(u, np.float64) - cx) / fx, (np.asarray(v, np.float64) - cy) / fy
    x, y = seen_x, seen_y
    for _ in range(9):
        bent_x, bent_y = _bend(lens, x, y)
        x, y = x + (seen_x - bent_x), y + (seen_y - bent_y)
    return np.stack([x, y, np.ones_like(x)], -1)


def _bend(lens: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    k1, k2, p1, p2 = lens[4:]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * k2)
    return (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
    )


def draw_rig(rng: np.random.Generator) -> Rig:
    """A rig like that of a careful hobbyist: 400 to 480 px wide, sheet from 0.34 to 0.42 m beside the camera."""
    width = int(rng.choice([400, 432, 464, 480]))
    height = width * 3 // 4
    f = 0.9 * width * rng.uniform(0.97, 1.03)
    middle = np.array([width - 1, height - 1]) / 2 + rng.uniform(-4, 4, 2)
    bend = np.array([rng.uniform(-0.09, -0.04), rng.uniform(0.0, 0.03), *rng.uniform(-6e-4, 6e-4, 2)])
    lens = np.array([f, f * rng.uniform(0.998, 1.002), *middle, *bend])
    side = rng.choice([-1.0, 1.0])
    source = np.array([side * rng.uniform(0.34, 0.42), rng.uniform(-0.02, 0.02), rng.uniform(-0.03, 0.03)])
    crossing = np.array([0.0, 0.0, rng.uniform(1.9, 2.3)])
    upright = np.array([rng.uniform(-0.03, 0.03), 1.0, rng.uniform(-0.02, 0.02)])
    normal = np.cross(crossing - source, upright)
    normal /= np.linalg.norm(normal)
    normal *= np.sign(normal @ source)
    direction = np.array([rng.uniform(-0.015, 0.015), -1.0, rng.uniform(-0.015, 0.015)])
    direction /= np.linalg.norm(direction)
    point = np.array([rng.uniform(-0.12, 0.12), 0.0, rng.uniform(-0.12, -0.04)])
    return Rig(
        width,
        height,
        lens,
        source,
        normal,
        float(normal @ source),
        direction,
        point - direction * (direction @ point),
        1 + 2e-4 * float(rng.standard_normal()),
        1.5e-4 * rng.standard_normal(4),
    )
