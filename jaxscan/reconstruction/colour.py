"""The colour of a point: the laser-off image, sampled at the stripe's centre."""

import jax.numpy as jnp
from jaxtyping import Float, UInt8

from jaxscan.geometry import Array
from jaxscan.stripes.frames import PixelFormat
from jaxscan.stripes.shifted import Frames, Shifted


def sample_colour(
    frame: UInt8[Array, "..."] | Shifted, q: Float[Array, "2"], pixel_format: PixelFormat
) -> UInt8[Array, "3"]:
    """Colour of a frame at a sub-pixel position, bilinear, in the frame's own response.

    Args:
        frame: Laser-off frame [rows, columns] (`Shifted`, too) or, for rgb8, [rows, columns, 3].
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


def _bilinear(frame: Frames, q: Array, row: int, column: int, spacing: int) -> Array:
    """Interpolate on the lattice of pixels (row + spacing i, column + spacing j)."""
    rows = (frame.shape[0] - row + spacing - 1) // spacing
    columns = (frame.shape[1] - column + spacing - 1) // spacing
    i, along_v = _cell((q[1] - row) / spacing, rows)
    j, along_u = _cell((q[0] - column) / spacing, columns)

    def at(di, dj):
        # A lattice of one row or column has no neighbour: its weight there is zero.
        r, c = jnp.minimum(i + di, rows - 1), jnp.minimum(j + dj, columns - 1)
        r, c = row + spacing * r, column + spacing * c
        if isinstance(frame, Shifted):
            return frame.pixel(r, c).astype(q.dtype)
        return jnp.asarray(frame).at[r, c].get(mode="promise_in_bounds").astype(q.dtype)

    upper = (1.0 - along_u) * at(0, 0) + along_u * at(0, 1)
    lower = (1.0 - along_u) * at(1, 0) + along_u * at(1, 1)
    return (1.0 - along_v) * upper + along_v * lower


def _cell(position: Array, count: int) -> tuple[Array, Array]:
    """Index of the knot to the left, and the weight of the one to the right."""
    position = jnp.clip(position, 0.0, count - 1.0).astype(position.dtype)
    left = jnp.minimum(position.astype(jnp.int32), max(count - 2, 0))
    return left, position - left.astype(position.dtype)
