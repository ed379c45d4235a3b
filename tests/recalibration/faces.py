"""Exact stripes in rooms of planes and cylinders, in NumPy, with noise; written apart from the code under test."""

from dataclasses import dataclass, field

import jax
import numpy as np

from jaxscan.geometry import LaserSheet, Pinhole, Scanner, Turntable
from jaxscan.recalibration import SweepStripes


WIDTH, HEIGHT = 640, 512


def rig(covariance: np.ndarray | None = None) -> Scanner:
    """The paper's rig with images of 640 x 512 pixels and no distortion, its axis upright."""
    camera = Pinhole(fx=904.5, fy=904.5, cx=320.0, cy=256.0, distortion=np.zeros(5), width=WIDTH, height=HEIGHT)
    sheet = LaserSheet.from_abc(-7.606, -0.3, 1.296203)
    table = Turntable.from_axis([0.0, -1.0, 0.0], [0.0, 0.0, -0.21])
    scanner = Scanner.from_parts(camera, sheet, table)
    return Scanner(camera, scanner.lasers, scanner.turntable, covariance, scanner.laser_names, scanner.up)


@dataclass(frozen=True)
class Face:
    """A part of a plane `normal . p = distance`: where `low <= along . p < high`; light falls on its front."""

    normal: tuple[float, float, float]
    distance: float
    bounds: tuple[tuple[tuple[float, float, float], float, float], ...] = ()

    def cross(self, start: np.ndarray, ray: np.ndarray) -> np.ndarray:
        n = np.array(self.normal)
        with np.errstate(all="ignore"):
            t = (self.distance - start @ n) / (ray @ n)
        p = start + np.where(np.isfinite(t), t, -1.0)[..., None] * ray
        inside = np.ones(t.shape, bool)
        for along, low, high in self.bounds:
            at = p @ np.array(along)
            inside &= (at >= low) & (at < high)
        return np.where(inside & (t > 0.0), t, np.inf)


@dataclass(frozen=True)
class Cylinder:
    """The inside or outside of an upright cylinder, where `low <= along . p < high`."""

    centre: tuple[float, float]
    radius: float
    bounds: tuple[tuple[tuple[float, float, float], float, float], ...] = ()

    def cross(self, start: np.ndarray, ray: np.ndarray) -> np.ndarray:
        o, d = start[..., :2] - np.array(self.centre), ray[..., :2]
        a, b, c = (d * d).sum(-1), (o * d).sum(-1), (o * o).sum(-1) - self.radius**2
        root = np.sqrt(np.maximum(b * b - a * c, 0.0))
        best = np.full(a.shape, np.inf)
        for t in ((-b - root) / a, (-b + root) / a):
            p = start + t[..., None] * ray
            inside = (b * b > a * c) & (t > 0.0)
            for along, low, high in self.bounds:
                at = p @ np.array(along)
                inside &= (at >= low) & (at < high)
            best = np.where(inside, np.minimum(best, t), best)
        return best


STATED = {
    **dict.fromkeys(("fx", "fy", "cx", "cy"), 4.0),
    **{"n1": 3e-3, "n2": 2e-3, "d": 5e-4, "gain": 1e-3},
    **dict.fromkeys(("axis.d1", "axis.d2"), 3e-3),
    **dict.fromkeys(("axis.p1", "axis.p2"), 2e-3),
    **dict.fromkeys(("c1", "s1", "c2", "s2"), 3e-4),
}
"""Standard deviations of a poor calibration [px, rad, m]."""


def poor(seed: int, better: float = 1.0) -> tuple[Scanner, Scanner]:
    """A stored rig with a poor calibration, or one as many times better, that states its covariance; and a true rig."""
    stored = rig()
    names = stored.parameter_names()
    sigma = np.array([STATED.get(name, STATED.get(name.rsplit(".", 1)[-1], 0.0)) for name in names]) / better
    step = sigma * np.random.default_rng(seed).normal(size=len(sigma))
    true = jax.tree.map(np.asarray, stored.retract(step))
    return rig(np.diag(sigma**2)), true


X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


def box(x0: float = -2.0, x1: float = 2.2, y0: float = -2.1, y1: float = 2.4) -> list:
    """Four walls, floor and ceiling around the axis."""
    return [Face(X, x0), Face(X, x1), Face(Y, y0), Face(Y, y1), Face(Z, -0.75), Face(Z, 0.8)]


@dataclass(frozen=True)
class Taken:
    sweep: SweepStripes
    face: np.ndarray = field(repr=False)
    """Which face each stripe lies on [profiles, lines]; -1 where there is none."""


def take(
    faces: list,
    scanner: Scanner,
    *,
    steps: int = 360,
    turn: float = 2 * np.pi,
    noise_px: float = 0.05,
    seed: int = 0,
    pose: np.ndarray | None = None,
    station: int = 0,
) -> Taken:
    """The stripes of one sweep; `pose` is T_room_scanner."""
    rng = np.random.default_rng(seed)
    pose = np.eye(4) if pose is None else pose
    camera, table = scanner.camera, scanner.turntable
    f, cx, cy = float(camera.fx), float(camera.cx), float(camera.cy)
    n, d = np.asarray(scanner.lasers.normal)[0], float(np.asarray(scanner.lasers.distance)[0])
    # Points of one image row on the sheet: a straight line start + x * ray.
    y = (np.arange(HEIGHT) - cy) / f
    below = n[1] * y + n[2]
    # The plane through the camera and the row meets the sheet in the direction (below, ...) with n . ray = 0.
    ray = np.stack([-below / n[0], y, np.ones(HEIGHT)], -1)
    start = np.stack([np.full(HEIGHT, d / n[0]), np.zeros(HEIGHT), np.zeros(HEIGHT)], -1)
    angle = turn * np.arange(steps) / steps
    centre, face = np.zeros((steps, HEIGHT)), np.full((steps, HEIGHT), -1)
    frame = np.asarray(scanner.scanner_from_camera())
    a, point = np.asarray(table.direction), np.asarray(table.point)
    cross = np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
    for k, phi in enumerate(angle):
        theta = float(table.gain) * phi
        turned = np.eye(3) + np.sin(theta) * cross + (1 - np.cos(theta)) * cross @ cross
        to_room = pose[:3, :3] @ frame[:3, :3]

        def room(p, to_room=to_room, turned=turned):
            return (p @ turned.T + point - turned @ point) @ to_room.T + pose[:3, :3] @ frame[:3, 3] + pose[:3, 3]

        origin, ahead = room(start), ray @ turned.T @ to_room.T
        ranges = np.stack([one.cross(origin, ahead) for one in faces])
        z = ranges.min(0)
        p = start + z[:, None] * ray
        u = cx + f * p[:, 0] / p[:, 2]
        seen = np.isfinite(z) & (z < 8.0) & (u > 1) & (u < WIDTH - 2)
        centre[k], face[k] = np.where(seen, u, 0.0), np.where(seen, ranges.argmin(0), -1)
    valid = face >= 0
    centre = centre + noise_px * rng.normal(size=centre.shape) * valid
    one = np.ones_like(centre)
    sweep = SweepStripes(
        name=f"sweep {seed}",
        centre=centre,
        sigma=noise_px * one,
        shared_lines=one,
        valid=valid,
        record=np.arange(steps),
        laser=np.zeros(steps, int),
        angle=angle,
        stripe_axis="rows",
        station=station,
    )
    return Taken(sweep, face)
