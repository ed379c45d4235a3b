"""The colour of a point: the laser-off image, sampled at the centre of the stripe."""

import numpy as np
from jaxtyping import Float, UInt8

from jaxscan.geometry import Array, StripeAxis
from jaxscan.stripes import FrameFormat, FrameStripes, PixelFormat


def stripe_colours(
    stripes: FrameStripes, off: Array | None, frames: FrameFormat, stripe_axis: StripeAxis
) -> UInt8[np.ndarray, "profiles lines 3"]:
    """Colour of the laser-off frames at the stripes' centres; black where there are none.

    Args:
        stripes: The stripes; of several profiles per frame those of a frame follow each other.
        off: The laser-off frames, where there are any; of a linear mono camera the fit knows their level already.
    """
    valid = np.asarray(stripes.valid)
    if off is not None and frames != FrameFormat():
        return colours_at(stripes.u, valid, off, frames.pixel_format, stripe_axis)
    grey = np.where(valid, np.clip(np.rint(stripes.grey), 0, 255), 0).astype(np.uint8)
    return np.repeat(grey[..., None], 3, 2)


def colours_at(
    u: Array, valid: Array, off: Array | None, pixel_format: PixelFormat, stripe_axis: StripeAxis
) -> UInt8[np.ndarray, "profiles lines 3"]:
    """Colours of frames at the centres of stripes; black where there are none, or no frames.

    Args:
        u: Stripe centres [profiles, lines]; profiles of a frame follow each other.
        off: Laser-off frames, uint8 [frames, rows, columns] (rgb8: and 3).
    """
    u, valid = np.asarray(u), np.asarray(valid)
    rgb = np.zeros((*u.shape, 3), np.uint8)
    if off is None:
        return rgb
    profile, line = np.nonzero(valid)
    across, along = u[valid], line.astype(np.float32)
    q = np.stack([across, along] if stripe_axis == "rows" else [along, across], -1)
    each = len(u) // len(off)
    rgb[valid] = sample_colours(np.asarray(off), profile // each, q, pixel_format)
    return rgb


def sample_colours(
    frames: UInt8[np.ndarray, "frames ..."],
    which: np.ndarray,
    q: Float[np.ndarray, "n 2"],
    pixel_format: PixelFormat,
) -> UInt8[np.ndarray, "n 3"]:
    """Colours of frames at sub-pixel positions, bilinear, in the frames' own response.

    Args:
        frames: [frames, rows, columns] or, for rgb8, [frames, rows, columns, 3].
        which: Number of the frame of each position.
        q: Positions (u, v) [px]; outside the frame its edge is taken.
        pixel_format: How a frame is to be read. In a Bayer frame every colour is interpolated among its own sites
            only.

    Returns:
        RGB; grey for a mono camera.
    """
    if pixel_format == "mono8":
        colour = np.repeat(_bilinear(frames, which, q, 0, 0, 1)[:, None], 3, 1)
    elif pixel_format == "rgb8":
        colour = _bilinear(frames, which, q, 0, 0, 1)
    else:
        sites = [_bilinear(frames, which, q, row, column, 2) for row in (0, 1) for column in (0, 1)]
        letters = pixel_format.removeprefix("bayer_").removesuffix("8")
        by_colour = [[site for site, letter in zip(sites, letters, strict=True) if letter == c] for c in "rgb"]
        colour = np.stack([sum(found[1:], found[0]) / len(found) for found in by_colour], -1)
    return np.rint(colour).astype(np.uint8)


def _bilinear(frames: np.ndarray, which: np.ndarray, q: np.ndarray, row: int, column: int, spacing: int) -> np.ndarray:
    """Interpolate on the lattice of pixels (row + spacing i, column + spacing j)."""
    rows = (frames.shape[1] - row + spacing - 1) // spacing
    columns = (frames.shape[2] - column + spacing - 1) // spacing
    i, along_v = _cell((q[:, 1] - row) / spacing, rows)
    j, along_u = _cell((q[:, 0] - column) / spacing, columns)
    if frames.ndim == 4:
        along_v, along_u = along_v[:, None], along_u[:, None]

    def at(di: int, dj: int) -> np.ndarray:
        # A lattice of one row or column has no neighbour: its weight there is zero.
        r, c = np.minimum(i + di, rows - 1), np.minimum(j + dj, columns - 1)
        return frames[which, row + spacing * r, column + spacing * c].astype(np.float32)

    upper = (1.0 - along_u) * at(0, 0) + along_u * at(0, 1)
    lower = (1.0 - along_u) * at(1, 0) + along_u * at(1, 1)
    return (1.0 - along_v) * upper + along_v * lower


def _cell(position: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Index of the knot to the left, and the weight of the one to the right."""
    position = np.clip(position, 0.0, count - 1.0).astype(np.float32)
    left = np.minimum(position.astype(np.intp), max(count - 2, 0))
    return left, position - left.astype(np.float32)
