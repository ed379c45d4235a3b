r"""How far points of a rig on paper are off, by the triangulation that the reconstruction itself uses.

A stripe that lies $\sigma$ beside its place moves its point by $\sigma\,\partial p / \partial u$, along the sheet.
The derivative is that of `triangulate`; on the optical axis it is $z^2 / (f b)$ in depth.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxscan.design.rig import RigDesign
from jaxscan.geometry import AbstractCamera, Array, LaserSheet
from jaxscan.reconstruction import DEFAULTS
from jaxscan.reconstruction.points import Limits, triangulate


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
    scanner = design.scanner()
    # Neither is used; a design of its own size would be compiled again.
    camera = replace(scanner.camera, width=0, height=0)
    parts = jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), (camera, scanner.laser(0)))
    limits = Limits.of(replace(DEFAULTS, min_range_m=0.0, max_range_m=1e6, min_incidence=1e-9))
    lines = ((np.arange(_LINES) + 0.5) / _LINES * design.sensor.height - 0.5).astype(np.float32)
    moved = np.stack(
        [np.asarray(_shift_per_pixel(*parts, lines, np.float32(depth), limits), np.float64) for depth in depths_m]
    )
    rms = noise_px * np.sqrt(np.mean(moved**2, axis=1))
    return Spread(np.asarray(depths_m, np.float64), rms[:, 2], rms[:, 0], rms[:, 1])


def depth_sigma(design: RigDesign, depth_m: float, noise_px: float) -> float:
    """Standard deviation of a single point's depth on a plane at this depth [m]."""
    return float(spread_at(design, [depth_m], noise_px).depth[0])


@jax.jit
def _shift_per_pixel(
    camera: AbstractCamera, sheet: LaserSheet, lines: Float[Array, " lines"], depth: Float[Array, ""], limits: Limits
) -> Float[Array, "lines 3"]:
    """Movement [m/px] of the points of a plane at this depth, camera frame."""

    def one(line):
        y = (line - camera.cy) / camera.fy * depth
        x = (sheet.distance - sheet.normal[1] * y - sheet.normal[2] * depth) / sheet.normal[0]
        u = camera.project(jnp.stack([x, y, depth]))[0]
        place = lambda u: triangulate(u, line, camera, sheet, limits=limits).p_cam
        return jax.jvp(place, (u,), (jnp.ones_like(u),))[1]

    return jax.vmap(one)(lines)
