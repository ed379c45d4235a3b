"""From a stripe centre to a point: unproject, intersect."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxscan.geometry import AbstractCamera, Array, LaserSheet, StripeAxis, stripe_pixel
from jaxscan.reconstruction.settings import ReconstructSettings


class Triangulated(NamedTuple):
    """One stripe centre in space; zero, never NaN, where it is not valid."""

    p_cam: Float[Array, "3"]
    """Point [m], camera frame."""
    range_m: Float[Array, ""]
    """Distance from the camera along the ray [m]."""
    slope: Float[Array, ""]
    """d range / d u [m/px]."""
    incidence: Float[Array, ""]
    """m of `LaserSheet.intersect` [1]."""
    valid: Bool[Array, ""]


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


def triangulate(
    u: Float[Array, ""],
    line: Float[Array, ""],
    camera: AbstractCamera,
    laser: LaserSheet,
    *,
    stripe_axis: StripeAxis = "rows",
    limits: Limits,
) -> Triangulated:
    r"""Intersect the viewing ray of a stripe centre with its laser sheet.

    $p = \frac{d}{m(q)}\, v(q)$, and the slope $\partial\,\mathrm{range} / \partial u$ is the exact
    derivative, through the lens model and the bow of the sheet.

    Args:
        u: Stripe centre across the line [px].
        line: The line's number: image row, or column for `stripe_axis` "columns" [px].
        camera: The camera.
        laser: The sheet that lit the stripe.
        stripe_axis: Whether a line is an image row or an image column.
        limits: Range limits and the smallest incidence.

    Source: the paper, equations (1)-(4).
    """

    def range_at(u):
        ray = camera.unproject(stripe_pixel(u, line, stripe_axis))
        range_m, incidence = laser.intersect(ray)
        return range_m, (ray, incidence)

    range_m, slope, (ray, incidence) = jax.jvp(range_at, (u,), (jnp.ones_like(u),), has_aux=True)
    valid = (incidence >= limits.min_incidence) & (range_m >= limits.min_range_m)
    valid &= range_m <= limits.max_range_m
    kept = jnp.where(valid, range_m, 0.0).astype(range_m.dtype)
    return Triangulated(
        p_cam=kept * ray,
        range_m=kept,
        slope=jnp.where(valid, slope, 0.0).astype(slope.dtype),
        incidence=incidence,
        valid=valid,
    )
