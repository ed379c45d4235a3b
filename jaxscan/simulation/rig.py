"""The true rig: camera, laser sheets and motion, written apart from `geometry`, and the rays of its pixels.

The inverse distortion is a fixed point iteration in NumPy; for a wide-angle lens it is a table. It is
independent of the inversion in `geometry`, so that an error in either shows as a difference.
"""

from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from typing import Any

import numpy as np

from jaxscan.errors import ConfigError
from jaxscan.simulation.settings import CameraSpec, LaserSpec, SimulationConfig


Numbers = np.ndarray | float


@dataclass(frozen=True, eq=False)
class Directions:
    """Directions (x, y, z) of the rays of some pixels, and their derivatives along u and v [1/px], float32.

    A pinhole has (x, y, 1), normalised image coordinates, along which a depth is z: here z and its
    derivatives are the plain numbers 1 and 0, which cost nothing. A wide-angle lens has unit
    vectors, along which a depth is a distance. The linear change holds to 1e-4 px within the
    pixel, since a lens bends over hundreds of pixels.
    """

    x: np.ndarray
    x_u: np.ndarray
    x_v: np.ndarray
    y: np.ndarray
    y_u: np.ndarray
    y_v: np.ndarray
    z: Numbers = 1.0
    z_u: Numbers = 0.0
    z_v: Numbers = 0.0

    def at(self, *index: Any) -> "Directions":
        """The rays of some pixels, by any index into the arrays."""
        tables: list[Any] = [getattr(self, field.name) for field in fields(Directions)]
        return Directions(*(table[index] if np.ndim(table) else table for table in tables))

    def moved(self, du: Numbers | np.float32, dv: Numbers | np.float32) -> tuple[np.ndarray, np.ndarray, Numbers]:
        """(x, y, z) at (du, dv) px beside the pixels' centres."""
        z = self.z if isinstance(self.z, float) else self.z + self.z_u * du + self.z_v * dv
        return self.x + self.x_u * du + self.x_v * dv, self.y + self.y_u * du + self.y_v * dv, z


@dataclass(frozen=True, eq=False)
class RayTable(Directions):
    """The rays of all pixels; arrays are [height, width]."""

    vectors: np.ndarray = field(kw_only=True)
    """(x, y, z) of all pixels, float32 [height * width, 3]."""
    sees: np.ndarray | None = field(kw_only=True)
    """Pixels inside the field of view of a wide-angle lens, bool; None where all are."""

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width [px]."""
        height, width = self.x.shape
        return height, width


def project(camera: CameraSpec, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (u, v) of points [n, 3], camera frame, float64; without meaning beyond the field of view."""
    x, y, z = (points[..., i] for i in range(3))
    if not camera.wide:
        return distort(camera, x / z, y / z)
    aside = np.hypot(x, y)
    scale = _bent(camera, np.arctan2(aside, z)) / np.maximum(aside, 1e-300)
    cx, cy = camera.centre()
    return camera.fx * scale * x + cx, camera.fy * scale * y + cy


