"""What the arrays of a frame mean: pixel format, response, and which laser to look for."""

from dataclasses import dataclass
from typing import Literal


PixelFormat = Literal["mono8", "rgb8", "bayer_rggb8", "bayer_bggr8", "bayer_grbg8", "bayer_gbrg8"]
PIXEL_FORMATS: tuple[PixelFormat, ...] = ("mono8", "rgb8", "bayer_rggb8", "bayer_bggr8", "bayer_grbg8", "bayer_gbrg8")

Response = Literal["linear", "srgb"]
Colour = Literal["red", "green", "blue"]
StripeAxis = Literal["rows", "columns"]


@dataclass(frozen=True)
class LaserLine:
    """One laser as the camera sees it."""

    name: str = "laser"
    colour: Colour = "red"
    """Which channel of a colour camera holds it; without meaning for a mono camera."""
    stripe_axis: StripeAxis = "rows"
    """One centre per image row ("rows"), or per image column ("columns")."""


def frame_rank(pixel_format: PixelFormat) -> int:
    """Dimensions of one frame in this format: [rows, columns], or [rows, columns, 3]."""
    return 3 if pixel_format == "rgb8" else 2
