r"""How far points of a rig on paper are off, by the kinematics that the reconstruction itself uses.

A stripe that lies $\sigma$ beside its place moves its point by $\sigma\,\partial p / \partial u$, along the sheet.
The derivative is that of `slopes`; on the optical axis it is $z^2 / (f b)$ in depth.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscan.design.rig import RigDesign
from jaxscan.geometry import Rig, lit_points, lit_slopes


_LINES = 64
"""Lines of the image, in the middles of as many equal strips, that stand for all of them."""


class Spread(NamedTuple):
    """Standard deviations [m] at several depths, over the lines of the image as root mean square."""

    depth_m: Float[np.ndarray, " depths"]
    depth: Float[np.ndarray, " depths"]
    """Along the optical axis."""
    across: Float[np.ndarray, " depths"]
    """Across the stripe."""
    along: Float[np.ndarray, " depths"]
    """Along the stripe."""


def spread_at(design: RigDesign, depths_m: Sequence[float], noise_px: float) -> Spread:
    """Standard deviations of single points on planes at several depths.

    Args:
        design: The rig.
        depths_m: z in the camera frame [m].
        noise_px: Standard deviation of a stripe's centre [px].
    """
    rig = design.scanner().rig
    lines = (np.arange(_LINES) + 0.5) / _LINES * design.sensor.height - 0.5
    moved = np.stack([_shift_per_pixel(rig, lines, float(depth)) for depth in depths_m])
    rms = noise_px * np.sqrt(np.mean(moved**2, axis=1))
    return Spread(np.asarray(depths_m, np.float64), rms[:, 2], rms[:, 0], rms[:, 1])


def depth_sigma(design: RigDesign, depth_m: float, noise_px: float) -> float:
    """Standard deviation of a single point's depth on a plane at this depth [m]."""
    return float(spread_at(design, [depth_m], noise_px).depth[0])


def _shift_per_pixel(rig: Rig, lines: Float[np.ndarray, " lines"], depth: float) -> Float[np.ndarray, "lines 3"]:
    """Movement [m/px] of the points of a plane at this depth, camera frame."""
    camera, sheet = rig.camera, rig.laser(0)
    y = (lines - camera.cy) / camera.fy * depth
    x = (sheet.distance - sheet.normal[1] * y - sheet.normal[2] * depth) / sheet.normal[0]
    q = np.stack([np.asarray(camera.project(np.stack([x, y, np.full_like(y, depth)], -1)))[:, 0], lines], -1)
    return np.asarray(lit_slopes(rig, *lit_points(rig, q, 0), 0))[..., 0]
