"""The points of a scan in E57: packets with a part of each column, whose values are floats or packed bits.

Source: ASTM E2807, 9.3 and 9.4.
"""

import struct
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from jaxscan.files.clouds.e57.pages import Pages, without_checksums


_SECTION, _DATA, _OTHERS = 1, 1, (0, 2)
_AT_A_TIME = 1 << 18
"""Bytes of a column that are collected before they are decoded."""


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


Sink = Callable[[int, np.ndarray], None]
"""Takes values of a column, and the number of those before."""


def read_columns(pages: Pages, place: int, count: int, fields: Sequence[Field], sinks: Sequence[Sink | None]) -> None:
    """Read the columns of a scan, some of their values at a time.

    Args:
        pages: The file.
        place: Where the section begins, counted with checksums.
        count: Number of points.
        fields: All columns in their order.
        sinks: What takes the values of each column; None where they are not asked for.

    Raises:
        ValueError: If the section is damaged or ends too early.
    """
    wanted = [
        (k, _Column(field, sink, count)) for k, (field, sink) in enumerate(zip(fields, sinks, strict=True)) if sink
    ]
    at = without_checksums(place)
    section, length, data = struct.unpack("<B7xQQ8x", pages.read(at, 32))
    if section != _SECTION:
        raise ValueError("a scan has no section of points")
    end, at = at + length, without_checksums(data)
    while not all(column.complete for _, column in wanted):
        if at >= end:
            raise ValueError(f"the section of {count} points ends too early")
        kind, packet = struct.unpack("<BxH", pages.read(at, 4))
        if kind == _DATA:
            _take(pages.read(at, packet + 1), len(fields), wanted)
        elif kind not in _OTHERS:
            raise ValueError("found an unknown packet")
        at += packet + 1


def _take(packet: bytes, count: int, wanted: list[tuple[int, "_Column"]]) -> None:
    """Hand the columns their bytes of a packet."""
    if len(packet) < 6 + 2 * count or struct.unpack_from("<H", packet, 4) != (count,):
        raise ValueError("a packet does not have the columns of its scan")
    places = np.cumsum([6 + 2 * count, *struct.unpack_from(f"<{count}H", packet, 6)]).tolist()
    if places[-1] > len(packet):
        raise ValueError("a packet is shorter than its columns")
    for k, column in wanted:
        column.take(packet[places[k] : places[k + 1]])


class _Column:
    """Collects the bytes of a column, and decodes them when there are many."""

    def __init__(self, field: Field, sink: Sink, count: int) -> None:
        self._field, self._sink, self._count = field, sink, count
        self._done, self._held = 0, bytearray()
        if field.bits == 0:
            self._decode()

    @property
    def complete(self) -> bool:
        return self._done == self._count

    def take(self, data: bytes) -> None:
        self._held += data
        bits = 8 * len(self._held)
        if not self.complete and (bits >= 8 * _AT_A_TIME or bits >= (self._count - self._done) * self._field.bits):
            self._decode()

    def _decode(self) -> None:
        """Decode what is whole: eight values always end with a byte."""
        bits, left = self._field.bits, self._count - self._done
        while left:
            whole = min(left, 8 * len(self._held) // bits if bits else _AT_A_TIME)
            found = min(whole if whole == left else whole // 8 * 8, _AT_A_TIME)
            if not found:
                return
            used = (found * bits + 7) // 8
            self._sink(self._done, _decoded(self._field, self._held[:used], found))
            del self._held[:used]
            self._done, left = self._done + found, left - found


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
