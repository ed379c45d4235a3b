"""Reading PCD: files of this library on their grid, others as a single row of points."""

import os
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.clouds.about import StoredCloud, about_of
from jaxscan.files.clouds.grid import cloud_of
from jaxscan.files.clouds.pcd.lzf import unpack
from jaxscan.files.clouds.points import plain_names
from jaxscan.files.clouds.tables import numbers_of, text_lines
from jaxscan.files.disk import open_regular


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
    """Bytes before the data."""


def read_pcd(path: Path) -> StoredCloud:
    """A cloud from a PCD file: text, binary, or packed.

    Raises:
        CloudError: If it is damaged or has no points.
    """
    try:
        with open_regular(path, error=CloudError) as file:
            header = _read_header(file, path)
            size = os.fstat(file.fileno()).st_size
            file.seek(header.length)
            table = _read_table(file, header, size - header.length, path)
    except (OSError, EOFError) as problem:
        raise CloudError(f"{path}: cannot be read: {getattr(problem, 'strerror', None) or problem}.") from problem
    points = _unpacked_colours(table)
    # Cells of the grid without a point.
    points = points[np.isfinite(points["x"]) & np.isfinite(points["y"]) & np.isfinite(points["z"])]
    if len(points) == 0:
        raise CloudError(f"{path}: holds no finite point.")
    return StoredCloud(cloud_of(points, header.comments, str(path)), about_of(header.comments))


def _read_header(file: BinaryIO, path: Path) -> _Header:
    entries: dict[str, list[str]] = {}
    comments: list[str] = []
    left = MAX_HEADER_BYTES
    while "DATA" not in entries:
        line = file.readline(left)
        left -= len(line)
        if not line.endswith(b"\n") or left <= 0:
            raise CloudError(f"{path}: not a PCD file, or its header does not end within {MAX_HEADER_BYTES >> 10} KiB.")
        text = line.decode("latin-1").strip()
        if text.startswith("#"):
            comments.append(text[1:].strip())
        elif text:
            key, *words = text.split()
            if key not in (*_ENTRIES, "VERSION", "VIEWPOINT", "COLUMNS"):
                raise CloudError(f'{path}: found "{text[:60]}" in the header, which PCD does not know.')
            entries["FIELDS" if key == "COLUMNS" else key] = words
    names, encoding = entries.get("FIELDS", []), " ".join(entries["DATA"])
    width, height, points = (_whole(entries, key) for key in ("WIDTH", "HEIGHT", "POINTS"))
    count = points if points is not None else (width or 0) * (1 if height is None else height)
    if encoding not in ("ascii", "binary", "binary_compressed"):
        raise CloudError(f'{path}: found the data "{encoding[:60]}", expected ascii, binary or binary_compressed.')
    repeats = entries.get("COUNT", ["1"] * len(names))
    kinds, sizes = entries.get("TYPE", []), entries.get("SIZE", [])
    if not 0 < len(names) <= MAX_COLUMNS or not len(names) == len(kinds) == len(sizes) == len(repeats):
        raise CloudError(f"{path}: the header names {len(names)} fields, and not a type, a size and a count of each.")
    try:
        # A field of several numbers, and padding "_", is kept as it is and not used.
        fields = [
            (plain, _TYPES[kind, int(size)], (int(repeat),)) if repeat != "1" else (plain, _TYPES[kind, int(size)])
            for plain, kind, size, repeat in zip(_unique(names), kinds, sizes, repeats, strict=True)
        ]
        dtype = np.dtype(fields)
    except (KeyError, ValueError, OverflowError, MemoryError) as problem:
        raise CloudError(f"{path}: the header is wrong: {str(problem)[:60]}.") from problem
    if sum(_of(dtype[name]) for name in dtype.names or ()) > MAX_NUMBERS:
        raise CloudError(f"{path}: a point has more than {MAX_NUMBERS} numbers; the header is wrong.")
    if not {"x", "y", "z"} <= set(dtype.names or ()) or any(dtype[axis].shape for axis in "xyz"):
        raise CloudError(f"{path}: the points have no x, y and z.")
    if count == 0:
        raise CloudError(f"{path}: holds no points.")
    return _Header(dtype, count, encoding, tuple(comments), file.tell())


def _unique(names: list[str]) -> list[str]:
    plain = plain_names(names)
    return [name if plain.count(name) == 1 and name != "_" else f"{name}{k}" for k, name in enumerate(plain)]


def _whole(entries: dict[str, list[str]], key: str) -> int | None:
    word = " ".join(entries.get(key, []))
    return int(word) if word.isascii() and word.isdigit() and len(word) < 16 else None


def _read_table(file: BinaryIO, header: _Header, rest: int, path: Path) -> np.ndarray:
    dtype, count = header.dtype, header.points
    short = CloudError(f"{path}: announces {count} points, but the file ends before; it is damaged or cut short.")
    if header.encoding == "binary":
        # Nothing is allocated before this check.
        if count * dtype.itemsize > rest:
            raise short
        return np.fromfile(file, dtype, count)
    try:
        if header.encoding == "ascii":
            flat = _flat(dtype)
            if count * 2 * len(flat.names or ()) - 1 > rest:
                raise short
            table = numbers_of(text_lines(file, count), flat)
            if len(table) != count:
                raise short
            return _packed_again(table, dtype)
        packed, size = (int.from_bytes(file.read(4), "little") for _ in range(2))
        if packed > rest - 8 or size != count * dtype.itemsize or size > _MOST_PACKED * packed:
            raise short
        data = unpack(file.read(packed), size)
    except ValueError as problem:
        raise CloudError(f"{path}: the points cannot be read: {str(problem)[:60]}.") from problem
    table, at = np.empty(count, dtype), 0
    for name in dtype.names or ():
        # Packed points are stored field by field.
        field = np.frombuffer(data, dtype[name].base, count * _of(dtype[name]), at)
        table[name] = field.reshape(count, *dtype[name].shape)
        at += field.nbytes
    return table


def _of(field: np.dtype) -> int:
    """How many numbers a field has."""
    return field.shape[0] if field.shape else 1


def _flat(dtype: np.dtype) -> np.dtype:
    """The same with a field for each number."""
    numbers = [(f"{name}{k}", dtype[name].base) for name in dtype.names or () for k in range(_of(dtype[name]))]
    return np.dtype(numbers)


def _packed_again(table: np.ndarray, dtype: np.dtype) -> np.ndarray:
    records = np.empty(len(table), dtype)
    for name in dtype.names or ():
        parts = [table[f"{name}{k}"] for k in range(_of(dtype[name]))]
        records[name] = np.stack(parts, -1) if dtype[name].shape else parts[0]
    return records


def _unpacked_colours(table: np.ndarray) -> np.ndarray:
    """Records with plain numbers alone, and colours in fields of their own."""
    names = [name for name in table.dtype.names or () if not table.dtype[name].shape]
    colour = next((name for name in ("rgb", "rgba") if name in names and table.dtype[name].itemsize == 4), None)
    kept = [(name, table.dtype[name].str) for name in names if name not in ("rgb", "rgba")]
    missing = colour is not None and not {"red", "green", "blue"} & set(names)
    colours = ("red", "green", "blue") if missing else ()
    points = np.empty(len(table), kept + [(name, "u1") for name in colours])
    for name, _ in kept:
        points[name] = table[name]
    if colour is not None and missing:
        bits = np.ascontiguousarray(table[colour]).view(np.uint32)
        for name, shift in zip(colours, (16, 8, 0), strict=False):
            points[name] = (bits >> np.uint32(shift)) & np.uint32(255)
    return points