def distort(camera: CameraSpec, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixel (u, v) of normalised coordinates, float64, of a pinhole.

    Raises:
        ConfigError: If the camera is none.
    """
    if camera.wide:
        raise ConfigError(f"A {camera.model} has no normalised image coordinates: it sees beside and behind itself.")
    r2 = x * x + y * y
    radial = 1 + r2 * (camera.k1 + r2 * (camera.k2 + r2 * camera.k3))
    xd = x * radial + 2 * camera.p1 * x * y + camera.p2 * (r2 + 2 * x * x)
    yd = y * radial + camera.p1 * (r2 + 2 * y * y) + 2 * camera.p2 * x * y
    cx, cy = camera.centre()
    return camera.fx * xd + cx, camera.fy * yd + cy


def undistort(camera: CameraSpec, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normalised coordinates of pixels of a pinhole, float64, by the fixed point x <- x - (d(x) - target).

    Raises:
        ConfigError: If the lens folds over inside the image, so that no inverse exists.
    """
    cx, cy = camera.centre()
    x0, y0 = (u - cx) / camera.fx, (v - cy) / camera.fy
    x, y = x0.copy(), y0.copy()
    for _ in range(200):
        ud, vd = distort(camera, x, y)
        step_x, step_y = (ud - u) / camera.fx, (vd - v) / camera.fy
        x -= step_x
        y -= step_y
        change = max(np.abs(step_x).max(initial=0), np.abs(step_y).max(initial=0))
        if not change < 10:
            break
        if change < 1e-13:
            return x, y
    raise ConfigError(
        f"The lens (k1 = {camera.k1}, k2 = {camera.k2}, k3 = {camera.k3}, fx = {camera.fx}) cannot be inverted over "
        f"the whole image of {camera.width} x {camera.height} px: use weaker distortion or a longer focal length."
    )


@lru_cache(maxsize=4)
def ray_table(camera: CameraSpec) -> RayTable:
    """The table of a camera; the last few are kept."""
    # One pixel beyond every side, for central differences at the border.
    columns, rows = np.meshgrid(np.arange(-1.0, camera.width + 1), np.arange(-1.0, camera.height + 1))
    seen, ways = look(camera, columns, rows) if camera.wide else (None, undistort(camera, columns, rows))
    tables = [
        table.astype(np.float32)
        for way in ways
        for table in (way[1:-1, 1:-1], (way[1:-1, 2:] - way[1:-1, :-2]) / 2, (way[2:, 1:-1] - way[:-2, 1:-1]) / 2)
    ]
    x, y, z = tables[0], tables[3], tables[6] if camera.wide else np.ones_like(tables[0])
    vectors = np.stack([x, y, z], -1).reshape(-1, 3)
    return RayTable(*tables, vectors=vectors, sees=None if seen is None else seen[1:-1, 1:-1])


def look(
    camera: CameraSpec, u: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Unit vectors along which pixels of a wide-angle lens look, float64, by interpolation in a table of angles.

    Returns:
        Which pixels are inside the field of view, and (x, y, z): of those beyond, on its edge.

    Raises:
        ConfigError: If the lens folds over inside its field of view.
    """
    # Linear between points so close, an angle is right to 1e-11.
    theta = np.linspace(0, np.deg2rad(camera.field_deg / 2), 1 << 17)
    bent = _bent(camera, theta)
    if np.any(np.diff(bent) <= 0):
        raise ConfigError(
            f"The lens ({', '.join(f'{name} = {value}' for name, value in camera.coefficients().items())}) folds over "
            f"inside its field of view of {camera.field_deg} degrees: use weaker distortion or a smaller `field_deg`."
        )
    cx, cy = camera.centre()
    x, y = (u - cx) / camera.fx, (v - cy) / camera.fy
    radius = np.hypot(x, y)
    angle = np.interp(radius, bent, theta)
    scale = np.sin(angle) / np.maximum(radius, 1e-300)
    return radius < bent[-1], (scale * x, scale * y, np.cos(angle))


def _bent(camera: CameraSpec, theta: np.ndarray) -> np.ndarray:
    """Distance from the principal point, per focal length, at which a wide-angle lens shows an angle."""
    if camera.model == "double_sphere":
        second = np.sqrt(1 + 2 * camera.xi * np.cos(theta) + camera.xi**2)
        return np.sin(theta) / (camera.alpha * second + (1 - camera.alpha) * (camera.xi + np.cos(theta)))
    return theta + camera.k1 * theta**3 + camera.k2 * theta**5 + camera.k3 * theta**7 + camera.k4 * theta**9


# The rig of the renderer: poses by Rodrigues' formula, laser sheets, and origins of the fans.
#
# It is independent of `geometry` on purpose: tests compare the two, so an error in either shows.

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
    """T_scanner_cam at angle 0."""

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
    return replace(sheet, slope=slope, power=float(power))
