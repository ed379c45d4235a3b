"""The rig of the renderer: poses by Rodrigues' formula, laser sheets, and origins of the fans.

It is independent of `geometry` on purpose: tests compare the two, so an error in either shows.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from jaxscan.errors import ConfigError
from jaxscan.simulation.rays import Numbers, RayTable, ray_table
from jaxscan.simulation.settings import LaserSpec, SimulationConfig


WALL_ALBEDO = 0.7
"""Albedo of the wall that `peak_dn` of a laser refers to."""


@dataclass(frozen=True)
class Motion:
    """p_a = rotation @ p_b + translation."""

    rotation: np.ndarray
    translation: np.ndarray

    def __matmul__(self, other: "Motion") -> "Motion":
        return Motion(self.rotation @ other.rotation, self.rotation @ other.translation + self.translation)

    def inverse(self) -> "Motion":
        """The motion back."""
        return Motion(self.rotation.T, -self.rotation.T @ self.translation)

    def turn(self, vectors: np.ndarray) -> np.ndarray:
        """Vectors [..., 3] turned, in their own precision."""
        r = self.rotation.astype(vectors.dtype)
        x, y, z = np.moveaxis(vectors, -1, 0)
        out = np.empty_like(vectors)
        # Three sums beat a matrix product whose matrix is 3 x 3.
        for row in range(3):
            np.add(r[row, 0] * x + r[row, 1] * y, r[row, 2] * z, out=out[..., row])
        return out

    def apply(self, points: np.ndarray) -> np.ndarray:
        """Points [..., 3] carried over, in their own precision."""
        moved = self.turn(points)
        moved += self.translation.astype(points.dtype)
        return moved


def rodrigues(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rotation matrix about a unit axis by `angle` [rad]."""
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


@dataclass(frozen=True, eq=False)
class Sheet:
    """A laser's sheet of light, camera frame: n . p = d + rho (b2 tau^2 + b3 tau^3)."""

    spec: LaserSpec
    normal: np.ndarray
    distance: float
    origin: np.ndarray
    """Origin of the fan."""
    ahead: np.ndarray
    """The middle of the fan: the optical axis projected into the sheet."""
    across: np.ndarray
    slope: np.ndarray
    """`slope_at` of every pixel's (x, y, z), float32 [height, width]."""
    power: float
    """DN times m^2: the stripe's light per unit fan, see `stripe`."""
    bulge: float = 0.0
    """How far the bowed sheet lies beside its plane in the image, at the most, per depth."""

    def slope_at(self, x: np.ndarray, y: np.ndarray, z: Numbers = 1.0) -> np.ndarray:
        """m such that the point t (x, y, z) lies t m - d beside the sheet."""
        n, g, e = self.normal, self.ahead, self.across
        slope = n[0] * x + n[1] * y + n[2] * z
        if self.spec.bow != (0.0, 0.0):
            along, aside = g[0] * x + g[1] * y + g[2] * z, e[0] * x + e[1] * y + e[2] * z
            tau = np.arctan2(aside, along)
            slope = slope - np.hypot(along, aside) * tau * tau * (self.spec.bow[0] + self.spec.bow[1] * tau)
        return slope

    def thickness(self, r: np.ndarray) -> np.ndarray:
        """Standard deviation of the sheet's thickness [m] at distance `r` [m] from the laser, in the fan's middle."""
        waist, divergence = self.spec.waist_mm / 1000, self.spec.divergence_mrad / 1000
        return np.sqrt(waist**2 + (divergence * (r - self.spec.focus_m)) ** 2)

    def angle(self, legs: np.ndarray) -> np.ndarray:
        """Angle in the fan of directions [n, 3] from the laser [rad]; 0 in its middle."""
        return np.arctan2(legs @ self.across.astype(legs.dtype), legs @ self.ahead.astype(legs.dtype))


@dataclass(frozen=True, eq=False)
class TrueRig:
    """Camera, sheets and axis, ready for rendering."""

    config: SimulationConfig
    rays: RayTable
    sheets: tuple[Sheet, ...]
    direction: np.ndarray
    """Unit axis, upwards, camera frame at angle 0."""
    point: np.ndarray
    """Its point nearest the camera."""
    scanner_from_camera: Motion
    """At angle 0."""

    def theta(self, phi: float) -> float:
        """Angle of turning at the table's angle `phi` [rad]."""
        c1, s1, c2, s2 = self.config.turntable.harmonics
        wave = c1 * (np.cos(phi) - 1) + s1 * np.sin(phi) + c2 * (np.cos(2 * phi) - 1) + s2 * np.sin(2 * phi)
        return float(self.config.turntable.gain * phi + wave)

    def stood(self, phi: float, placement: int | None = None) -> float:
        """Where the table stands when it was sent to `phi` [rad]: elsewhere for every placement of a board."""
        width = np.deg2rad(self.config.turntable.stop_deg)
        if width == 0:
            return phi
        visit = [self.config.seed, _STOPS, 0 if placement is None else placement + 1, round(1e9 * phi) % 2**63]
        return phi + float(width * np.random.Generator(np.random.SFC64(visit)).uniform(-0.5, 0.5))

    def pose(self, phi: float) -> Motion:
        """Camera coordinates at the table's angle `phi` [rad] to the scanner frame."""
        theta = self.theta(phi) if self.config.turntable.carries == "scanner" else -self.theta(phi)
        rotation = rodrigues(self.direction, theta)
        return self.scanner_from_camera @ Motion(rotation, self.point - rotation @ self.point)


