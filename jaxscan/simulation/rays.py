"""Which way the pixels of a camera look: tables, made once per camera.

The inverse distortion here is a fixed point in NumPy (of a wide-angle lens, a table), independent of the
inversion in `geometry`, so that an error in either shows as a difference.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from jaxscan.errors import ConfigError
from jaxscan.simulation.spec import CameraSpec


Numbers = np.ndarray | float


class Directions(NamedTuple):
    """Ways (x, y, z) that some pixels look, and how they change along u and v.

    z and its changes are the plain numbers 1 and 0 for a pinhole, which costs nothing.
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

    def moved(self, du: Numbers | np.float32, dv: Numbers | np.float32) -> tuple[np.ndarray, np.ndarray, Numbers]:
        """The same beside the pixels' centres [px]."""
        z = self.z if isinstance(self.z, float) else self.z + self.z_u * du + self.z_v * dv
        return self.x + self.x_u * du + self.x_v * dv, self.y + self.y_u * du + self.y_v * dv, z


@dataclass(frozen=True, eq=False)
class RayTable:
    """The way (x, y, z) that every pixel's centre looks, and how it changes along u and v.

    All arrays are float32 [height, width]. A pinhole has (x, y, 1), normalised image coordinates,
    along which a depth is z; a wide-angle lens has unit vectors, along which a depth is a distance.
    (x + x_u du + x_v dv, …) holds to 1e-4 px within the pixel, since a lens bends over hundreds
    of pixels.
    """

    x: np.ndarray
    y: np.ndarray
    x_u: np.ndarray
    x_v: np.ndarray
    y_u: np.ndarray
    y_v: np.ndarray
    directions: np.ndarray
    """(x, y, z) of all pixels, float32 [height * width, 3]."""
    third: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
    """z, z_u, z_v of a wide-angle lens; None for a pinhole."""
    sees: np.ndarray | None = None
    """Pixels inside the field of view of a wide-angle lens, bool; None where all are."""

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width [px]."""
        height, width = self.x.shape
        return height, width

    @property
    def z(self) -> Numbers:
        """1 for a pinhole."""
        return 1.0 if self.third is None else self.third[0]

    def at(self, *index: Any) -> Directions:
        """Those of some pixels, by any index into [height, width] arrays."""
        first = (table[index] for table in (self.x, self.x_u, self.x_v, self.y, self.y_u, self.y_v))
        return Directions(*first, *(() if self.third is None else (table[index] for table in self.third)))


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
    inner = (slice(1, -1), slice(1, -1))
    along_u = [((a[1:-1, 2:] - a[1:-1, :-2]) / 2).astype(np.float32) for a in ways]
    along_v = [((a[2:, 1:-1] - a[:-2, 1:-1]) / 2).astype(np.float32) for a in ways]
    x, y, *rest = (a[inner].astype(np.float32) for a in ways)
    z = rest[0] if rest else np.ones_like(x)
    directions = np.stack([x, y, z], -1).reshape(-1, 3)
    third = (z, along_u[2], along_v[2]) if rest else None
    sees = None if seen is None else seen[inner]
    return RayTable(x, y, along_u[0], along_v[0], along_u[1], along_v[1], directions, third, sees)


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
