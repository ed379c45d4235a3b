"""The organised point cloud."""

import equinox as eqx
from jaxtyping import Bool, Float, Int, UInt8

from jaxscan.geometry import Array


class PointCloud(eqx.Module):
    """Points on the grid [profile, line]: neighbours in the scan stay neighbours.

    Scanner frame, metres. Entries that are not `valid` are zero, never NaN.
    """

    xyz: Float[Array, "profiles lines 3"]
    rgb: UInt8[Array, "profiles lines 3"]
    """Colour, from the laser-off image; grey for a mono camera, 0 without a laser-off image."""
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
    """The table's angle phi of the profile [rad from home]."""
