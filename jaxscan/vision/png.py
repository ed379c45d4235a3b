"""PNG files, checked before OpenCV decodes them: every chunk, every checksum and every length.

libpng prints errors of its own to standard error, and gives damaged pictures where it can.
"""

import struct
import zlib

from isal import isal_zlib


SIGNATURE = b"\x89PNG\r\n\x1a\n"
_CHANNELS = {0: 1, 2: 3, 4: 2, 6: 4}
"""Samples of a pixel by colour type: grey, RGB, grey and alpha, RGB and alpha."""
_DEPTHS = {0: (1, 2, 4, 8, 16), 2: (8, 16), 4: (8, 16), 6: (8, 16)}
_PALETTE = 3


class OtherKind(ValueError):
    """A picture that is undamaged, but of a kind that is not read."""


def png_size(data: bytes) -> tuple[int, int]:
    """Width and height in the header [px].

    Raises:
        ValueError: If it has none.
    """
    if len(data) < 33 or data[12:16] != b"IHDR":
        raise ValueError("it has no header")
    width, height = struct.unpack(">II", data[16:24])
    return width, height


def check_png(data: bytes) -> bytes:
    """Check a whole PNG and unpack it, so that a decoder has only the filters of its rows to undo.

    Returns:
        The PNG, unpacked, with no chunks but those that its pixels need.

    Raises:
        ValueError: With the damage.
    """
    width, height = png_size(data)
    depth, colour, packing, filtering, interlaced = data[24:29]
    if colour == _PALETTE or interlaced == 1:
        kind = "an interlaced PNG" if interlaced else "a PNG with a palette"
        raise OtherKind(f"found {kind}, expected a plain one of grey or RGB; convert it")
    if depth not in _DEPTHS.get(colour, ()) or packing or filtering or interlaced:
        raise ValueError("its header is damaged")
    line = 1 + (width * depth * _CHANNELS[colour] + 7) // 8
    inflater = isal_zlib.decompressobj()
    try:
        raw = inflater.decompress(_packed(data), height * line + 1)
    except isal_zlib.error as problem:  # type: ignore[misc]  # Its stub calls the class an exception.
        raise ValueError(f"its data cannot be unpacked: {problem}") from problem
    if len(raw) != height * line or not inflater.eof or inflater.unused_data:
        raise ValueError("its data have another length than its rows")
    if max(raw[::line]) > 4:
        raise ValueError("it has a row with an unknown filter")
    return SIGNATURE + chunk(b"IHDR", data[16:29]) + chunk(b"IDAT", zlib.compress(raw, 0)) + chunk(b"IEND", b"")


def _packed(data: bytes) -> bytes:
    """The compressed data; every chunk's checksum is compared, and the end must be there."""
    parts, headers = list[memoryview](), 0
    at, view = len(SIGNATURE), memoryview(data)
    while at + 12 <= len(data):
        length, kind = int.from_bytes(view[at : at + 4], "big"), bytes(view[at + 4 : at + 8])
        end = at + 12 + length
        if end > len(data):
            break
        if isal_zlib.crc32(view[at + 4 : end - 4]) != int.from_bytes(view[end - 4 : end], "big"):
            raise ValueError(f"the checksum of its part {kind!r:.20} is wrong")
        headers += kind == b"IHDR"
        if kind == b"IEND" and headers == 1:
            return b"".join(parts)
        if kind == b"IDAT":
            parts.append(view[at + 8 : end - 4])
        elif kind not in (b"IHDR", b"PLTE") and (not kind.isalpha() or kind[:1].isupper()):
            raise ValueError(f"its part {kind!r:.20} is unknown")
        at = end
    raise ValueError("it is cut short")


def chunk(kind: bytes, content: bytes) -> bytes:
    """A part of a PNG file, with its length and its checksum."""
    checksum = isal_zlib.crc32(content, isal_zlib.crc32(kind))
    return b"".join((struct.pack(">I", len(content)), kind, content, struct.pack(">I", checksum)))
