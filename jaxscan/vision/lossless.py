"""PNG and TIFF files, checked before OpenCV decodes them; of a PNG every chunk, every checksum and every length.

libpng prints errors of its own to standard error, and gives damaged pictures where it can.
"""

import struct
import zlib
from typing import NamedTuple

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


# TIFF files, checked before OpenCV decodes them: libtiff gives a picture even where the data are damaged.


_SHORT, _LONG = 3, 4
_WIDTH, _HEIGHT, _BITS, _COMPRESSION, _FILL_ORDER, _STRIPS, _SAMPLES = 256, 257, 258, 259, 266, 273, 277
_ROWS_PER_STRIP, _STRIP_BYTES, _PLANAR = 278, 279, 284
_PHOTOMETRIC, _SEPARATED = 262, 5
_TILE_WIDTH, _TILE_HEIGHT, _TILES, _TILE_BYTES = 322, 323, 324, 325
_NONE, _LZW, _PACKBITS, _DEFLATE = 1, 5, 32773, (8, 32946)
_MOST_ENTRIES = 1 << 20
_MOST_SAMPLES = 4


class Tiff(NamedTuple):
    """The first picture of a TIFF file."""

    data: bytes
    order: str
    """Order of the bytes, in the letters of `struct`."""
    fields: dict[int, tuple[int, int, int]]
    """Type, count and place of the values of each tag."""

    @staticmethod
    def of(data: bytes) -> "Tiff":
        """Read the directory.

        Raises:
            ValueError: If it is damaged.
        """
        order = "<" if data[:2] == b"II" else ">"
        if len(data) < 8:
            raise ValueError("it is cut short")
        (start,) = struct.unpack(order + "I", data[4:8])
        if start + 2 > len(data):
            raise ValueError("its directory lies outside the file")
        (count,) = struct.unpack_from(order + "H", data, start)
        if start + 2 + 12 * count > len(data):
            raise ValueError("its directory is cut short")
        fields: dict[int, tuple[int, int, int]] = {}
        for at in range(start + 2, start + 2 + 12 * count, 12):
            tag, kind, values = struct.unpack_from(order + "HHI", data, at)
            if tag in fields:
                raise ValueError(f"its tag {tag} is there twice")
            fields[tag] = (kind, values, at + 8)
        return Tiff(data, order, fields)

    def size(self) -> tuple[int, int]:
        """Width and height [px].

        Raises:
            ValueError: If they are not there as one whole number each.
        """
        return self._one(_WIDTH), self._one(_HEIGHT)

    def check(self) -> None:
        """Check that all strips or tiles lie in the file, and that those of Deflate unpack to their rows.

        Other data have no checksum, so changed bytes in them are not noticed.

        Raises:
            ValueError: With the damage.
        """
        width, height = self.size()
        samples, planar = self._one(_SAMPLES, 1), self._one(_PLANAR, 1)
        bits, compression = self._all(_BITS, (1,)), self._one(_COMPRESSION, _NONE)
        if not 1 <= samples <= _MOST_SAMPLES or len(set(bits)) != 1 or not 1 <= bits[0] <= 64:
            raise ValueError(f"it has {samples} samples of {bits[:8]} bits")
        if self._one(_PHOTOMETRIC, 1) == _SEPARATED:
            raise OtherKind("found the colours CMYK, expected grey or RGB; convert it to RGB")
        if bits[0] not in (1, 2, 4, 8, 16, 32, 64):
            raise OtherKind(f"found samples of {bits[0]} packed bits, expected 8 or 16; convert it to 16 bits")
        if self._one(_FILL_ORDER, 1) != 1 or planar not in (1, 2):
            raise ValueError("the order of its bits or samples is not a usual one")
        planes, together = (1, samples) if planar == 1 else (samples, 1)
        if _TILES in self.fields:
            across, down = self._one(_TILE_WIDTH), self._one(_TILE_HEIGHT)
            places, sizes = self._all(_TILES), self._all(_TILE_BYTES)
            if not (0 < across <= width + 1024 and 0 < down <= height + 1024):
                raise ValueError(f"its tiles have {across} x {down} px")
            rows = [down] * (-(-width // across) * -(-height // down) * planes)
        else:
            across, down = width, min(self._one(_ROWS_PER_STRIP, height), height)
            places, sizes = self._all(_STRIPS), self._all(_STRIP_BYTES)
            if down == 0:
                raise ValueError("its strips have no rows")
            rows = [min(down, height - top) for top in range(0, height, down)] * planes
        if not len(places) == len(sizes) == len(rows):
            raise ValueError(f"it has {len(places)} strips or tiles instead of {len(rows)}")
        # Strips that overlap would be unpacked again and again.
        if sum(sizes) > len(self.data) or any(map(lambda at, size: at + size > len(self.data), places, sizes)):
            raise ValueError("its data lie outside the file")
        line = (across * together * bits[0] + 7) // 8
        if compression == _NONE:
            # Padding may follow.
            fits = all(map(lambda size, count: size >= count * line, sizes, rows))
        else:
            # The last strip may have all the rows of the others.
            fits = compression not in _DEFLATE or all(
                _inflated(self.data[place : place + size], down * line) in (count * line, down * line)
                for place, size, count in zip(places, sizes, rows, strict=True)
            )
        if not fits:
            raise ValueError("its data have another length than its rows")

    def is_known_packing(self) -> bool:
        """Whether the data are packed in a usual way."""
        return self._one(_COMPRESSION, _NONE) in (_NONE, _LZW, _PACKBITS, *_DEFLATE)

    def _one(self, tag: int, default: int | None = None) -> int:
        values = self._all(tag, None if default is None else (default,))
        if len(values) != 1:
            raise ValueError(f"its tag {tag} has {len(values)} values instead of one")
        return values[0]

    def _all(self, tag: int, default: tuple[int, ...] | None = None) -> tuple[int, ...]:
        if tag not in self.fields:
            if default is None:
                raise ValueError(f"its tag {tag} is missing")
            return default
        kind, count, at = self.fields[tag]
        if kind not in (_SHORT, _LONG) or not 0 < count <= _MOST_ENTRIES:
            raise ValueError(f"its tag {tag} is no whole number")
        length = count * (2 if kind == _SHORT else 4)
        if length > 4:
            (at,) = struct.unpack_from(self.order + "I", self.data, at)
        if at + length > len(self.data):
            raise ValueError(f"its tag {tag} lies outside the file")
        return struct.unpack_from(f"{self.order}{count}{'H' if kind == _SHORT else 'I'}", self.data, at)


def _inflated(data: bytes, expected: int) -> int:
    """Number of bytes that a strip or tile unpacks to, at most a little more than expected; -1 where it is damaged."""
    inflater = isal_zlib.decompressobj()
    try:
        found = len(inflater.decompress(data, expected + 1))
    except isal_zlib.error:  # type: ignore[misc]  # Its stub calls the class an exception.
        return -1
    return found if inflater.eof else -1
