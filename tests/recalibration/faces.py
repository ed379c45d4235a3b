"""Exact stripes in rooms of planes and cylinders, in NumPy, with noise; written apart from the code under test."""

from dataclasses import dataclass, field

import jax
import numpy as np
from scipy.spatial.transform import Rotation

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


def wide_rig() -> Scanner:
    """The demo's rig, whose camera sees far to its sides, without distortion."""
    camera = Pinhole(fx=410.0, fy=410.5, cx=322.4, cy=254.1, distortion=np.zeros(5), width=WIDTH, height=HEIGHT)
    sheet = LaserSheet.from_plane(np.array([1 / 0.45, 0.0, 1 / 3.2]), 1.0)
    return Scanner.from_parts(camera, sheet, Turntable.from_axis([0.012, -0.99989, 0.008], [0.12, 0.0, -0.06]))


def pose(place: tuple[float, float, float], yaw_deg: float, tilt_deg: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """T_room_scanner of a rig at a place of the room [m], turned by yaw, then tilted about its x and y."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("ZXY", [yaw_deg, *tilt_deg], degrees=True).as_matrix()
    T[:3, 3] = place
    return T


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


def solid(low: tuple[float, float, float], high: tuple[float, float, float]) -> list:
    """The six faces of a box in a room, between two corners."""
    sides = []
    for axis, along in enumerate((X, Y, Z)):
        others = [(one, low[k], high[k]) for k, one in enumerate((X, Y, Z)) if k != axis]
        sides += [Face(along, at, tuple(others)) for at in (low[axis], high[axis])]
    return sides


def box(x0=-2.0, x1=2.2, y0=-2.1, y1=2.4, z0=-0.75, z1=0.8) -> list:
    """Four walls, floor and ceiling around the axis."""
    return [Face(X, x0), Face(X, x1), Face(Y, y0), Face(Y, y1), Face(Z, z0), Face(Z, z1)]


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
    stood: np.ndarray | None = None,
) -> Taken:
    """The stripes of one sweep; `pose` is T_room_scanner, `stood` where the table stood if not where the journal has it
    [rad]."""
    rng = np.random.default_rng(seed)
    pose = np.eye(4) if pose is None else pose
    camera, table = scanner.camera, scanner.turntable
    width, height = camera.width, camera.height
    fx, fy, cx, cy = (float(value) for value in (camera.fx, camera.fy, camera.cx, camera.cy))
    n, d = np.asarray(scanner.lasers.normal)[0], float(np.asarray(scanner.lasers.distance)[0])
    # Points of one image row on the sheet: a straight line start + x * ray.
    y = (np.arange(height) - cy) / fy
    below = n[1] * y + n[2]
    # The plane through the camera and the row meets the sheet in the direction (below, ...) with n . ray = 0.
    ray = np.stack([-below / n[0], y, np.ones(height)], -1)
    start = np.array([d / n[0], 0.0, 0.0]) * np.ones((height, 1))
    angle = turn * np.arange(steps) / steps
    centre, face = np.zeros((steps, height)), np.full((steps, height), -1)
    frame = np.asarray(scanner.scanner_from_camera())
    a, point = np.asarray(table.direction), np.asarray(table.point)
    cross = np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
    for k, phi in enumerate(angle if stood is None else stood):
        theta = float(table.gain) * phi
        turned = np.eye(3) + np.sin(theta) * cross + (1 - np.cos(theta)) * cross @ cross
        to_room = pose[:3, :3] @ frame[:3, :3]

        def room(p, to_room=to_room, turned=turned):
            return (p @ turned.T + point - turned @ point) @ to_room.T + pose[:3, :3] @ frame[:3, 3] + pose[:3, 3]

        origin, ahead = room(start), ray @ turned.T @ to_room.T
        ranges = np.stack([one.cross(origin, ahead) for one in faces])
        z = ranges.min(0)
        p = start + z[:, None] * ray
        u = cx + fx * p[:, 0] / p[:, 2]
        seen = np.isfinite(z) & (z < 8.0) & (u > 1) & (u < width - 2)
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
