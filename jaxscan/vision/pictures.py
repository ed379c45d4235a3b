"""Pictures for people and other programs: JPEG and PNG with metadata inside, written and read."""

import re
import struct
from typing import NamedTuple

import cv2
import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.vision.images import decode_image, encode_png
from jaxscan.vision.lossless import SIGNATURE, chunk


XMP_IN_JPEG = b"http://ns.adobe.com/xap/1.0/\0"
XMP_IN_PNG = b"XML:com.adobe.xmp\0\0\0\0\0"
LARGEST_SEGMENT = 65_533
"""Bytes that a segment of a JPEG can hold."""
WIDEST = 4096
"""Largest side of a picture that every browser can draw [px]."""
_FIELD = re.compile(rb'GPano:(\w+)(?:="|>)(\d{1,6})["<]')
_ABOUT_BYTES = 200_000
"""Metadata is searched in this many bytes at the beginning of a file."""


def encode_jpeg(image: np.ndarray, *, quality: int = 92, xmp: str = "") -> bytes:
    """A picture as a JPEG file.

    Args:
        image: RGB, uint8 [rows, columns, 3]; at most 65 500 pixels wide or high.
        quality: 1 to 100.
        xmp: XMP packet about the picture.

    Raises:
        ValueError: If the picture or the packet is too large for such a file.
    """
    if max(image.shape[:2]) > 65_500:
        raise ValueError(f"a JPEG holds at most 65 500 px on a side, found {image.shape[1]} x {image.shape[0]}")
    _, data = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality])
    written = data.tobytes()
    if not xmp:
        return written
    segment = XMP_IN_JPEG + xmp.encode()
    if len(segment) > LARGEST_SEGMENT:
        raise ValueError(f"a JPEG holds at most {LARGEST_SEGMENT} bytes of XMP, found {len(segment)}")
    # After the start of the image and the segment of JFIF, which comes first.
    after = 4 + int.from_bytes(written[4:6], "big") if written[2:4] == b"\xff\xe0" else 2
    return written[:after] + b"\xff\xe1" + struct.pack(">H", len(segment) + 2) + segment + written[after:]


def encode_picture_png(image: np.ndarray, *, xmp: str = "", about: str = "") -> bytes:
    """A picture as a PNG file."""
    if image.dtype == np.uint16:
        _, encoded = cv2.imencode(".png", np.ascontiguousarray(image))
        written = encoded.tobytes()
    else:
        written = encode_png(image)
    chunks = b""
    if xmp:
        chunks += chunk(b"iTXt", XMP_IN_PNG + xmp.encode())
    if about:
        chunks += chunk(b"tEXt", b"Description\0" + about.encode("latin-1"))
    after = len(SIGNATURE) + 25
    return written[:after] + chunks + written[after:]


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
    whole = fields.get("FullPanoWidthPixels", 0)
    if (
        fields.get("CroppedAreaImageWidthPixels", whole) < whole
        or rows > columns // 2 + 1
        or not -np.pi / 2 - pixel <= bottom < top <= np.pi / 2 + pixel
    ):
        raise CaptureError(
            f"{name}: {columns} x {rows} px is no equirectangular panorama of a whole turn; "
            "`jaxscan panorama CAPTURE -c calibration.json -o room.jpg` makes one."
        )
    if columns > WIDEST:
        picture = cv2.resize(picture, (WIDEST, max(1, round(rows * WIDEST / columns))), interpolation=cv2.INTER_AREA)
    return PagePanorama(encode_jpeg(np.asarray(picture, np.uint8), quality=90), float(top), float(bottom))
