"""Image files in memory: uint8 arrays to PNG, and PNG, packed frames, TIFF, JPEG or BMP to uint8 arrays.

OpenCV's BGR order of colours is used in this file only.
"""

import re
import struct
from collections.abc import Callable

import cv2
import numpy as np

from jaxscan.errors import CaptureError, DependencyError
from jaxscan.geometry import MAX_PIXELS
from jaxscan.vision.frames import check_frame
from jaxscan.vision.lossless import SIGNATURE, OtherKind, Tiff, check_png, png_size
from jaxscan.vision.zstd import MAGIC, decode_zstd, zstd_size


# Failures are raised as one line; OpenCV would also print them.
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)


def encode_png(image: np.ndarray) -> bytes:
    """One frame as a PNG file of level 1: sensor noise does not compress further.

    Raises:
        ValueError: If the array is not such an image.
    """
    check_frame(image)
    # The level resets the strategy, so it has to come first.
    options = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]
    pixels = cv2.cvtColor(image, cv2.COLOR_RGB2BGR) if image.ndim == 3 else np.ascontiguousarray(image)
    encoded, data = cv2.imencode(".png", pixels, options)
    if not encoded:
        raise ValueError(f"OpenCV could not encode an image of shape {image.shape}.")
    return data.tobytes()


def through_jpeg(image: np.ndarray, quality: int) -> np.ndarray:
    """A frame that was compressed to a JPEG and unpacked again.

    Returns:
        uint8 of the same shape.
    """
    pixels = cv2.cvtColor(image, cv2.COLOR_RGB2BGR) if image.ndim == 3 else np.ascontiguousarray(image)
    _, data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])
    back = np.asarray(cv2.imdecode(data, cv2.IMREAD_UNCHANGED))
    return np.asarray(cv2.cvtColor(back, cv2.COLOR_BGR2RGB) if image.ndim == 3 else back, np.uint8)


def decode_image(
    data: bytes,
    *,
    name: str,
    rank: int | None,
    size: tuple[int, int] | None,
    out: np.ndarray | None = None,
    deep: bool = False,
) -> np.ndarray:
    """One frame from the bytes of a PNG, packed (`encode_zstd`), TIFF, JPEG or BMP file; a damaged file is refused.

    Damage is not noticed where nothing in the file could tell: other bytes in a BMP or in a TIFF that is not packed
    by Deflate, if the lengths still fit, and other codes in a JPEG that mean something.

    Args:
        data: The whole file.
        name: The file's name in messages.
        rank: 2 for grey or raw Bayer, 3 for colour, or None for any.
        size: Width and height that it must have [px], or None for any.
        out: Memory for the image; used, filled and returned where it has its shape and the decoder can fill it.
        deep: Whether samples may have 16 bits.

    Returns:
        uint8 [rows, columns], or RGB [rows, columns, 3]; with `deep` perhaps uint16.

    Raises:
        CaptureError: If it is damaged, or not an image of that size and kind.
    """
    kind = _kind(data, name)
    try:
        _check_size(_SIZES[kind](data), name, size)
        image = _DECODERS[kind](data, out)
    except OtherKind as problem:
        raise CaptureError(f"{name}: {problem}.") from problem
    except ValueError as problem:
        raise CaptureError(f"{name}: cannot be decoded; the file is damaged: {problem}.") from problem
    _check_size((image.shape[1], image.shape[0]), name, size)
    if image.dtype != np.uint8 and not (deep and image.dtype == np.uint16):
        cure = "`jaxscan import` reads such frames" if image.dtype == np.uint16 else "convert it to 8 or 16 bits"
        raise CaptureError(f"{name}: found {image.dtype} pixels, expected 8 bit; {cure}.")
    channels = 1 if image.ndim == 2 else image.shape[2]
    if channels not in (1, 3):
        expected = {2: "1", 3: "3"}.get(rank or 0, "1 or 3")
        raise CaptureError(
            f"{name}: found {channels} channels, expected {expected}; an alpha channel with transparent pixels must go."
        )
    if rank == 2 and channels == 3:
        raise CaptureError(f"{name}: found a colour image, expected a grey one (or set pixel_format to rgb8).")
    if rank == 3 and channels == 1:
        raise CaptureError(f"{name}: found a grey image, expected a colour one (rgb8).")
    return image.reshape(image.shape[:2]) if channels == 1 and image.ndim == 3 else image


def is_jpeg(data: bytes) -> bool:
    """Whether the bytes are those of a JPEG file."""
    return data.startswith(_BEGINNINGS["JPEG"])


def _check_size(found: tuple[int, int], name: str, expected: tuple[int, int] | None) -> None:
    width, height = found
    if expected is not None and found != expected:
        raise CaptureError(f"{name}: found {width} x {height} px, expected {expected[0]} x {expected[1]} px.")
    if width < 1 or height < 1:
        raise CaptureError(f"{name}: found {width} x {height} px; the file is damaged.")
    if width * height > MAX_PIXELS:
        raise CaptureError(f"{name}: found {width} x {height} px, more than {MAX_PIXELS // 1_000_000} megapixels.")


