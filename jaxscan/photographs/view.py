"""One photograph as points are seen in it: where, and how far away."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxscan.geometry import AbstractCamera, Array, Scanner, kinematics


MARGIN_PX = 1.5
"""Nearer to the border of an image no colour is taken: four pixels are needed on each side of a place."""


class Lens(NamedTuple):
    """A camera and the cone of its rays, single precision."""

    camera: AbstractCamera
    least_cosine: Float[Array, ""]
    """Cosine of the widest angle between the optical axis and a pixel's ray. Beyond, a lens model may fold back."""
    bounds: Float[Array, "2 3"]
    """Least and largest component of the rays of pixels on each axis of the camera."""
    per_pixel: Float[Array, ""]
    """Angle of a pixel in the middle of the image [rad]."""

    @staticmethod
    def of(camera: AbstractCamera) -> "Lens":
        """The lens of a camera."""
        rays = border_rays(camera)
        bounds = np.stack([rays.min(0) - 1e-4, rays.max(0) + 1e-4])
        # Rays across the optical axis are in the image of a wider lens, but not on its border.
        bounds[:, :2] = bounds[:, :2] if bounds[0, 2] > 0 else [[-1], [1]]
        bounds[1, 2] = 1
        single = jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), camera)
        focal = max(float(camera.fx), float(camera.fy))
        return Lens(single, *(np.asarray(field, np.float32) for field in (bounds[0, 2], bounds, 1.0 / focal)))


class View(NamedTuple):
    """Where a photograph was taken from."""

    lens: Lens
    T_scanner_cam: Float[Array, "4 4"]


class Sight(NamedTuple):
    """A point as a photograph shows it."""

    q: Float[Array, "2"]
    """Pixel (u, v)."""
    range_m: Float[Array, ""]
    """Distance from the camera."""
    inside: Bool[Array, ""]
    """Whether it lies in the image."""


def poses(scanner: Scanner, angles: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 4 4"]:
    """T_scanner_cam at each of the table's angles [rad], or positions of a stage [m]."""
    return np.asarray(kinematics.poses(scanner.rig, np.asarray(angles, np.float64)), np.float32)


def pose_finder(scanner: Scanner) -> Callable[[float], Float[np.ndarray, "4 4"]]:
    """`poses` of one angle at a time."""
    rig = scanner.rig
    return lambda angle: np.asarray(kinematics.poses(rig, angle), np.float32)


def border_rays(camera: AbstractCamera) -> Float[np.ndarray, "n 3"]:
    """Unit rays [camera frame] of pixels round the border of the image."""
    columns, rows = np.linspace(0, camera.width - 1, 33), np.linspace(0, camera.height - 1, 33)
    sides = [(columns, rows[:1]), (columns, rows[-1:]), (columns[:1], rows), (columns[-1:], rows)]
    q = np.concatenate([np.stack(np.broadcast_arrays(u, v), -1) for u, v in sides])
    return np.asarray(camera.unproject(q))


def dot(a: Float[Array, "3"], b: Float[Array, "3"]) -> Float[Array, ""]:
    """Written out: of a contraction over three components XLA makes a loop for each of many points."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def sight(view: View, point: Float[Array, "3"]) -> Sight:
    """A point [scanner frame, m] in a view."""
    camera = view.lens.camera
    rotation, centre = view.T_scanner_cam[:3, :3], view.T_scanner_cam[:3, 3]
    way = point - centre
    p = jnp.stack([dot(rotation[:, k], way) for k in range(3)])
    range_m = jnp.sqrt(dot(p, p))
    q = camera.project(p)
    u, v = q
    inside = (p[2] > view.lens.least_cosine * range_m) & (range_m > 0)
    inside &= (u >= MARGIN_PX) & (u <= camera.width - 1 - MARGIN_PX)
    inside &= (v >= MARGIN_PX) & (v <= camera.height - 1 - MARGIN_PX)
    return Sight(q, range_m, inside)