_STOPS = 9
"""Stream of random numbers that are drawn from one seed, beside those of frames and poses."""
_UP = {"-v": (0.0, -1.0, 0.0), "+v": (0.0, 1.0, 0.0), "+u": (1.0, 0.0, 0.0), "-u": (-1.0, 0.0, 0.0)}


@lru_cache(maxsize=4)
def make_rig(config: SimulationConfig) -> TrueRig:
    """The rig of a configuration; the last few are kept."""
    rays = ray_table(config.camera)
    direction, point = turning_axis(config)
    ahead = np.array([0.0, 0.0, 1.0]) - direction[2] * direction
    length = np.linalg.norm(ahead)
    if length < 1e-6:
        raise ConfigError("The camera looks along the turntable's axis: the scanner frame has no x direction.")
    x = ahead / length
    rotation = np.stack([x, np.cross(direction, x), direction])
    base = Motion(rotation, -rotation @ point)
    sheets = tuple(_sheet(laser, config, rays) for laser in config.laser)
    return TrueRig(config, rays, sheets, direction, point, base)


def turning_axis(config: SimulationConfig) -> tuple[np.ndarray, np.ndarray]:
    """Unit direction of the axis, upwards, and its point nearest the camera [m], camera frame."""
    spec = config.turntable
    if spec.tr is None:
        direction, point = np.array(spec.direction), np.array(spec.point_m)
        direction = direction / np.linalg.norm(direction)
    else:
        tr = np.array(spec.tr)
        u, _, vt = np.linalg.svd(tr[:3, :3])
        rotation = u @ vt
        values, vectors = np.linalg.eig(rotation)
        direction = np.real(vectors[:, np.argmin(np.abs(values - 1))])
        direction = direction / np.linalg.norm(direction)
        shift = tr[:3, 3] / 1000
        shift = shift - (direction @ shift) * direction
        # Half the turn's chord, and the arrow to the centre: p = (t + cot(theta/2) a x t) / 2.
        twice = rotation - rotation.T
        sine = np.array([twice[2, 1], twice[0, 2], twice[1, 0]]) / 2 @ direction
        theta = np.arctan2(sine, (np.trace(rotation) - 1) / 2)
        if abs(theta) < 1e-9:
            raise ConfigError("`tr` of the turntable does not turn.")
        point = (shift + np.cross(direction, shift) / np.tan(theta / 2)) / 2
    point = point - (direction @ point) * direction
    return (-direction if direction @ np.array(_UP[config.camera.up]) < 0 else direction), point


def _sheet(spec: LaserSpec, config: SimulationConfig, rays: RayTable) -> Sheet:
    normal, distance = spec.plane()
    ahead = np.array([0.0, 0.0, 1.0]) - normal[2] * normal
    if np.linalg.norm(ahead) < 1e-6 or not distance > 0:
        raise ConfigError(f"The sheet of laser {spec.name!r} faces the camera or runs through it: no triangulation.")
    ahead = ahead / np.linalg.norm(ahead)
    across = np.cross(normal, ahead)
    if spec.origin_m is not None:
        origin = np.array(spec.origin_m)
        if abs(normal @ origin - distance) > 1e-3:
            raise ConfigError(f"`origin_m` of laser {spec.name!r} lies more than 1 mm beside its sheet.")
    elif abs(normal[0]) > 0.3:
        origin = np.array([distance / normal[0], 0.0, 0.0])
    else:
        origin = distance * normal
    sheet = Sheet(spec, normal, distance, origin, ahead, across, np.zeros((0, 0), np.float32), 1.0)
    # The stripe on the reference wall, as wide as sheet, lens and pixel make it together.
    r = spec.range_m
    width_m = float(sheet.thickness(np.array([r]))[0])
    width_px = width_m * config.camera.fx / r
    seen_px = np.sqrt(width_px**2 + config.sensor.psf_px**2 + 1 / 12)
    power = spec.peak_dn / WALL_ALBEDO * r * np.sqrt(2 * np.pi) * width_m * seen_px / width_px
    slope = sheet.slope_at(*(np.asarray(part, np.float64) for part in (rays.x, rays.y, rays.z))).astype(np.float32)
    flat = sum(part * np.asarray(way, np.float64) for part, way in zip(normal, (rays.x, rays.y, rays.z), strict=True))
    # A hundredth for places between pixel centres.
    bulge = 0.0 if spec.bow == (0.0, 0.0) else 1.01 * float(np.abs(slope - flat).max())
    return replace(sheet, slope=slope, power=float(power), bulge=bulge)