def _kind(data: bytes, name: str) -> str:
    for kind, beginnings in _BEGINNINGS.items():
        if data.startswith(beginnings):
            return kind
    if not data:
        raise CaptureError(f"{name}: found an empty file, expected PNG, TIFF, JPEG or BMP.")
    other = next((one for one, sign in _OTHERS.items() if re.match(sign, data, re.DOTALL)), "an unknown kind of file")
    raise CaptureError(f"{name}: found {other}, expected PNG, TIFF, JPEG or BMP; convert it.")


def _bmp_size(data: bytes) -> tuple[int, int]:
    if len(data) < 30:
        raise ValueError("it is cut short")
    width, height = struct.unpack("<ii", data[18:26])
    # A negative height means that the first row comes first.
    return width, abs(height)


def _jpeg_size(data: bytes) -> tuple[int, int]:
    """Size in the frame's header; every segment before it must follow the last at once."""
    at = 2
    while at + 9 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        # Start of frame, in all its variants; C4, C8 and CC mean something else.
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            if data[at + 4] != 8 or marker > 0xC2:
                kind = f"{data[at + 4]} bits" if data[at + 4] != 8 else "lossless or arithmetic coding"
                raise OtherKind(f"found a JPEG of {kind}, expected one of 8 bits in the usual coding; convert it")
            height, width = struct.unpack(">HH", data[at + 5 : at + 9])
            return width, height
        at += 1 if marker == 0xFF else 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    raise ValueError("its size was not found")


def _decode_jpeg(data: bytes, out: np.ndarray | None = None) -> np.ndarray:
    """Pixels of a JPEG; warnings of libjpeg, such as missing data, are errors."""
    try:
        import simplejpeg
    except ImportError as problem:
        raise DependencyError("JPEG images need simplejpeg: pip install simplejpeg") from problem
    if b"\xff\xd9" not in data[-4096:]:
        raise ValueError("it is cut short")
    # Versions of the library spell it in different ways.
    space = str(simplejpeg.decode_jpeg_header(data)[2]).upper()
    if space not in ("GRAY", "YCBCR", "RGB"):
        raise OtherKind(f"found the colours {space:.20}, expected grey or RGB; convert it to RGB")
    return np.asarray(simplejpeg.decode_jpeg(data, "GRAY" if space == "GRAY" else "RGB"))


def _decode_tiff(data: bytes, out: np.ndarray | None = None) -> np.ndarray:
    tiff = Tiff.of(data)
    tiff.check()
    try:
        return _by_opencv(data)
    except ValueError as problem:
        if tiff.is_known_packing():
            raise
        raise OtherKind("found a way of packing that is not read; save it without, or with LZW or Deflate") from problem


def _by_opencv(data: bytes, out: np.ndarray | None = None) -> np.ndarray:
    """Pixels as stored; also a rotation in the EXIF data is ignored, so that pixels keep their places on the sensor."""
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as problem:
        raise ValueError(f"{problem.err or 'OpenCV gave no reason'}"[:200]) from problem
    if image is None:
        raise ValueError("OpenCV cannot read it")
    if image.ndim == 3 and image.shape[2] == 4 and np.issubdtype(image.dtype, np.integer):
        # An alpha channel that is opaque everywhere says nothing.
        image = image[..., :3] if image[..., 3].min() == np.iinfo(image.dtype).max else image
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB) if image.ndim == 3 and image.shape[2] == 3 else image


_OTHERS = {
    "HEIC or AVIF": rb"....ftyp(?:heic|heix|hevc|mif1|msf1|heim|heis|avif)",
    "WebP": rb"RIFF....WEBP",
    "GIF": rb"GIF8",
    "JPEG 2000": rb"\0\0\0\x0cjP  |\xff\x4f\xff\x51",
    "JPEG XL": rb"\xff\x0a|\0\0\0\x0cJXL ",
    "PGM or PPM": rb"P[2356]\s",
    "OpenEXR": rb"\x76\x2f\x31\x01",
    "FITS": rb"SIMPLE  =",
    "BigTIFF": rb"II\+\0|MM\0\+",
    "a raw file of Canon": rb"....ftypcrx",
}
"""Kinds that are known by their first bytes, and not read."""
_BEGINNINGS: dict[str, bytes | tuple[bytes, ...]] = {
    "PNG": SIGNATURE,
    "BMP": b"BM",
    "JPEG": b"\xff\xd8\xff",
    "TIFF": (b"II*\0", b"MM\0*"),
    "packed": MAGIC,
}
# Each reads the size before a decoder takes memory for it.
_SIZES: dict[str, Callable[[bytes], tuple[int, int]]] = {
    "PNG": png_size,
    "BMP": _bmp_size,
    "JPEG": _jpeg_size,
    "TIFF": lambda data: Tiff.of(data).size(),
    "packed": zstd_size,
}
# Some fill the memory that they are given, if it has the shape of the image.
_DECODERS: dict[str, Callable[[bytes, np.ndarray | None], np.ndarray]] = {
    "PNG": lambda data, out: _by_opencv(check_png(data)),
    "BMP": _by_opencv,
    "JPEG": _decode_jpeg,
    "TIFF": _decode_tiff,
    "packed": decode_zstd,
}
