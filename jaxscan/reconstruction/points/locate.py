"""Stripe centres of a chunk of profiles to points in the room."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxscan.geometry import AbstractCamera, Array, Scanner, StripeAxis, stripe_pixel
from jaxscan.reconstruction.points.triangulate import Limits, triangulate
from jaxscan.reconstruction.points.uncertainty import RangeTable, range_table
from jaxscan.stripes import FrameStripes


class Rig(eqx.Module):
    """The scanner and its range table, in float32; the same for all chunks."""

    scanner: Scanner
    table: RangeTable

    @staticmethod
    def of(scanner: Scanner, stripe_axis: StripeAxis) -> "Rig":
        table = range_table(scanner, stripe_axis)
        # Host arrays: the same whether or not the caller enabled 64-bit JAX.
        return jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), Rig(scanner.without_covariance(), table))


class Aim(NamedTuple):
    """Where the points of one laser go; arrays, so a change compiles nothing."""

    rig: Rig
    laser: Array
    """Which sheet, int32 []."""
    limits: Limits


class Points(NamedTuple):
    """Fields of `PointCloud` for the profiles of a chunk, and their camera centres."""

    xyz: Float[Array, "profiles lines 3"]
    sigma_random: Float[Array, "profiles lines"]
    sigma_systematic: Float[Array, "profiles lines"]
    valid: Bool[Array, "profiles lines"]
    centre: Float[Array, "profiles 3"]
    """Camera centre [m], scanner frame."""


class Centres(NamedTuple):
    """The fields of `Stripes` that a point is made of."""

    u: Float[Array, "profiles lines"]
    sigma: Float[Array, "profiles lines"]
    valid: Bool[Array, "profiles lines"]

    @classmethod
    def of(cls, stripes: FrameStripes) -> "Centres":
        return cls(stripes.u, stripes.sigma, stripes.valid)


def locate_points(aim: Aim, centres: Centres, phi: Float[Array, " profiles"], *, stripe_axis: StripeAxis) -> Points:
    """Points and sigmas of a chunk; pure and traceable.

    Args:
        aim: Rig, laser and limits, float32.
        centres: Stripe centres.
        phi: The table's angle of each profile [rad from home].
        stripe_axis: Whether a line is an image row or an image column.
    """
    rig, limits = aim.rig, aim.limits
    laser = jnp.broadcast_to(aim.laser, (len(phi),))
    lines = centres.u.shape[1]
    line = jnp.arange(lines, dtype=jnp.float32)

    def one(u, sigma, valid, number, laser):
        u = jnp.where(valid, u, 0.0).astype(u.dtype)
        found = triangulate(
            u, number, rig.scanner.camera, rig.scanner.laser(laser), stripe_axis=stripe_axis, limits=limits
        )
        exists = valid & found.valid
        systematic = rig.table.sigma(laser, number.astype(jnp.int32), u, found.incidence)
        values = (found.p_cam, jnp.abs(found.slope) * sigma, systematic)
        return *(jnp.where(exists, value, 0.0).astype(value.dtype) for value in values), exists

    over_lines = jax.vmap(one, (0, 0, 0, 0, None))
    over_profiles = jax.vmap(over_lines, (0, 0, 0, None, 0))
    # GPUs may multiply float32 matrices with 10 bits otherwise.
    with jax.default_matmul_precision("highest"):
        p_cam, sigma_random, sigma_systematic, valid = over_profiles(
            centres.u, centres.sigma, centres.valid, line, laser
        )
        pose = jax.vmap(rig.scanner.pose)(phi)
    rotation, centre = pose[:, :3, :3], pose[:, :3, 3]
    turned = sum(p_cam[:, :, None, j] * rotation[:, None, :, j] for j in range(3))
    xyz = jnp.where(valid[:, :, None], turned + centre[:, None, :], 0.0).astype(p_cam.dtype)
    return Points(xyz, sigma_random, sigma_systematic, valid, centre)


def points_alone(
    aim: Aim, centres: Centres, phi: Float[Array, " profiles"], room: int = 0, *, stripe_axis: StripeAxis
) -> Points:
    """`locate_points`, compiled for `room` profiles at least; NumPy arrays, float32."""
    count = len(phi)
    missing = max(room - count, 0)
    centres = Centres(*(np.pad(np.asarray(field), ((0, missing), (0, 0))) for field in centres))
    phi = np.pad(np.asarray(phi, np.float32), (0, missing))
    # JAX keeps this setting per thread. Single precision, so that the result does not depend on the caller's setting.
    with jax.enable_x64(False):
        points = _compiled(aim, centres, phi, stripe_axis=stripe_axis)
        return jax.tree.map(lambda field: np.asarray(field)[:count], points)


_compiled = jax.jit(locate_points, static_argnames="stripe_axis")


def line_step(camera: AbstractCamera, stripe_axis: StripeAxis) -> float:
    """Angle between neighbouring lines at the middle of the image [rad]."""
    middle = np.array([camera.width, camera.height], np.float32) / 2
    step = stripe_pixel(np.float32(0), np.float32(1), stripe_axis)
    first, second = (np.asarray(_ray(camera, q)) for q in (middle, middle + step))
    return float(np.linalg.norm(second - first))


@jax.jit
def _ray(camera: AbstractCamera, q: Float[Array, "2"]) -> Array:
    return camera.unproject(q)
