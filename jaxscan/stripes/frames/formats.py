"""How a frame is to be read: pixel format, response, and the laser to look for."""

import re
from dataclasses import dataclass
from typing import Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, UInt8

from jaxscan.geometry import Array
from jaxscan.geometry import StripeAxis as StripeAxis


PixelFormat = Literal["mono8", "rgb8", "bayer_rggb8", "bayer_bggr8", "bayer_grbg8", "bayer_gbrg8"]
PIXEL_FORMATS: tuple[PixelFormat, ...] = ("mono8", "rgb8", "bayer_rggb8", "bayer_bggr8", "bayer_grbg8", "bayer_gbrg8")

Response = str
"""How levels became codes: "linear", "srgb", or "gamma 2.2" with any exponent; see `known_response`."""
RESPONSES = ("linear", "srgb", "gamma 2.2")
"""Examples of all kinds, for messages."""
GAMMAS = (1.0, 4.0)
"""Range of exponents."""

Colour = Literal["red", "green", "blue"]
LaserColour = Literal["auto", "red", "green", "blue"]


@dataclass(frozen=True)
class LaserLine:
    """One laser as the camera sees it."""

    name: str = "laser"
    colour: LaserColour = "red"
    """Which channel of a colour camera holds it, or "auto": learned from the frames
    (`learn_colour`); without meaning for a mono camera."""
    stripe_axis: StripeAxis = "rows"
    """One centre per image row ("rows"), or per image column ("columns")."""


@dataclass(frozen=True)
class FrameFormat:
    """How the pixels of a frame are to be read."""

    pixel_format: PixelFormat = "mono8"
    response: Response = "linear"
    """"linear", or "srgb", or "gamma 2.2": decoded before a stripe is measured, so that levels are linear DN."""


def frame_rank(pixel_format: PixelFormat) -> int:
    """Dimensions of one frame in this format: [rows, columns], or [rows, columns, 3]."""
    return 3 if pixel_format == "rgb8" else 2


def check_frames(on: Array, off: Array | None, pixel_format: PixelFormat, *, exposures: int = 1) -> None:
    """Refuse arrays that are not [frames, ...] of this format, or [frames, exposures, ...] where there are several
    exposures.

    Raises:
        ValueError: If shapes or types do not fit the pixel format.
    """
    rank = 1 + (exposures > 1) + frame_rank(pixel_format)
    if on.ndim != rank or on.dtype != np.uint8:
        raise ValueError(
            f"`on` must be uint8 with {rank} dimensions for {pixel_format}, "
            f"got {on.dtype} with shape {tuple(on.shape)}."
        )
    if off is not None and (off.shape != on.shape or off.dtype != np.uint8):
        raise ValueError(f"`off` must be like `on`, got {off.dtype} with shape {tuple(off.shape)}.")


@dataclass(frozen=True)
class Sites:
    """Which pixels of a frame carry the laser's colour, as a plane [line, sample].

    Sample s of the plane's line k lies at coordinate `offsets[k % len(offsets)] + pitch * s` on
    line `first_line + line_step * k` of the image. Every sample integrates over one pixel,
    whatever the pitch.
    """

    first_line: int = 0
    line_step: int = 1
    offsets: tuple[int, ...] = (0,)
    """Coordinate of the first sample of a line [px]; of two values the first holds for even lines, the second for odd
    ones."""
    pitch: int = 1
    """Distance between samples [px]."""


def laser_sites(pixel_format: PixelFormat, line: LaserLine) -> Sites:
    """Where the laser's colour is measured in frames of this format.

    Raises:
        ValueError: If the pixel format is unknown, or the colour is still to be learned.
    """
    if pixel_format not in PIXEL_FORMATS:
        raise ValueError(f"Unknown pixel format {pixel_format!r}; known: {', '.join(PIXEL_FORMATS)}.")
    if line.colour == "auto" and pixel_format != "mono8":
        raise ValueError(f'The colour of the laser is "auto" and the frames are {pixel_format}: learn it first.')
    if not pixel_format.startswith("bayer"):
        return Sites()
    tile = pixel_format[6:10]
    if line.stripe_axis == "columns":
        tile = tile[0] + tile[2] + tile[1] + tile[3]
    if line.colour == "green":
        return Sites(offsets=(tile[:2].index("g"), tile[2:].index("g")), pitch=2)
    first_line, offset = divmod(tile.index(line.colour[0]), 2)
    return Sites(first_line=first_line, line_step=2, offsets=(offset,), pitch=2)


def laser_plane(frames: Array, *, pixel_format: PixelFormat, line: LaserLine) -> UInt8[Array, "frames lines samples"]:
    """The samples of the laser's colour, one plane per frame, as `laser_sites` places them.

    Args:
        frames: uint8 [frames, rows, columns] (rgb8: and 3).
        line: The laser; where its stripe axis is "columns" the lines are image columns.

    Returns:
        Plane [DN]; a last line or sample that is only half a Bayer tile is left out.
    """
    sites = laser_sites(pixel_format, line)
    if pixel_format == "rgb8":
        frames = frames[..., ("red", "green", "blue").index(str(line.colour))]
    if line.stripe_axis == "columns":
        frames = frames.swapaxes(1, 2)
    if sites.pitch == 1:
        return frames
    rows, columns = frames.shape[1] // 2 * 2, frames.shape[2] // 2 * 2
    frames = frames[:, :rows, :columns]
    if sites.line_step == 2:
        return frames[:, sites.first_line :: 2, sites.offsets[0] :: 2]
    tiles = frames.reshape(len(frames), rows // 2, 2, columns // 2, 2)
    xp = np if isinstance(frames, np.ndarray) else jnp
    lines = xp.stack([tiles[:, :, 0, :, sites.offsets[0]], tiles[:, :, 1, :, sites.offsets[1]]], 2)
    return lines.reshape(len(frames), rows, columns // 2)


def known_response(response: str) -> Response:
    """The response, if there is one of this name.

    Raises:
        ValueError: With the names that there are.
    """
    if response in RESPONSES[:2] or _gamma(response) is not None:
        return response
    raise ValueError(f'found "{response[:60]}", expected "linear", "srgb" or "gamma 2.2", with a number from 1 to 4')


def _gamma(response: str) -> float | None:
    found = re.fullmatch(r"gamma ([0-9](?:\.[0-9]{1,4})?)", response)
    return float(found[1]) if found and GAMMAS[0] <= float(found[1]) <= GAMMAS[1] else None


def decode_table(response: Response) -> tuple[Float[np.ndarray, "256"], Float[np.ndarray, "256"]]:
    """The linear level of each code of a pixel.

    Args:
        response: "linear", "srgb" or "gamma <exponent>".

    Returns:
        level: Linear level [DN], 0 to 255.
        slope: Derivative of the level by the code [DN/code]; it scales the rounding error of the code.

    Raises:
        ValueError: If the response is unknown.

    Source:
        IEC 61966-2-1 (sRGB), transfer function.
    """
    known_response(response)
    code = np.arange(256) / 255.0
    if response == "linear":
        return 255.0 * code, np.ones(256)
    gamma = _gamma(response)
    if gamma is not None:
        return 255.0 * code**gamma, gamma * code ** (gamma - 1.0)
    dark = code <= 0.04045
    level = np.where(dark, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)
    slope = np.where(dark, 1 / 12.92, 2.4 / 1.055 * ((code + 0.055) / 1.055) ** 1.4)
    return 255.0 * level, slope
