"""Which way the pixels of a camera look: tables, made once per camera.

The inverse distortion here is a fixed point in NumPy, independent of the Newton iteration in
`geometry`, so that an error in either shows as a difference.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from jaxscan.errors import ConfigError
from jaxscan.simulation.spec import CameraSpec


@dataclass(frozen=True, eq=False)
class RayTable:
    """Normalised image coordinates of every pixel centre, and how they change along u and v.

    All arrays are float32 [height, width]. The pixel (row, column) looks along (x, y, 1);
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
    """(x, y, 1) of all pixels, float32 [height * width, 3]."""

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width [px]."""
        height, width = self.x.shape
        return height, width


def distort(camera: CameraSpec, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixel (u, v) of normalised coordinates, float64."""
    r2 = x * x + y * y
    radial = 1 + r2 * (camera.k1 + r2 * (camera.k2 + r2 * camera.k3))
    xd = x * radial + 2 * camera.p1 * x * y + camera.p2 * (r2 + 2 * x * x)
    yd = y * radial + camera.p1 * (r2 + 2 * y * y) + 2 * camera.p2 * x * y
    cx, cy = camera.centre()
    return camera.fx * xd + cx, camera.fy * yd + cy


def undistort(camera: CameraSpec, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normalised coordinates of pixels, float64, by the fixed point x <- x - (d(x) - target).

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
    x, y = undistort(camera, columns, rows)
    inner = (slice(1, -1), slice(1, -1))
    along_u = [((a[1:-1, 2:] - a[1:-1, :-2]) / 2).astype(np.float32) for a in (x, y)]
    along_v = [((a[2:, 1:-1] - a[:-2, 1:-1]) / 2).astype(np.float32) for a in (x, y)]
    x32, y32 = x[inner].astype(np.float32), y[inner].astype(np.float32)
    directions = np.stack([x32, y32, np.ones_like(x32)], -1).reshape(-1, 3)
    return RayTable(x32, y32, along_u[0], along_v[0], along_u[1], along_v[1], directions)
