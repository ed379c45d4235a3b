"""Stripe centres of a chunk of records to points in the room."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from jaxscan.geometry import AbstractCamera, Array, Scanner
from jaxscan.reconstruction.colour import sample_colour
from jaxscan.reconstruction.settings import ReconstructSettings
from jaxscan.reconstruction.triangulate import stripe_pixel, triangulate
from jaxscan.reconstruction.uncertainty import RangeTable, range_table
from jaxscan.stripes.frames import PixelFormat, StripeAxis
from jaxscan.stripes.shifted import Shifted


class Rig(eqx.Module):
    """What every chunk needs of the scanner, in float32."""

    scanner: Scanner
    table: RangeTable

    @staticmethod
    def of(scanner: Scanner, stripe_axis: StripeAxis) -> "Rig":
        table = range_table(scanner, stripe_axis)
        bare = Scanner(scanner.camera, scanner.lasers, scanner.turntable, None, scanner.laser_names, scanner.up)
        # Host arrays: the same whether or not the caller enabled 64-bit JAX.
        return jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), Rig(bare, table))


class Points(NamedTuple):
    """Fields of `PointCloud` for the records of a chunk, and what goes beside it."""

    xyz: Float[Array, "records lines 3"]
    rgb: UInt8[Array, "records lines 3"]
    intensity: Float[Array, "records lines"]
    sigma_random: Float[Array, "records lines"]
    sigma_systematic: Float[Array, "records lines"]
    valid: Bool[Array, "records lines"]
    centre: Float[Array, "records 3"]
    """Camera centre [m], scanner frame."""
    stripes: Int[Array, " records"]
    """Number of valid stripe centres."""


class Centres(NamedTuple):
    """The fields of `Stripes` that a point is made of."""

    u: Float[Array, "records lines"]
    sigma: Float[Array, "records lines"]
    amplitude: Float[Array, "records lines"]
    valid: Bool[Array, "records lines"]


def locate_points(
    rig: Rig,
    centres: Centres,
    off: UInt8[Array, "records rows columns *colours"] | Shifted | None,
    laser: Int[Array, " records"],
    phi: Float[Array, " records"],
    *,
    pixel_format: PixelFormat,
    stripe_axis: StripeAxis,
    settings: ReconstructSettings,
) -> Points:
    """Points, colours and sigmas of a chunk; pure and traceable.

    Args:
        rig: Scanner and range table, float32.
        centres: Stripe centres.
        off: Laser-off frames, for the colour.
        laser: Which sheet lit each record.
        phi: The table's angle of each record [rad from home].
        pixel_format: How a frame is to be read.
        stripe_axis: What a line is.
        settings: Range limits.
    """
    frames: Array | None
    if isinstance(off, Shifted):
        shifted = off[jnp.arange(len(off), dtype=jnp.int32)]
        frames, view = shifted.lead, lambda lead: Shifted(shifted.memory, lead, shifted.shape)
    else:
        frames, view = off, lambda frame: frame
    lines = centres.u.shape[1]
    line = jnp.arange(lines, dtype=jnp.float32)

    def one(u, sigma, amplitude, valid, number, laser, frame):
        u = jnp.where(valid, u, 0.0).astype(u.dtype)
        found = triangulate(
            u, number, rig.scanner.camera, rig.scanner.laser(laser), stripe_axis=stripe_axis, settings=settings
        )
        exists = valid & found.valid
        systematic = rig.table.sigma(laser, number.astype(jnp.int32), u, found.incidence)
        if frame is None:
            colour: Array = jnp.zeros(3, jnp.uint8)
        else:
            colour = sample_colour(view(frame), stripe_pixel(u, number, stripe_axis), pixel_format)
        values = (found.p_cam, amplitude, jnp.abs(found.slope) * sigma, systematic)
        kept = (jnp.where(exists, value, 0.0).astype(value.dtype) for value in values)
        return *kept, jnp.where(exists, colour, 0).astype(jnp.uint8), exists

    over_lines = jax.vmap(one, (0, 0, 0, 0, 0, None, None))
    over_records = jax.vmap(over_lines, (0, 0, 0, 0, None, 0, 0))
    # GPUs may multiply float32 matrices with 10 bits otherwise.
    with jax.default_matmul_precision("highest"):
        p_cam, intensity, sigma_random, sigma_systematic, rgb, valid = over_records(
            centres.u, centres.sigma, centres.amplitude, centres.valid, line, laser, frames
        )
        pose = jax.vmap(rig.scanner.pose)(phi)
    rotation, centre = pose[:, :3, :3], pose[:, :3, 3]
    turned = sum(p_cam[:, :, None, j] * rotation[:, None, :, j] for j in range(3))
    xyz = jnp.where(valid[:, :, None], turned + centre[:, None, :], 0.0).astype(p_cam.dtype)
    found = jnp.sum(centres.valid, axis=1, dtype=jnp.int32)
    return Points(xyz, rgb, intensity, sigma_random, sigma_systematic, valid, centre, found)


def line_step(camera: AbstractCamera, stripe_axis: StripeAxis) -> float:
    """Angle between neighbouring lines at the middle of the image [rad]."""
    middle = np.array([camera.width, camera.height], np.float32) / 2
    step = np.array([0, 1] if stripe_axis == "rows" else [1, 0], np.float32)
    first, second = (np.asarray(_ray(camera, q)) for q in (middle, middle + step))
    return float(np.linalg.norm(second - first))


@jax.jit
def _ray(camera: AbstractCamera, q: Float[Array, "2"]) -> Array:
    return camera.unproject(q)
