"""The organised point cloud."""

from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from jaxscan.geometry import Array


class CloudPoints(NamedTuple):
    """The valid points of a cloud, in the order of the grid."""

    xyz: np.ndarray
    """Position [m], [n, 3], scanner frame; float32, or float64 where the cloud holds it: a national grid needs it."""
    normals: np.ndarray
    """float32 [n, 3]; zero where there is none."""
    rgb: np.ndarray
    """uint8 [n, 3]."""
    intensity: np.ndarray
    """Amplitude [DN], float32 [n]."""
    sigma: np.ndarray
    """Both uncertainties together [m], float32 [n]."""
    sigma_random: np.ndarray
    sigma_systematic: np.ndarray
    step: np.ndarray
    """Profile, int32 [n]."""
    row: np.ndarray
    """Line, int32 [n]."""
    laser: np.ndarray
    """uint8 [n]."""


class PointCloud(eqx.Module):
    """Points on the grid [profile, line]: neighbours in the scan stay neighbours.

    Scanner frame, metres. Entries that are not `valid` are zero, never NaN.
    """

    xyz: Float[Array, "profiles lines 3"]
    rgb: UInt8[Array, "profiles lines 3"]
    """Colour, from the laser-off image; grey for a mono camera; predicted where there is none."""
    intensity: Float[Array, "profiles lines"]
    """Fitted amplitude of the stripe [DN]."""
    normals: Float[Array, "profiles lines 3"]
    """Unit normals towards the camera; zero where there is none."""
    sigma_random: Float[Array, "profiles lines"]
    """Standard deviation along the ray from the stripe's noise, independent per point [m]."""
    sigma_systematic: Float[Array, "profiles lines"]
    """Standard deviation along the ray from the calibration, shared by all points [m]; zero
    where the scanner has no covariance."""
    valid: Bool[Array, "profiles lines"]
    record: Int[Array, " profiles"]
    laser: Int[Array, " profiles"]
    angle: Float[Array, " profiles"]
    """The table's angle phi of the profile [rad from home], or the stage's position [m]."""

    def points(self, start: int = 0, stop: int | None = None) -> CloudPoints:
        """The valid points as a flat list, of all profiles or of those from `start` to before `stop`."""
        part = slice(start, stop)
        step, row = np.nonzero(np.asarray(self.valid[part]))

        def take(field, dtype):
            return np.asarray(field[part])[step, row].astype(dtype)

        random, systematic = take(self.sigma_random, np.float32), take(self.sigma_systematic, np.float32)
        return CloudPoints(
            xyz=take(self.xyz, np.float64 if self.xyz.dtype == np.float64 else np.float32),
            normals=take(self.normals, np.float32),
            rgb=take(self.rgb, np.uint8),
            intensity=take(self.intensity, np.float32),
            sigma=np.hypot(random, systematic),
            sigma_random=random,
            sigma_systematic=systematic,
            step=(step + start).astype(np.int32),
            row=row.astype(np.int32),
            laser=np.asarray(self.laser[part])[step].astype(np.uint8),
        )
