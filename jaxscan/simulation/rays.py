"""Rays of the pixels of a camera, as tables that are made once per camera.

The inverse distortion is a fixed point iteration in NumPy; for a wide-angle lens it is a table. It is
independent of the inversion in `geometry`, so that an error in either shows as a difference.
"""

from dataclasses import dataclass, field, fields
from functools import lru_cache
from typing import Any

import numpy as np

from jaxscan.errors import ConfigError
from jaxscan.simulation.settings import CameraSpec


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
        """Those of some pixels, by any index into the arrays."""
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
