"""Reading PLY: files of this library on their grid, others as a single row of points."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.clouds import points as sizes
from jaxscan.files.clouds.about import StoredCloud, about_of
from jaxscan.files.clouds.grid import Records, cloud_of
from jaxscan.files.clouds.points import plain_names
from jaxscan.files.clouds.tables import numbers_of, text_lines
from jaxscan.files.disk import open_regular


MAX_HEADER_BYTES = 64 << 10

_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2"},
    **{"int": "i4", "uint": "u4", "float": "f4", "double": "f8"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"},
    **{"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"},
}
_BLOCK = 1 << 16
_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}


class _Element(NamedTuple):
    name: str
    rows: int
    dtype: np.dtype | None
    """None where a property is a list."""


class _Header(NamedTuple):
    encoding: str
    comments: tuple[str, ...]
    elements: tuple[_Element, ...]
    length: int
    """Bytes before the data."""


def read_ply(path: Path) -> StoredCloud:
    """A cloud from a PLY file, ASCII or binary.

    A file of this library is read onto its grid, unless its points are too few for so large a one. Of other
    files, `x y z` and, where present, colours, normals, intensity and sigmas are read, as a single profile, or on the
    grid where they have kept step and row.

    Raises:
        CloudError: If it is damaged or has no points.
    """
    try:
        with open_regular(path, error=CloudError) as file:
            header = _read_header(file, path)
            size = os.fstat(file.fileno()).st_size
            vertices, profiles = _read_tables(file, header, size, path)
            cloud = cloud_of(vertices, header.comments, str(path), profiles=profiles)
    except ValueError as problem:
        raise CloudError(f"{path}: vertex: not a table of numbers: {str(problem)[:60]}.") from problem
    except (OSError, EOFError) as problem:
        raise CloudError(f"{path}: cannot be read: {getattr(problem, 'strerror', None) or problem}.") from problem
    return StoredCloud(cloud, about_of(header.comments))


def _read_header(file: BinaryIO, path: Path) -> _Header:
    data = file.read(MAX_HEADER_BYTES)
    end = data.find(b"end_header")
    length = data.find(b"\n", end) + 1
    if not data.startswith(b"ply") or end < 0 or length == 0:
        raise CloudError(f"{path}: not a PLY file, or its header does not end within {MAX_HEADER_BYTES >> 10} KiB.")
    encoding = ""
    comments: list[str] = []
    elements: list[tuple[str, int, list[tuple[str, str]] | None]] = []
    for line in data[:end].decode("latin-1").splitlines()[1:]:
        words = line.split()
        match words:
            case []:
                pass
            case ["comment" | "obj_info", *rest]:
                comments.append(" ".join(rest))
            case ["format", encoding, "1.0"] if encoding in _ORDERS:
                pass
            case ["element", name, count] if count.isascii() and count.isdigit() and len(count) < 16:
                elements.append((name, int(count), []))
            case ["property", "list", *_] if elements:
                elements[-1] = (*elements[-1][:2], None)
            case ["property", kind, name] if elements and kind in _TYPES:
                # After a list the size of an item is unknown, so its other properties are not used.
                if (fields := elements[-1][2]) is not None:
                    fields.append((name, _ORDERS.get(encoding, "=") + _TYPES[kind]))
            case _:
                raise CloudError(f'{path}: found "{line[:60]}" in the header, which PLY does not know.')
    if not encoding:
        raise CloudError(f"{path}: the header names no known format.")
    try:
        parsed = tuple(_Element(name, n, None if parts is None else np.dtype(parts)) for name, n, parts in elements)
    except ValueError as problem:
        raise CloudError(f"{path}: the header is wrong: {str(problem)[:60]}.") from problem
    return _Header(encoding, tuple(comments), parsed, length)


def _read_tables(file: BinaryIO, header: _Header, size: int, path: Path) -> tuple[Records, np.ndarray | None]:
    """The vertices, which are still in the file, and the profiles where they can be read."""
    vertices: Records | None = None
    profiles: np.ndarray | None = None
    text = header.encoding == "ascii"
    file.seek(header.length)
    for element in header.elements:
        if element.dtype is None:
            break
        _check_length(file, element, text, size, path)
        if element.name == "vertex":
            vertices = _vertices(file, element, text)
        if element.name == "profile":
            try:
                profiles = np.concatenate([np.empty(0, element.dtype), *_blocks(file, element, text)])
            except ValueError as problem:
                raise CloudError(f"{path}: profile: not a table of numbers: {str(problem)[:60]}.") from problem
        elif text:
            for _ in text_lines(file, element.rows if element.dtype.names else 0):
                pass
        else:
            file.seek(element.rows * element.dtype.itemsize, os.SEEK_CUR)
    # The length of a list is in the list alone; without lists the header says where the file ends.
    if all(element.dtype is not None for element in header.elements) and _has_more(file):
        raise CloudError(f"{path}: the file goes on after the data that its header announces; it is damaged.")
    if vertices is None:
        raise CloudError(f"{path}: has no vertices that can be read; lists in or before them are not supported.")
    if len(vertices) == 0:
        raise CloudError(f"{path}: holds no points.")
    return vertices, profiles


def _has_more(file: BinaryIO) -> bool:
    """Whether more follows than the end of a line."""
    rest = file.read(_BLOCK)
    while rest and not rest.strip():
        rest = file.read(_BLOCK)
    return bool(rest)


def _check_length(file: BinaryIO, element: _Element, text: bool, size: int, path: Path) -> None:
    """Compare what the header announces with what is left of the file, before memory is taken."""
    dtype, count = element.dtype or np.dtype([]), element.rows
    # As text, a number takes a digit and a separator.
    needed = count * (2 * len(dtype.names or ()) if text else dtype.itemsize) - (1 if text and count else 0)
    if needed > size - file.tell():
        raise CloudError(
            f"{path}: announces {count} of {element.name[:60]}, but the file ends before; it is damaged or cut short."
        )


def _vertices(file: BinaryIO, element: _Element, text: bool) -> Records:
    """The vertices from where the file is, with the names that this library gives to their columns."""
    start, dtype = file.tell(), element.dtype or np.dtype([])
    plain = np.dtype(
        [(name, dtype[given]) for name, given in zip(plain_names(dtype.names or ()), dtype.names or (), strict=True)]
    )

    def read() -> Iterator[np.ndarray]:
        file.seek(start)
        return (block.view(plain) for block in _blocks(file, element, text))

    return Records(plain, element.rows if dtype.names else 0, read)


def _blocks(file: BinaryIO, element: _Element, text: bool) -> Iterator[np.ndarray]:
    """The rows of a table from where the file is.

    Raises:
        ValueError: If they are no rows of numbers, or the file has fewer.
    """
    dtype, left = element.dtype or np.dtype([]), element.rows if element.dtype is not None else 0
    while left and dtype.names:
        count = min(left, sizes.BLOCK_POINTS)
        block = numbers_of(text_lines(file, count), dtype) if text else np.fromfile(file, dtype, count)
        if len(block) != count:
            rows, columns = element.rows - left + len(block), len(dtype.names)
            raise ValueError(f"found {(rows, columns)}, expected {(element.rows, columns)}")
        yield block
        left -= count
