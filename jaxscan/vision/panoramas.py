"""Panoramas of any program, made ready for a page."""

import re
from typing import NamedTuple

import cv2
import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.vision.images import decode_image
from jaxscan.vision.pictures import encode_jpeg


WIDEST = 4096
"""Pixels of a side that every browser can draw."""
_FIELD = re.compile(rb'GPano:(\w+)(?:="|>)(\d{1,6})["<]')
_ABOUT_BYTES = 200_000
"""Metadata is looked for in so many bytes at the beginning of a file."""


class PagePanorama(NamedTuple):
    """An equirectangular picture of a whole turn, x axis in its middle, azimuth falling to the right."""

    jpeg: bytes
    top: float
    """Elevation of its upper edge [rad]."""
    bottom: float
    """Elevation of its lower edge [rad]."""


def read_panorama(data: bytes, *, name: str) -> PagePanorama:
    """A panorama as JPEG, no wider than browsers can draw.

    Its place on the sphere is that of its metadata (XMP, GPano); without them its middle is on the horizon.

    Args:
        data: The whole file, PNG or JPEG.
        name: The file's name in messages.

    Raises:
        CaptureError: If it is damaged, no picture in colour, or higher than half a turn.
    """
    picture = decode_image(data, name=name, rank=3, size=None)
    rows, columns = picture.shape[:2]
    fields = {key.decode(): int(value) for key, value in _FIELD.findall(data[:_ABOUT_BYTES])}
    full = fields.get("FullPanoHeightPixels", columns // 2)
    above = fields.get("CroppedAreaTopPixels", (full - rows) // 2)
    # A pixel of the horizon is as wide as high; a file that was made smaller afterwards keeps its old numbers.
    scale = fields.get("FullPanoWidthPixels", columns) / columns
    pixel = 2 * np.pi / columns
    top = np.pi / 2 - above / max(scale, 1e-9) * pixel
    bottom = top - rows * pixel
    if rows > columns // 2 + 1 or not -np.pi / 2 - pixel <= bottom < top <= np.pi / 2 + pixel:
        raise CaptureError(
            f"{name}: {columns} x {rows} px is no equirectangular panorama of a whole turn; "
            "`jaxscan panorama CAPTURE -c calibration.json -o room.jpg` makes one."
        )
    if columns > WIDEST:
        picture = cv2.resize(picture, (WIDEST, max(1, round(rows * WIDEST / columns))), interpolation=cv2.INTER_AREA)
    return PagePanorama(encode_jpeg(np.asarray(picture, np.uint8), quality=90), float(top), float(bottom))
