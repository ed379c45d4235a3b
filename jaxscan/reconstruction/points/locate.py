"""Stripe centres of a chunk of profiles to points in the room."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxscan.geometry import (
    Array,
    Rig,
    Scanner,
    StripeAxis,
    lit_points,
    lit_slopes,
    poses,
    rays,
    stripe_pixel,
    transform,
)
from jaxscan.reconstruction.points.uncertainty import RangeTable, range_table
from jaxscan.reconstruction.settings import ReconstructSettings
from jaxscan.stripes import FrameStripes


class Limits(NamedTuple):
    """Which points are accepted; arrays, so a change compiles nothing."""

    min_range_m: Float[Array, ""]
    max_range_m: Float[Array, ""]
    min_incidence: Float[Array, ""]

    @staticmethod
    def of(settings: ReconstructSettings) -> "Limits":
        """Those of the settings, float32."""
        values = (settings.min_range_m, settings.max_range_m, settings.min_incidence)
        return Limits(*(np.asarray(value, np.float32) for value in values))


class Aim(NamedTuple):
    """Where the points of one laser go; arrays, so a change compiles nothing."""

    rig: Rig
    table: RangeTable
    laser: Array
    """Which sheet, int32 []."""
    limits: Limits

    @staticmethod
    def of(scanner: Scanner, settings: ReconstructSettings, stripe_axis: StripeAxis) -> "Aim":
        """That of the first laser, float32."""
        parts = Aim(scanner.rig, range_table(scanner, stripe_axis), np.zeros((), np.int32), Limits.of(settings))
        # Host arrays: the same whether or not the caller enabled 64-bit JAX.
        single = lambda leaf: leaf if leaf.dtype == np.int32 else np.asarray(leaf, np.float32)
        return jax.tree.map(single, parts)


class Triangulated(NamedTuple):
    """Stripe centres in space; zero, never NaN, where they are not valid."""

    p_cam: Float[Array, "*n 3"]
    """Points [m], camera frame."""
    range_m: Float[Array, "*n"]
    """Distance from the camera along the ray [m]."""
    slope: Float[Array, "*n"]
    """d range / d u [m/px]."""
    incidence: Float[Array, "*n"]
    """m of `LaserSheet.intersect` [1]."""
    valid: Bool[Array, "*n"]


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


def triangulate(
    rig: Rig,
    u: Float[Array, "*n"],
    line: Float[Array, "*n"],
    laser: int | Array,
    *,
    stripe_axis: StripeAxis = "rows",
    limits: Limits,
) -> Triangulated:
    r"""Intersect the viewing rays of stripe centres with their laser sheet.

    $p = \frac{d}{m(q)}\, v(q)$, and the slope $\partial\,\mathrm{range} / \partial u$ is the exact
    derivative, through the lens model and the bow of the sheet.

    Args:
        rig: The rig.
        u: Stripe centres across the line [px].
        line: Numbers of the lines: image rows, or columns for `stripe_axis` "columns" [px].
        laser: Number of the sheet that lit the stripes.
        stripe_axis: Whether a line is an image row or an image column.
        limits: Range limits and the smallest incidence.

    Source: the paper, equations (1)-(4).
    """
    p_cam, incidence = lit_points(rig, stripe_pixel(u, line, stripe_axis), laser)
    range_m = jnp.sqrt(sum(p_cam[..., k] * p_cam[..., k] for k in range(3)))
    by_u = lit_slopes(rig, p_cam, incidence, laser)[..., 0 if stripe_axis == "rows" else 1]
    safe = jnp.where(range_m > 0, range_m, 1.0)
    slope = sum(p_cam[..., k] * by_u[..., k] for k in range(3)) / safe
    valid = (incidence >= limits.min_incidence) & (incidence > 0)
    valid &= (range_m >= limits.min_range_m) & (range_m <= limits.max_range_m)
    kept = lambda value, where: jnp.where(where, value, 0.0).astype(p_cam.dtype)
    return Triangulated(kept(p_cam, valid[..., None]), kept(range_m, valid), kept(slope, valid), incidence, valid)


def locate_points(aim: Aim, centres: Centres, phi: Float[Array, " profiles"], *, stripe_axis: StripeAxis) -> Points:
    """Points and sigmas of a chunk; pure and traceable.

    Args:
        aim: Rig, laser and limits, float32.
        centres: Stripe centres.
        phi: The table's angle of each profile [rad from home].
        stripe_axis: Whether a line is an image row or an image column.
    """
    u = jnp.where(centres.valid, centres.u, 0.0).astype(centres.u.dtype)
    line = jnp.broadcast_to(jnp.arange(u.shape[1], dtype=u.dtype), u.shape)
    found = triangulate(aim.rig, u, line, aim.laser, stripe_axis=stripe_axis, limits=aim.limits)
    valid = centres.valid & found.valid
    exists = lambda value: jnp.where(valid, value, 0.0).astype(u.dtype)
    systematic = aim.table.sigma(aim.laser, line.astype(jnp.int32), u, found.incidence)
    pose = poses(aim.rig, phi)
    xyz = jnp.where(valid[..., None], transform(pose[:, None], found.p_cam), 0.0).astype(u.dtype)
    random = jnp.abs(found.slope) * centres.sigma
    return Points(xyz, exists(random), exists(systematic), valid, pose[:, :3, 3])


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


def line_step(scanner: Scanner, stripe_axis: StripeAxis) -> float:
    """Angle between neighbouring lines at the middle of the image [rad]."""
    middle = np.array([scanner.camera.width, scanner.camera.height]) / 2
    first, second = rays(scanner.rig, np.stack([middle, middle + stripe_pixel(np.zeros(()), np.ones(()), stripe_axis)]))
    return float(np.linalg.norm(second - first))
