"""The pages of an E57 file: 1020 bytes each, and a checksum that is compared whenever a page is read.

Source: ASTM E2807, 6.2; CRC-32C (Castagnoli) as in RFC 3720.
"""

import functools
from typing import BinaryIO

import numpy as np


PAGE, PAYLOAD = 1024, 1020
_BLOCK = 1024
"""Pages that are read at a time."""


class Pages:
    """The bytes of a file without their checksums."""

    def __init__(self, file: BinaryIO, size: int) -> None:
        """A file of so many bytes."""
        self._file, self._pages = file, size // PAGE
        self._first, self._held = 0, b""

    def read(self, at: int, count: int) -> bytes:
        """Bytes from a place that is counted without checksums.

        Raises:
            ValueError: If the file ends before, or a page is damaged.
        """
        if at < 0 or count < 0 or at + count > self._pages * PAYLOAD:
            raise ValueError("a part of it lies behind its end")
        parts = []
        while count:
            start = at - self._first * PAYLOAD
            if not 0 <= start < len(self._held):
                self._fill(at // PAYLOAD)
                continue
            part = self._held[start : start + count]
            parts.append(part)
            at, count = at + len(part), count - len(part)
        return parts[0] if len(parts) == 1 else b"".join(parts)

    def _fill(self, first: int) -> None:
        self._file.seek(first * PAGE)
        data = self._file.read(min(_BLOCK, self._pages - first) * PAGE)
        if len(data) < PAGE:
            raise ValueError("the file ends before its end")
        pages = np.frombuffer(data, np.uint8, len(data) // PAGE * PAGE).reshape(-1, PAGE)
        stated = np.ascontiguousarray(pages[:, PAYLOAD:]).view(">u4")[:, 0]
        if wrong := np.flatnonzero(checksums(pages[:, :PAYLOAD]) != stated).tolist():
            raise ValueError(f"the checksum of page {first + wrong[0]} is not that of its bytes")
        self._first, self._held = first, pages[:, :PAYLOAD].tobytes()


def without_checksums(place: int) -> int:
    """A place in the file as it is counted without checksums; one within a checksum is the end of its page."""
    return place // PAGE * PAYLOAD + min(place % PAGE, PAYLOAD)


def checksums(pages: np.ndarray) -> np.ndarray:
    """CRC-32C of rows of bytes, uint8 [n, 4 k], as uint32 [n]: all rows at once, four bytes at a time."""
    low, high = _tables()
    found = np.full(len(pages), 0xFFFFFFFF, np.uint32)
    for word in np.ascontiguousarray(np.ascontiguousarray(pages).view("<u4").T):
        found ^= word
        found = low[found & np.uint32(0xFFFF)] ^ high[found >> np.uint32(16)]
    return ~found


@functools.cache
def _tables() -> tuple[np.ndarray, np.ndarray]:
    """What four bytes make of a checksum: by the lower and the upper two of them."""
    table = np.arange(1 << 16, dtype=np.uint32)
    halves = []
    for _ in range(2):
        for _ in range(16):
            table = (table >> np.uint32(1)) ^ np.where(table & np.uint32(1), np.uint32(0x82F63B78), np.uint32(0))
        halves.append(table)
    return halves[1], halves[0]
