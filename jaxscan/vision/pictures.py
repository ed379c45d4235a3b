"""Pictures for people and other programs: JPEG and PNG with what they are written inside."""

import struct
import zlib

import cv2
import numpy as np

from jaxscan.vision.images import encode_png
from jaxscan.vision.png import SIGNATURE


XMP_IN_JPEG = b"http://ns.adobe.com/xap/1.0/\0"
XMP_IN_PNG = b"XML:com.adobe.xmp\0\0\0\0\0"
LARGEST_SEGMENT = 65_533
"""Bytes that a segment of a JPEG can hold."""


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
    """A picture as a PNG file.

    Args:
        image: uint8 [rows, columns(, 3)], or uint16 [rows, columns].
        xmp: XMP packet about the picture.
        about: A sentence on what its values mean, Latin-1.
    """
    if image.dtype == np.uint16:
        _, encoded = cv2.imencode(".png", np.ascontiguousarray(image))
        written = encoded.tobytes()
    else:
        written = encode_png(image)
    chunks = b""
    if xmp:
        chunks += _chunk(b"iTXt", XMP_IN_PNG + xmp.encode())
    if about:
        chunks += _chunk(b"tEXt", b"Description\0" + about.encode("latin-1"))
    after = len(SIGNATURE) + 25
    return written[:after] + chunks + written[after:]


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
