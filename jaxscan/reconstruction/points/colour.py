"""The colour of a point: the laser-off image, sampled at the stripe's centre."""

import functools

import jax
import jax.numpy as jnp
from jaxtyping import Float, UInt8

from jaxscan.geometry import Array, StripeAxis, stripe_pixel
from jaxscan.stripes import FrameFormat, FrameStripes, PixelFormat


def sample_colour(frame: UInt8[Array, "..."], q: Float[Array, "2"], pixel_format: PixelFormat) -> UInt8[Array, "3"]:
    """Colour of a frame at a sub-pixel position, bilinear, in the frame's own response.

    Args:
        frame: Laser-off frame [rows, columns] or, for rgb8, [rows, columns, 3].
        q: Position (u, v) [px]; outside the frame its edge is taken.
        pixel_format: How the frame is to be read. Of a Bayer frame every colour is interpolated
            among its own sites only.

    Returns:
        RGB; grey for a mono camera.
    """
    if pixel_format == "mono8":
        grey = _bilinear(frame, q, 0, 0, 1)
        colour: Array = jnp.stack([grey, grey, grey])
    elif pixel_format == "rgb8":
        colour = _bilinear(frame, q, 0, 0, 1)
    else:
        sites = [_bilinear(frame, q, row, column, 2) for row in (0, 1) for column in (0, 1)]
        letters = pixel_format.removeprefix("bayer_").removesuffix("8")
        by_colour = [[site for site, letter in zip(sites, letters, strict=True) if letter == c] for c in "rgb"]
        colour = jnp.stack([sum(found[1:], found[0]) / len(found) for found in by_colour])
    return jnp.round(colour).astype(jnp.uint8)


def _bilinear(frame: Array, q: Array, row: int, column: int, spacing: int) -> Array:
    """Interpolate on the lattice of pixels (row + spacing i, column + spacing j)."""
    rows = (frame.shape[0] - row + spacing - 1) // spacing
    columns = (frame.shape[1] - column + spacing - 1) // spacing
    i, along_v = _cell((q[1] - row) / spacing, rows)
    j, along_u = _cell((q[0] - column) / spacing, columns)

    def at(di, dj):
        # A lattice of one row or column has no neighbour: its weight there is zero.
        r, c = jnp.minimum(i + di, rows - 1), jnp.minimum(j + dj, columns - 1)
        r, c = row + spacing * r, column + spacing * c
        return jnp.asarray(frame).at[r, c].get(mode="promise_in_bounds").astype(q.dtype)

    upper = (1.0 - along_u) * at(0, 0) + along_u * at(0, 1)
    lower = (1.0 - along_u) * at(1, 0) + along_u * at(1, 1)
    return (1.0 - along_v) * upper + along_v * lower


def _cell(position: Array, count: int) -> tuple[Array, Array]:
    """Index of the knot to the left, and the weight of the one to the right."""
    position = jnp.clip(position, 0.0, count - 1.0).astype(position.dtype)
    left = jnp.minimum(position.astype(jnp.int32), max(count - 2, 0))
    return left, position - left.astype(position.dtype)


def stripe_colours(
    stripes: FrameStripes, off: UInt8[Array, "frames ..."] | None, *, frames: FrameFormat, stripe_axis: StripeAxis
) -> UInt8[Array, "profiles lines 3"]:
    """Colour of the laser-off frames at the stripes' centres; black where there are none.

    Args:
        stripes: The stripes; of several profiles per frame those of a frame follow each other.
        off: The laser-off frames, which are looked at where `needs_frames` says so.
        frames: How a frame is to be read.
        stripe_axis: Whether a line is an image row or an image column.
    """
    if off is not None and needs_frames(frames):
        colour = sample_colours(stripes.u, off, pixel_format=frames.pixel_format, stripe_axis=stripe_axis)
    else:
        grey = jnp.clip(jnp.round(stripes.grey), 0, 255).astype(jnp.uint8)
        colour = jnp.broadcast_to(grey[:, :, None], (*grey.shape, 3))
    return jnp.where(stripes.valid[:, :, None], colour, 0).astype(jnp.uint8)


def sample_colours(
    u: Float[Array, "profiles lines"],
    off: UInt8[Array, "frames ..."],
    *,
    pixel_format: PixelFormat,
    stripe_axis: StripeAxis,
) -> UInt8[Array, "profiles lines 3"]:
    """Colour of the frames at the centres `u`; profiles of a frame follow each other."""
    lines = u.shape[1]
    line = jnp.arange(lines, dtype=jnp.float32)

    def one(u, line, frame):
        return sample_colour(frame, stripe_pixel(u, line, stripe_axis), pixel_format)

    over_lines = jax.vmap(one, (0, 0, None))
    over_profiles = jax.vmap(over_lines, (0, None, None))
    colour = jax.vmap(over_profiles, (0, None, 0))(u.reshape(len(off), -1, lines), line, off)
    return colour.reshape(*u.shape, 3)


def needs_frames(frames: FrameFormat) -> bool:
    """Whether a colour takes more than the level that the fit of a stripe knows already."""
    return frames != FrameFormat()


@functools.partial(jax.jit, static_argnames=("pixel_format", "stripe_axis"))
def colours_alone(
    u: Array, valid: Array, off: Array | None, *, pixel_format: PixelFormat, stripe_axis: StripeAxis
) -> Array:
    """Colours at the centres `u` [profiles, lines] of known stripes; black where there are none, or no frames."""
    if off is None:
        return jnp.zeros((*u.shape, 3), jnp.uint8)
    u = jnp.where(valid, u, 0.0)
    colour = sample_colours(u, off, pixel_format=pixel_format, stripe_axis=stripe_axis)
    return jnp.where(valid[:, :, None], colour, 0).astype(jnp.uint8)
