"""PCD, the format of the Point Cloud Library and of ROS."""

import os
from collections.abc import Callable, Iterator
from typing import BinaryIO, NamedTuple

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.clouds import points as sizes
from jaxscan.files.clouds.columns import COLOURS, Reading, plain_names, stored_cloud
from jaxscan.files.clouds.header import SEAL_LINE, About, StoredCloud, check_seal, header_lines, seal
from jaxscan.files.clouds.points import (
    POINT,
    Records,
    blocks,
    columns,
    numbers_of,
    profiles_at_a_time,
    record_of,
    table,
    text_lines,
)
from jaxscan.files.disk import Part
from jaxscan.reconstruction import CloudPoints, PointCloud


def unpack(packed: bytes, size: int) -> bytes:
    """The bytes that were packed.

    Args:
        packed: Tokens: a byte below 32 and so many bytes more than it says as they are, or a length in the upper 3
            bits and a distance back in the other 13, with a byte of more length between where the 3 bits are all set.
        size: Number of the bytes that were packed.
    """
    out = bytearray()
    at, end = 0, len(packed)
    try:
        while at < end and len(out) <= size:
            token = packed[at]
            at += 1
            if token < 32:
                out += packed[at : at + token + 1]
                at += token + 1
                continue
            length = token >> 5
            if length == 7:
                length += packed[at]
                at += 1
            start = len(out) - ((token & 31) << 8) - packed[at] - 1
            at += 1
            length += 2
            if start < 0:
                raise ValueError("a repetition begins before the data")
            # A repeated run may overlap its own output.
            piece = out[start : start + length]
            out += (piece * (length // len(piece) + 1))[:length]
    except IndexError as problem:
        raise ValueError("the packed data is cut short") from problem
    if len(out) != size or at != end:
        raise ValueError(f"found {len(out)} bytes of {size}")
    return bytes(out)


MAX_HEADER_BYTES = 64 << 10
MAX_COLUMNS, MAX_NUMBERS = 256, 4096
"""Most fields of a point, and most numbers of all its fields."""
_TYPES = {
    **{("F", size): f"<f{size}" for size in (4, 8)},
    **{(kind, size): f"<{kind.lower()}{size}" for kind in "IU" for size in (1, 2, 4, 8)},
}
_ENTRIES = ("FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "POINTS", "DATA")
_MOST_PACKED = 128
"""Largest ratio of bytes to packed ones: a token of 3 bytes repeats at most 264."""


class _Header(NamedTuple):
    dtype: np.dtype
    points: int
    encoding: str
    comments: tuple[str, ...]
    length: int


def read_pcd(file: BinaryIO, reading: Reading) -> StoredCloud:
    """A cloud from a PCD file: text, binary, or packed."""
    check_seal(file)
    header = _read_header(file)
    read = _reading(file, header)
    count = sum(len(block) for block in read())
    if count == 0:
        raise CloudError("holds no finite point.")
    return stored_cloud(Records(_unpacked_type(header.dtype), count, read), header.comments, reading)


def _read_header(file: BinaryIO) -> _Header:
    entries: dict[str, list[str]] = {}
    comments: list[str] = []
    left = MAX_HEADER_BYTES
    while "DATA" not in entries:
        line = file.readline(left)
        left -= len(line)
        if not line.endswith(b"\n") or left <= 0:
            raise CloudError(f"not a PCD file, or its header does not end within {MAX_HEADER_BYTES >> 10} KiB.")
        text = line.decode("latin-1").strip()
        if text.startswith("#"):
            comments.append(text[1:].strip())
        elif text:
            key, *words = text.split()
            if key not in (*_ENTRIES, "VERSION", "VIEWPOINT", "COLUMNS"):
                raise CloudError(f'found "{text[:60]}" in the header, which PCD does not know.')
            entries["FIELDS" if key == "COLUMNS" else key] = words
    names, encoding = entries.get("FIELDS", []), " ".join(entries["DATA"])
    width, height, points = (_whole(entries, key) for key in ("WIDTH", "HEIGHT", "POINTS"))
    count = points if points is not None else (width or 0) * (1 if height is None else height)
    if encoding not in ("ascii", "binary", "binary_compressed"):
        raise CloudError(f'found the data "{encoding[:60]}", expected ascii, binary or binary_compressed.')
    repeats = entries.get("COUNT", ["1"] * len(names))
    kinds, sizes = entries.get("TYPE", []), entries.get("SIZE", [])
    if not 0 < len(names) <= MAX_COLUMNS or not len(names) == len(kinds) == len(sizes) == len(repeats):
        raise CloudError(f"the header names {len(names)} fields, and not a type, a size and a count of each.")
    try:
        # A field of several numbers, and padding "_", is kept as it is and not used.
        fields = [
            (plain, _TYPES[kind, int(size)], (int(repeat),)) if repeat != "1" else (plain, _TYPES[kind, int(size)])
            for plain, kind, size, repeat in zip(_unique(names), kinds, sizes, repeats, strict=True)
        ]
        dtype = np.dtype(fields)
    except (KeyError, ValueError, OverflowError, MemoryError) as problem:
        raise CloudError(f"the header is wrong: {str(problem)[:60]}.") from problem
    if sum(_of(dtype[name]) for name in dtype.names or ()) > MAX_NUMBERS:
        raise CloudError(f"a point has more than {MAX_NUMBERS} numbers; the header is wrong.")
    if not {"x", "y", "z"} <= set(dtype.names or ()) or any(dtype[axis].shape for axis in "xyz"):
        raise CloudError("the points have no x, y and z.")
    if count == 0:
        raise CloudError("holds no points.")
    return _Header(dtype, count, encoding, tuple(comments), file.tell())


def _unique(names: list[str]) -> list[str]:
    plain = plain_names(names)
    return [name if plain.count(name) == 1 and name != "_" else f"{name}{k}" for k, name in enumerate(plain)]


def _whole(entries: dict[str, list[str]], key: str) -> int | None:
    word = " ".join(entries.get(key, []))
    return int(word) if word.isascii() and word.isdigit() and len(word) < 16 else None


def _reading(file: BinaryIO, header: _Header) -> Callable[[], Iterator[np.ndarray]]:
    """Reads the finite points of the file a block at a time, with colours in columns of their own."""
    dtype, count, rest = header.dtype, header.points, os.fstat(file.fileno()).st_size - header.length
    short = CloudError(f"announces {count} points, but the file ends before; it is damaged or cut short.")
    flat = _flat(dtype)
    # Nothing is allocated before this check.
    if header.encoding == "binary" and count * dtype.itemsize > rest:
        raise short
    if header.encoding == "ascii" and count * 2 * len(flat.names or ()) - 1 > rest:
        raise short
    packed = _unpacked_table(file, header, rest, short) if header.encoding == "binary_compressed" else None

    def read() -> Iterator[np.ndarray]:
        file.seek(header.length)
        for start in range(0, count, sizes.BLOCK_POINTS):
            some = min(sizes.BLOCK_POINTS, count - start)
            if packed is not None:
                block = _part_of(packed, dtype, count, start, some)
            elif header.encoding == "ascii":
                block = numbers_of(text_lines(file, some), flat).view(dtype)
            else:
                block = np.fromfile(file, dtype, some)
            if len(block) != some:
                raise short
            # The rest are cells of the grid without a point.
            finite = np.isfinite(block["x"]) & np.isfinite(block["y"]) & np.isfinite(block["z"])
            yield _unpacked_colours(block[finite])

    return read


def _unpacked_table(file: BinaryIO, header: _Header, rest: int, short: CloudError) -> bytes:
    """The bytes of all points, one field after the other."""
    file.seek(header.length)
    packed, size = (int.from_bytes(file.read(4), "little") for _ in range(2))
    if packed > rest - 8 or size != header.points * header.dtype.itemsize or size > _MOST_PACKED * packed:
        raise short
    return unpack(file.read(packed), size)


def _part_of(data: bytes, dtype: np.dtype, count: int, start: int, some: int) -> np.ndarray:
    """Some of the points that are stored field by field."""
    table, at = np.empty(some, dtype), 0
    for name in dtype.names or ():
        numbers = _of(dtype[name])
        field = np.frombuffer(data, dtype[name].base, some * numbers, at + start * dtype[name].itemsize)
        table[name] = field.reshape(some, *dtype[name].shape)
        at += count * dtype[name].itemsize
    return table


def _of(field: np.dtype) -> int:
    """How many numbers a field has."""
    return field.shape[0] if field.shape else 1


def _flat(dtype: np.dtype) -> np.dtype:
    """The same type with a field for each number."""
    numbers = [(f"{name}{k}", dtype[name].base) for name in dtype.names or () for k in range(_of(dtype[name]))]
    return np.dtype(numbers)


def _colour_of(dtype: np.dtype) -> str | None:
    """The field that holds a packed colour: one number of four bytes."""
    named = [name for name in ("rgb", "rgba") if name in (dtype.names or ())]
    return next((name for name in named if not dtype[name].shape and dtype[name].itemsize == 4), None)


def _unpacked_type(dtype: np.dtype) -> np.dtype:
    """The plain numbers of a record alone, and colours in fields of their own."""
    names = [name for name in dtype.names or () if not dtype[name].shape]
    kept = [(name, dtype[name].str) for name in names if name not in ("rgb", "rgba")]
    missing = _colour_of(dtype) is not None and not set(COLOURS) & set(names)
    return np.dtype(kept + [(name, "u1") for name in (COLOURS if missing else ())])


def _unpacked_colours(table: np.ndarray) -> np.ndarray:
    """Records of `_unpacked_type`."""
    points = np.empty(len(table), _unpacked_type(table.dtype))
    names, colour = set(table.dtype.names or ()), _colour_of(table.dtype)
    for name in points.dtype.names or ():
        if name in names:
            points[name] = table[name]
    if colour is not None and not set(COLOURS) & names:
        packed = np.ascontiguousarray(table[colour])
        bits = packed.view(np.uint32)
        if packed.dtype.kind == "f":
            # Some programs write the packed number itself; as bits it is smaller than any number that a person writes.
            numbers = (packed >= 1) & (packed < 1 << 24)
            bits = np.where(numbers, np.where(numbers, packed, 0).astype(np.uint32), bits)
        for name, shift in zip(COLOURS, (16, 8, 0), strict=True):
            points[name] = (bits >> np.uint32(shift)) & np.uint32(255)
    return points


_LONG = {"nx": "normal_x", "ny": "normal_y", "nz": "normal_z"}
_POINT = np.dtype(
    [(_LONG.get(name, name), POINT[name].str) for name in (POINT.names or ())[:6]]
    # The library packs a colour as 0x00rrggbb and calls the four bytes a float.
    + [("rgb", "<u4")]
    + [(name, POINT[name].str) for name in (POINT.names or ())[6:] if name not in COLOURS]
)
_KINDS = {"f": "F", "i": "I", "u": "U"}
CELLS_PER_POINT = 16
"""Emptier grids are written as a list of points, whose step and row tell their cells."""


def write_pcd(cloud: PointCloud, path: Part, about: About) -> None:
    """Write the grid, a profile as a row, with NaN where there is no point; coordinates as doubles if they are.

    A cloud of one profile, and one whose grid is almost empty, is written as a list of its points.
    """
    point = record_of(_POINT, cloud)
    names, count = point.names or (), int(np.count_nonzero(cloud.valid))
    profiles, lines = cloud.valid.shape
    organised = profiles > 1 and profiles * lines <= CELLS_PER_POINT * count
    width, height = (lines, profiles) if organised else (count, 1)
    header = [
        "# .PCD v0.7 - Point Cloud Data file format",
        *(f"# {line}" for line in (*header_lines(cloud, about), SEAL_LINE)),
        "VERSION 0.7",
        f"FIELDS {' '.join(names)}",
        f"SIZE {' '.join(str(point[name].itemsize) for name in names)}",
        f"TYPE {' '.join('F' if name == 'rgb' else _KINDS[point[name].kind] for name in names)}",
        f"COUNT {' '.join('1' for _ in names)}",
        f"WIDTH {width}",
        f"HEIGHT {height}",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {width * height}",
        "DATA binary",
        "",
    ]
    with open(path, "wb") as file:
        file.write("\n".join(header).encode("ascii"))
        if organised:
            for start, stop in profiles_at_a_time(cloud):
                cells = _empty(point, (stop - start, lines))
                points = cloud.points(start, stop)
                cells[points.step - start, points.row] = _records(cloud, points, point)
                file.write(cells.data)
        else:
            for points in blocks(cloud):
                file.write(_records(cloud, points, point).data)
    seal(path)


def _records(cloud: PointCloud, points: CloudPoints, point: np.dtype) -> np.ndarray:
    red, green, blue = points.rgb.astype(np.uint32).T
    packed = red << np.uint32(16) | green << np.uint32(8) | blue
    return table({**columns(points, cloud), "rgb": packed}, point)


def _empty(point: np.dtype, shape: tuple[int, int]) -> np.ndarray:
    """Cells without a point: NaN, which is how the format says so, and zero in whole numbers."""
    cells = np.zeros(shape, point)
    for name in point.names or ():
        if point[name].kind == "f":
            cells[name] = np.nan
    return cells
