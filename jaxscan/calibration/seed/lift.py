"""Stripe points lifted to the boards they lie on."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxscan.calibration.solve.prepare import Prepared
from jaxscan.compiling import compile_quickly
from jaxscan.geometry import AbstractCamera, Array


class Lifted(NamedTuple):
    """Stripe points in space, camera frame."""

    points: np.ndarray
    """[stripes, points, 3], m."""
    slopes: np.ndarray
    """Derivatives of the points by the pixel, on their boards [stripes, points, 3, 2], m per px."""
    valid: np.ndarray
    """bool [stripes, points]: seen, and on a board before the camera."""


def lift_stripes(data: Prepared, camera: AbstractCamera, poses: np.ndarray, block: int) -> Lifted:
    """Stripe points where their rays meet the flat boards.

    Args:
        data: The stripes.
        camera: The camera.
        poses: T_cam_board of every view [views, 4, 4].
        block: Number of pixels that are turned into rays at a time; each number is compiled once.

    Source: PAPER.md equations (5)-(7).
    """
    pose = poses[data.stripe_view]
    normal = pose[:, None, :3, 2]
    level = np.einsum("si,si->s", pose[:, :3, 2], pose[:, :3, 3])[:, None]

    def meet(step: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
        q = (data.stripe_q + np.array(step)).reshape(-1, 2)
        q = np.concatenate([q, np.broadcast_to(q[:1], (-len(q) % block, 2))])
        rays = [np.asarray(rays_of(camera, part)) for part in np.split(q, len(q) // block)]
        ray = np.concatenate(rays)[: data.stripe_valid.size].reshape(*data.stripe_valid.shape, 3)
        along = np.sum(normal * ray, axis=-1)
        range_m = level / np.where(along == 0, 1.0, along)
        return range_m[..., None] * ray, (along != 0) & (range_m > 0)

    points, ahead = meet((0.0, 0.0))
    slopes = np.stack([meet(step)[0] - points for step in ((1.0, 0.0), (0.0, 1.0))], -1)
    return Lifted(points, slopes, data.stripe_valid & ahead)


@compile_quickly
def rays_of(camera: AbstractCamera, q: Float[Array, "n 2"]) -> Float[Array, "n 3"]:
    """Unit rays of pixels."""
    return jax.vmap(camera.unproject)(jnp.asarray(q))
