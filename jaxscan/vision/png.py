"""PNG files, checked before OpenCV decodes them: every chunk, every checksum and every length.

libpng prints errors of its own to standard error, and gives damaged pictures where it can.
"""

import struct
import zlib

import numpy as np
from isal import isal_zlib


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


def check_png(data: bytes) -> tuple[bytes, np.ndarray | None]:
    """Check a whole PNG and unpack it, so that a decoder has only the filters of its rows to undo.

    Args:
        data: The whole file. The caller has checked its size.

    Returns:
        The PNG, unpacked, with no chunks but those that its pixels need; and its palette, RGB uint8 [colours, 3], or
        None. With a palette the PNG is a grey image, whose levels are the numbers of the colours.

    Raises:
        ValueError: With the damage.
    """
    width, height = png_size(data)
    depth, colour, packing, filtering, interlaced = data[24:29]
    if depth not in _DEPTHS.get(colour, ()) or packing or filtering or interlaced > 1:
        raise ValueError("its header is damaged")
    chunks = _chunks(data)
    packed, palette = chunks[b"IDAT"], chunks[b"PLTE"]
    if len(palette) % 3 or (colour == 3 and not 3 <= len(palette) <= 3 << depth):
        raise ValueError("its palette is damaged")
    bits = depth * _CHANNELS[colour]
    passes = _PASSES if interlaced else ((0, 1, 0, 1),)
    parts = [(-(-(height - y) // down), -(-(width - x) // across)) for x, across, y, down in passes]
    shapes = [(rows, 1 + (columns * bits + 7) // 8) for rows, columns in parts if columns > 0 and rows > 0]
    expected = sum(rows * length for rows, length in shapes)
    inflater = isal_zlib.decompressobj()
    try:
        raw = inflater.decompress(packed, expected + 1)
    except isal_zlib.error as problem:  # type: ignore[misc]  # Its stub calls the class an exception.
        raise ValueError(f"its data cannot be unpacked: {problem}") from problem
    if len(raw) != expected or not inflater.eof or inflater.unused_data:
        raise ValueError("its data have another length than its rows")
    start = 0
    for rows, length in shapes:
        filters = np.frombuffer(raw, np.uint8, rows * length, start)[::length]
        if filters.max() > 4:
            raise ValueError("it has a row with an unknown filter")
        start += rows * length
    header = struct.pack(">IIBBBBB", width, height, depth, 0 if colour == 3 else colour, 0, 0, interlaced)
    unpacked = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(raw, 0)) + chunk(b"IEND", b"")
    colours = np.frombuffer(palette, np.uint8).reshape(-1, 3) if colour == 3 else None
    return SIGNATURE + unpacked, colours


def _chunks(data: bytes) -> dict[bytes, bytes]:
    """Palette and compressed data; every chunk's checksum is compared, and the end must be there."""
    found: dict[bytes, list[memoryview]] = {b"IHDR": [], b"PLTE": [], b"IDAT": []}
    at, view = len(SIGNATURE), memoryview(data)
    while at + 12 <= len(data):
        length, kind = int.from_bytes(view[at : at + 4], "big"), bytes(view[at + 4 : at + 8])
        end = at + 12 + length
        if end > len(data):
            break
        if isal_zlib.crc32(view[at + 4 : end - 4]) != int.from_bytes(view[end - 4 : end], "big"):
            raise ValueError(f"the checksum of its part {kind!r:.20} is wrong")
        if kind == b"IEND":
            if len(found[b"IHDR"]) != 1 or len(found[b"PLTE"]) > 1:
                raise ValueError("a part is there twice")
            return {name: b"".join(parts) for name, parts in found.items()}
        if kind in found:
            found[kind].append(view[at + 8 : end - 4])
        elif not kind.isalpha() or kind[:1].isupper():
            raise ValueError(f"its part {kind!r:.20} is unknown")
        at = end
    raise ValueError("it is cut short")


def chunk(kind: bytes, content: bytes) -> bytes:
    """A part of a PNG file, with its length and its checksum."""
    checksum = isal_zlib.crc32(content, isal_zlib.crc32(kind))
    return b"".join((struct.pack(">I", len(content)), kind, content, struct.pack(">I", checksum)))
