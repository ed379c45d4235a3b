"""Image files in memory: uint8 arrays to PNG, and PNG, TIFF, JPEG or BMP to uint8 arrays.

OpenCV's BGR order of colours is used in this file only.
"""

import struct

import cv2
import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.geometry import MAX_PIXELS


_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_END = b"IEND\xaeB`\x82"
_PNG_STRATEGIES = {"rle": cv2.IMWRITE_PNG_STRATEGY_RLE, "huffman": cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY}


def encode_png(image: np.ndarray, *, compression: str = "rle") -> bytes:
    """One frame as a PNG file of level 1.

    Sensor noise does not compress further, so higher levels gain nothing. "rle" gives the smallest
    files and the fastest reading; "huffman" encodes in half the time and is 6 % larger.

    Args:
        image: uint8 [rows, columns], or RGB [rows, columns, 3].
        compression: "rle" or "huffman".

    Returns:
        The bytes of the file.

    Raises:
        ValueError: If the array is not such an image or the compression is unknown.
    """
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3):
        raise ValueError(
            f"An image must be uint8 [rows, columns] or [rows, columns, 3], got {image.dtype} with shape {image.shape}."
        )
    if image.size == 0:
        raise ValueError(f"An image must have pixels, got shape {image.shape}.")
    if compression not in _PNG_STRATEGIES:
        raise ValueError(f"Unknown compression {compression!r}; known: {', '.join(_PNG_STRATEGIES)}.")
    strategy = _PNG_STRATEGIES[compression]
    # The level resets the strategy, so it has to come first.
    options = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, strategy]
    pixels = cv2.cvtColor(image, cv2.COLOR_RGB2BGR) if image.ndim == 3 else np.ascontiguousarray(image)
    encoded, data = cv2.imencode(".png", pixels, options)
    if not encoded:
        raise ValueError(f"OpenCV could not encode an image of shape {image.shape}.")
    return data.tobytes()


def decode_image(data: bytes, *, name: str, rank: int, size: tuple[int, int] | None) -> np.ndarray:
    """One frame from the bytes of a PNG, TIFF, JPEG or BMP file.

    Args:
        data: The whole file.
        name: The file's name in messages.
        rank: 2 for grey or raw Bayer, 3 for colour.
        size: Width and height that it must have [px], or None for any.

    Returns:
        uint8 [rows, columns], or RGB [rows, columns, 3].

    Raises:
        CaptureError: If it is damaged, or not an 8-bit image of that size and kind.
    """
    claimed = _claimed_size(data, name)
    if claimed is not None:
        _check_size(claimed, name, size)
    try:
        # "Unchanged" also ignores a rotation in the EXIF data, so pixels keep their places on the sensor.
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise CaptureError(f"{name}: cannot be decoded ({error.err or 'OpenCV gave no reason'}).") from error
    if image is None:
        raise CaptureError(f"{name}: cannot be decoded; the file is damaged or cut short.")
    _check_size((image.shape[1], image.shape[0]), name, size)
    if image.dtype != np.uint8:
        raise CaptureError(f"{name}: found {image.dtype} pixels, expected 8 bit.")
    channels = 1 if image.ndim == 2 else image.shape[2]
    if channels not in (1, 3):
        raise CaptureError(f"{name}: found {channels} channels, expected {1 if rank == 2 else 3}; remove the alpha.")
    if rank == 2 and channels == 3:
        raise CaptureError(f"{name}: found a colour image, expected a grey one (or set pixel_format to rgb8).")
    if rank == 3 and channels == 1:
        raise CaptureError(f"{name}: found a grey image, expected a colour one (rgb8).")
    if channels == 1:
        return image.reshape(image.shape[:2])
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def _check_size(found: tuple[int, int], name: str, expected: tuple[int, int] | None) -> None:
    width, height = found
    if expected is not None and found != expected:
        raise CaptureError(f"{name}: found {width} x {height} px, expected {expected[0]} x {expected[1]} px.")
    if width * height > MAX_PIXELS:
        raise CaptureError(f"{name}: found {width} x {height} px, more than {MAX_PIXELS // 1_000_000} megapixels.")


def _claimed_size(data: bytes, name: str) -> tuple[int, int] | None:
    """Width and height in the file's header, read before the decoder allocates memory; None if not found.

    Old decoders fill the missing end of a PNG or JPEG with grey, so the end of the file is checked too.
    """
    cut = CaptureError(f"{name}: cannot be decoded; the file is damaged or cut short.")
    if data[:8] == _PNG_SIGNATURE:
        if len(data) < 33 or data[12:16] != b"IHDR" or _PNG_END not in data[-1024:]:
            raise cut
        width, height = struct.unpack(">II", data[16:24])
        return width, height
    if data[:2] == b"BM":
        if len(data) < 26:
            raise cut
        width, height = struct.unpack("<ii", data[18:26])
        return abs(width), abs(height)
    if data[:3] == b"\xff\xd8\xff":
        if b"\xff\xd9" not in data[-4096:]:
            raise cut
        return _jpeg_size(data)
    if data[:4] in (b"II*\0", b"MM\0*"):
        return _tiff_size(data)
    raise CaptureError(
        f"{name}: found {'an empty file' if not data else 'an unknown kind of file'}, expected PNG, TIFF, JPEG or BMP."
    )


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    at = 2
    while at + 9 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        # Start of frame, in all its variants; C4, C8 and CC mean something else.
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack(">HH", data[at + 5 : at + 9])
            return width, height
        at += 1 if marker == 0xFF else 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return None


def _tiff_size(data: bytes) -> tuple[int, int] | None:
    order = "<" if data[:2] == b"II" else ">"
    found: dict[int, int] = {}
    if len(data) < 8:
        return None
    (start,) = struct.unpack(order + "I", data[4:8])
    (count,) = struct.unpack(order + "H", data[start : start + 2]) if start + 2 <= len(data) else (0,)
    for at in range(start + 2, min(start + 2 + 12 * count, len(data) - 11), 12):
        tag, kind = struct.unpack(order + "HH", data[at : at + 4])
        if tag in (256, 257) and kind in (3, 4):
            (found[tag],) = struct.unpack_from(order + ("H" if kind == 3 else "I"), data, at + 8)
    return (found[256], found[257]) if len(found) == 2 else None
