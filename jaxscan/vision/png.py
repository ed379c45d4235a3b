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


def decode_png(data: bytes, out: np.ndarray | None = None) -> np.ndarray | bytes:
    """The pixels of a PNG, after all of the file has been checked. A tRNS chunk is ignored.

    Args:
        data: The whole file. The caller has checked its size.
        out: Filled and returned where it has the shape of the image, whose samples have 8 bits without a palette.

    Returns:
        uint8 [rows, columns], or RGB [rows, columns, 3], where samples have 8 bits and rows are whole. For other kinds
        a PNG with only the chunks that the pixels need, for a decoder.

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
    parts = [(-(-(width - x) // across), -(-(height - y) // down)) for x, across, y, down in passes]
    expected = sum(rows * (1 + (columns * bits + 7) // 8) for columns, rows in parts if columns > 0 and rows > 0)
    inflater = zlib.decompressobj()
    try:
        raw = inflater.decompress(packed, expected + 1)
    except zlib.error as problem:
        raise ValueError(f"its data cannot be unpacked: {problem}") from problem
    if len(raw) != expected or not inflater.eof or inflater.unused_data:
        raise ValueError("its data have another length than its rows")
    if interlaced or depth != 8 or colour not in (0, 2, 3):
        needed = {b"IHDR": data[16:29], b"PLTE": palette.ljust(3 << depth, b"\0"), b"IDAT": packed, b"IEND": b""}
        if colour != 3:
            del needed[b"PLTE"]
        return SIGNATURE + b"".join(_chunk(kind, content) for kind, content in needed.items())
    # Here, because it loads numba.
    from jaxscan.vision.native_loops import unfilter

    channels = _CHANNELS[colour]
    shape = (height, width, channels) if channels > 1 else (height, width)
    if colour == 3 or out is None or out.shape != shape or not out.flags.c_contiguous:
        out = np.empty(shape, np.uint8)
    pixels = out.reshape(height, -1)
    if not unfilter(np.frombuffer(raw, np.uint8).reshape(height, -1), channels, pixels):
        raise ValueError("it has a row with an unknown filter")
    if colour == 3:
        colours = np.frombuffer(palette, np.uint8).reshape(-1, 3)
        if pixels.max() >= len(colours):
            raise ValueError("it has a pixel whose colour is not in its palette")
        return colours[pixels]
    return out


def _chunks(data: bytes) -> dict[bytes, bytes]:
    """Palette and compressed data; every chunk's checksum is compared, and the end must be there."""
    found: dict[bytes, list[memoryview]] = {b"IHDR": [], b"PLTE": [], b"IDAT": []}
    at, view = len(SIGNATURE), memoryview(data)
    while at + 12 <= len(data):
        length, kind = int.from_bytes(view[at : at + 4], "big"), bytes(view[at + 4 : at + 8])
        end = at + 12 + length
        if end > len(data):
            break
        if zlib.crc32(view[at + 4 : end - 4]) != int.from_bytes(view[end - 4 : end], "big"):
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


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
