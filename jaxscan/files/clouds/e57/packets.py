"""The points of a scan in E57: packets with a part of each column, whose values are floats or packed bits.

Source: ASTM E2807, 9.3 and 9.4.
"""

import itertools
import math
import struct
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from jaxscan.files.clouds.e57.pages import Pages, without_checksums


_SECTION, _DATA, _OTHERS = 1, 1, (0, 2)
BLOCK_POINTS = 1 << 16
"""Points that are decoded together; a multiple of eight."""


class Field(NamedTuple):
    """How the values of a column are stored."""

    name: str
    bits: int
    """Of a value; none where all are equal, and of texts, which are not read."""
    single: bool | None = None
    """Whether it is a single or a double; None of a whole number."""
    least: int = 0
    """The whole number that is stored as 0."""
    scale: float | None = None
    """What a whole number is multiplied by; None where it is taken as it is."""
    offset: float = 0.0
    brightest: float = float("inf")
    """Largest value that it can have."""
    readable: bool = True

    @property
    def type(self) -> str:
        """Type that holds the values."""
        if self.single is not None:
            return "f4" if self.single else "f8"
        if self.scale is not None:
            return "f8"
        if self.least >= 0 and self.least + (1 << self.bits) <= 1 << 8:
            return "u1"
        return "i4" if self.least >= -(1 << 31) and self.least + (1 << self.bits) <= 1 << 31 else "i8"


def read_blocks(
    pages: Pages, place: int, count: int, fields: Sequence[Field], wanted: Sequence[int]
) -> Iterator[list[np.ndarray]]:
    """Values of some columns of a scan, of the same points each, from the first point to the last.

    Args:
        pages: The file.
        place: Where the section begins, counted with checksums.
        count: Number of points.
        fields: All columns in their order.
        wanted: Numbers of the columns that are asked for.

    Raises:
        ValueError: If the section is damaged or ends too early.
    """
    columns = [_Column(fields[k]) for k in wanted]
    packets = _packets(pages, place, len(fields))
    for start in range(0, count, BLOCK_POINTS):
        points = min(BLOCK_POINTS, count - start)
        while any(column.whole < points for column in columns):
            parts = next(packets, None)
            if parts is None:
                raise ValueError(f"the section of {count} points ends too early")
            for k, column in zip(wanted, columns, strict=True):
                column.hold(parts[k], count - start)
        yield [column.take(points) for column in columns]


def _packets(pages: Pages, place: int, columns: int) -> Iterator[list[bytes]]:
    """The bytes of each column in one packet after the other."""
    at = without_checksums(place)
    section, length, data = struct.unpack("<B7xQQ8x", pages.read(at, 32))
    if section != _SECTION:
        raise ValueError("a scan has no section of points")
    end, at = at + length, without_checksums(data)
    while at < end:
        kind, packet = struct.unpack("<BxH", pages.read(at, 4))
        if kind == _DATA:
            yield _parts(pages.read(at, packet + 1), columns)
        elif kind not in _OTHERS:
            raise ValueError("found an unknown packet")
        at += packet + 1


def _parts(packet: bytes, count: int) -> list[bytes]:
    """What a packet has of each column."""
    if len(packet) < 6 + 2 * count or struct.unpack_from("<H", packet, 4) != (count,):
        raise ValueError("a packet does not have the columns of its scan")
    places = np.cumsum([6 + 2 * count, *struct.unpack_from(f"<{count}H", packet, 6)]).tolist()
    if places[-1] > len(packet):
        raise ValueError("a packet is shorter than its columns")
    return [packet[start:stop] for start, stop in itertools.pairwise(places)]


class _Column:
    """The bytes of a column that are not decoded yet."""

    def __init__(self, field: Field) -> None:
        self._field, self._held = field, bytearray()

    @property
    def whole(self) -> float:
        """Number of values that are there."""
        return float(8 * len(self._held) // self._field.bits) if self._field.bits else math.inf

    def hold(self, data: bytes, left: int) -> None:
        """Keep the bytes of a packet, except what is more than the points that are left."""
        if self.whole < left:
            self._held += data

    def take(self, count: int) -> np.ndarray:
        """The next values: eight of them always end with a byte, and only the last block has another number."""
        used = (count * self._field.bits + 7) // 8
        found = _decoded(self._field, self._held[:used], count)
        del self._held[:used]
        return found


def _decoded(field: Field, data: bytearray, count: int) -> np.ndarray:
    if field.single is not None:
        return np.frombuffer(data, f"<{field.type}", count)
    # Differences of 64 bits wrap around, and so do their sums.
    whole = _unpacked(data, field.bits, count).view(np.int64) + np.int64(field.least)
    if field.scale is None:
        return whole
    return whole * field.scale + field.offset


def _unpacked(data: bytearray, bits: int, count: int) -> np.ndarray:
    """Whole numbers [count] of so many bits each, the lowest bit first."""
    if bits == 0:
        return np.zeros(count, np.uint64)
    if bits in (8, 16, 32, 64):
        return np.frombuffer(data, f"<u{bits // 8}", count).astype(np.uint64)
    groups = -(-count // 8)
    # Eight values take as many bytes as one has bits.
    table = np.zeros((groups, bits), np.uint8)
    table.reshape(-1)[: len(data)] = np.frombuffer(data, np.uint8)
    found = np.zeros((groups, 8), np.uint64)
    for k in range(8):
        first, shift = divmod(k * bits, 8)
        for place in range((shift + bits + 7) // 8):
            part = table[:, first + place].astype(np.uint64)
            move = 8 * place - shift
            found[:, k] |= part << np.uint64(move) if move >= 0 else part >> np.uint64(-move)
    mask = np.uint64((1 << bits) - 1)
    return (found & mask).reshape(-1)[:count]
