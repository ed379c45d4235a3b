"""PNG files, read strictly: every chunk, every checksum and every row, before a pixel is believed.

libpng prints errors of its own to standard error, and gives damaged pictures where it can.
"""

import struct
import zlib

import numpy as np


SIGNATURE = b"\x89PNG\r\n\x1a\n"
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
"""Samples of a pixel by colour type: grey, RGB, palette, grey and alpha, RGB and alpha."""
_DEPTHS = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}
# Start and step of the columns and rows of each pass of Adam7.
_PASSES = ((0, 8, 0, 8), (4, 8, 0, 8), (0, 4, 4, 8), (2, 4, 0, 4), (0, 2, 2, 4), (1, 2, 0, 2), (0, 1, 1, 2))


def png_size(data: bytes) -> tuple[int, int]:
    """Width and height in the header [px].

    Raises:
        ValueError: If it has none.
    """
    if len(data) < 33 or data[12:16] != b"IHDR":
        raise ValueError("it has no header")
    width, height = struct.unpack(">II", data[16:24])
    return width, height


def decode_png(data: bytes) -> np.ndarray | None:
    """The pixels of a PNG with 8-bit samples and whole rows, after all of the file has been checked.

    Args:
        data: The whole file. The caller has checked its size.

    Returns:
        uint8 [rows, columns], or RGB [rows, columns, 3]; None for other kinds, which are as sound.

    Raises:
        ValueError: With the damage.
    """
    width, height = png_size(data)
    depth, colour, _, _, interlaced = data[24:29]
    if width == 0 or height == 0 or depth not in _DEPTHS.get(colour, ()) or interlaced > 1:
        raise ValueError("its header is damaged")
    packed, special = _image_data(data)
    bits = depth * _CHANNELS[colour]
    passes = _PASSES if interlaced else ((0, 1, 0, 1),)
    parts = [(-(-(width - x) // across), -(-(height - y) // down)) for x, across, y, down in passes]
    expected = sum(rows * (1 + (columns * bits + 7) // 8) for columns, rows in parts if columns > 0 and rows > 0)
    inflater = zlib.decompressobj()
    try:
        raw = inflater.decompress(packed, expected + 1)
    except zlib.error as problem:
        raise ValueError(f"its data cannot be unpacked: {problem}") from problem
    if len(raw) != expected or not inflater.eof or inflater.unused_data:
        raise ValueError("its data have another length than its rows")
    if interlaced or depth != 8 or colour not in (0, 2) or special:
        return None
    # Here, because it loads numba.
    from jaxscan.vision.native_loops import unfilter

    channels = _CHANNELS[colour]
    pixels = np.empty((height, width * channels), np.uint8)
    if not unfilter(np.frombuffer(raw, np.uint8).reshape(height, -1), channels, pixels):
        raise ValueError("it has a row with an unknown filter")
    return pixels.reshape(height, width, channels) if channels > 1 else pixels


def _image_data(data: bytes) -> tuple[bytes, bool]:
    """All compressed data, and whether a colour is transparent; every chunk's checksum is compared."""
    parts, special, at, view = [], False, len(SIGNATURE), memoryview(data)
    while at + 12 <= len(data):
        length, kind = int.from_bytes(view[at : at + 4], "big"), bytes(view[at + 4 : at + 8])
        end = at + 12 + length
        if end > len(data):
            break
        if zlib.crc32(view[at + 4 : end - 4]) != int.from_bytes(view[end - 4 : end], "big"):
            raise ValueError(f"the checksum of its part {kind!r:.20} is wrong")
        if kind == b"IDAT":
            parts.append(view[at + 8 : end - 4])
        elif kind == b"IEND":
            return b"".join(parts), special
        special |= kind == b"tRNS"
        at = end
    raise ValueError("it is cut short")
