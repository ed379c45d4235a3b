"""Sizes within a LAZ file, compared with its length before the library takes memory for them.

Source: LASzip 3.4, "LAZ specification" (M. Isenburg).
"""

import struct
from typing import BinaryIO, NamedTuple


MAX_EXPANSION = 64
"""Largest accepted ratio of the points to the size of a compressed file; a MiB more is always accepted."""
_SMALL = 1 << 20
_LAYERED = 3
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
"""Layers of an item by its type: points, colours, colours with infrared, waves. Type 14 has one a byte."""


class Sizes(NamedTuple):
    """The numbers of a header that decide how much memory is taken."""

    head: int
    """Bytes of the header itself."""
    offset: int
    """Place of the points."""
    records: int
    kind: int
    point_bytes: int
    points: int


def check_compressed(file: BinaryIO, sizes: Sizes, size: int) -> None:
    """Check the points, their parts, and the layers of each part.

    Raises:
        ValueError: If one of them is larger than the file can hold.
    """
    needed = sizes.points * sizes.point_bytes
    if needed > MAX_EXPANSION * size + _SMALL:
        raise ValueError(
            f"its points would take {needed} bytes, expected at most {MAX_EXPANSION} times the file; convert it to .las"
        )
    (table,) = struct.unpack("<q", _bytes_at(file, sizes.offset, 8))
    if table == -1:
        (table,) = struct.unpack("<q", _bytes_at(file, size - 8, 8))
    if not sizes.offset + 8 <= table <= size - 8:
        raise ValueError("the table of its compressed points is not in the file")
    (parts,) = struct.unpack("<I", _bytes_at(file, table + 4, 4))
    if parts > sizes.points:
        raise ValueError(f"announces {parts} parts of {sizes.points} points")
    layers = _layers(file, sizes)
    at = sizes.offset + 8
    while layers and at < table:
        # A part has a point as it is, its number of points, the length of each layer, and the layers.
        at += sizes.point_bytes + 4
        at += 4 * layers + sum(struct.unpack(f"<{layers}I", _bytes_at(file, at, 4 * layers)))
        if at > table:
            raise ValueError("a part of its compressed points is longer than the file")


def _layers(file: BinaryIO, sizes: Sizes) -> int:
    """How many layers a part of the points has; 0 where they are not in layers."""
    at = sizes.head
    for _ in range(sizes.records):
        user, number, length = struct.unpack("<2x16sHH32x", _bytes_at(file, at, 54))
        if user.rstrip(b"\0") == b"laszip encoded" and number == 22204:
            data = _bytes_at(file, at + 54, length)
            compressor, items = struct.unpack_from("<H30xH", data)
            listed = [struct.unpack_from("<HHH", data, 34 + 6 * k) for k in range(items)]
            if sum(item_bytes for _, item_bytes, _ in listed) != sizes.point_bytes:
                raise ValueError("the items of its compressed points are not as long as a point")
            return sum(_LAYERS.get(kind, count) for kind, count, _ in listed) if compressor == _LAYERED else 0
        at += 54 + length
    raise ValueError("does not say how its points are compressed")


def _bytes_at(file: BinaryIO, place: int, count: int) -> bytes:
    file.seek(max(place, 0))
    data = file.read(count)
    if len(data) < count:
        raise ValueError("the file ends before its compressed points")
    return data
