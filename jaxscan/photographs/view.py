"""One photograph as points are seen in it: where, and how far away."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxscan.geometry import AbstractCamera, Array, invert, transform


MARGIN_PX = 1.5
"""Nearer to the border of an image no colour is taken: four pixels are needed on each side of a place."""


class Lens(NamedTuple):
    """A camera and the cone of its rays, single precision."""

    camera: AbstractCamera
    """Without its size, for which it would be compiled again."""
    last_px: Float[Array, "2"]
    """The largest (u, v) at which a colour is taken."""
    least_cosine: Float[Array, ""]
    """Cosine of the widest angle between the optical axis and a pixel's ray. Beyond, a lens model may fold back."""
    per_pixel: Float[Array, ""]
    """Angle of a pixel in the middle of the image [rad]."""

    @staticmethod
    def of(camera: AbstractCamera) -> "Lens":
        """The lens of a camera."""
        cosines = border_rays(camera)[:, 2]
        single = jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), camera.without_size())
        last = np.array([camera.width, camera.height], np.float32) - 1 - np.float32(MARGIN_PX)
        focal = max(float(camera.fx), float(camera.fy))
        least, pixel = cosines.min() - 1e-4, 1.0 / focal
        return Lens(single, last, np.asarray(least, np.float32), np.asarray(pixel, np.float32))


class View(NamedTuple):
    """Where a photograph was taken from."""

    lens: Lens
    T_scanner_cam: Float[Array, "4 4"]


class Sight(NamedTuple):
    """Points as a photograph shows them."""

    q: Float[Array, "n 2"]
    """Pixels (u, v)."""
    range_m: Float[Array, " n"]
    """Distances from the camera."""
    inside: Bool[Array, " n"]
    """Whether they lie in the image."""


def border_rays(camera: AbstractCamera) -> Float[np.ndarray, "n 3"]:
    """Unit rays [camera frame] of pixels round the border of the image."""
    columns, rows = np.linspace(0, camera.width - 1, 33), np.linspace(0, camera.height - 1, 33)
    sides = [(columns, rows[:1]), (columns, rows[-1:]), (columns[:1], rows), (columns[-1:], rows)]
    q = np.concatenate([np.stack(np.broadcast_arrays(u, v), -1) for u, v in sides])
    return np.asarray(camera.unproject(q))


@jax.jit
def sights(view: View, points: Float[Array, "n 3"]) -> Sight:
    """Points [scanner frame, m] in a view."""
    p, last = transform(invert(view.T_scanner_cam), points), view.lens.last_px
    range_m = jnp.sqrt(p[:, 0] * p[:, 0] + p[:, 1] * p[:, 1] + p[:, 2] * p[:, 2])
    q = view.lens.camera.project(p)
    inside = (p[:, 2] > view.lens.least_cosine * range_m) & (range_m > 0)
    for k in range(2):
        inside &= (q[:, k] >= MARGIN_PX) & (q[:, k] <= last[k])
    return Sight(q, range_m, inside)
