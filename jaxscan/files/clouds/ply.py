"""PLY, the format for storage and exchange: ours on their grid, others as a single row of points."""

import os
from collections.abc import Iterator
from typing import BinaryIO, Literal, NamedTuple

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.clouds import points as sizes
from jaxscan.files.clouds.columns import Reading, stored_cloud
from jaxscan.files.clouds.header import SEAL_LINE, About, StoredCloud, check_seal, header_lines, seal
from jaxscan.files.clouds.points import POINT, Records, blocks, columns, numbers_of, record_of, table, text_lines
from jaxscan.files.disk import Part
from jaxscan.reconstruction import PointCloud


MAX_HEADER_BYTES = 64 << 10

_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2"},
    **{"int": "i4", "uint": "u4", "float": "f4", "double": "f8"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"},
    **{"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"},
}
_BLOCK = 1 << 16
_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}


class _Property(NamedTuple):
    name: str
    item: np.dtype
    length: np.dtype | None = None


class _Element(NamedTuple):
    name: str
    rows: int
    properties: list[_Property]

    @property
    def dtype(self) -> np.dtype:
        """The numbers of a row that are in no list."""
        return np.dtype([(each.name, each.item) for each in self.properties if each.length is None])

    @property
    def has_lists(self) -> bool:
        """Whether rows have several lengths."""
        return any(each.length is not None for each in self.properties)

    @property
    def shortest(self) -> int:
        """Bytes of a row whose lists are empty."""
        return sum((each.length or each.item).itemsize for each in self.properties)


class _Header(NamedTuple):
    encoding: str
    comments: list[str]
    elements: list[_Element]
    length: int


def read_ply(file: BinaryIO, reading: Reading) -> StoredCloud:
    """A cloud from a PLY file, ASCII or binary.

    A file of this library is read onto its grid, unless its points are too few for so large a one. From other
    files, `x y z` and, where present, colours, normals, intensity and sigmas are read, as a single profile, or on the
    grid where they have kept step and row. Lists in the vertices or before them are passed over.
    """
    check_seal(file)
    header = _read_header(file)
    vertices, profiles = _read_tables(file, header)
    return stored_cloud(vertices, header.comments, reading, profiles=profiles)


def _read_header(file: BinaryIO) -> _Header:
    data = file.read(MAX_HEADER_BYTES)
    last = data.find(b"end_header")
    end = data.find(b"\n", last) + 1
    if not data.startswith(b"ply") or last < 0 or end == 0:
        raise CloudError(f"not a PLY file, or its header does not end within {MAX_HEADER_BYTES >> 10} KiB.")
    encoding = order = ""
    comments: list[str] = []
    elements: list[_Element] = []
    for line in data[:last].decode("latin-1").splitlines()[1:]:
        words = line.split()
        match words:
            case []:
                pass
            case ["comment" | "obj_info", *rest]:
                comments.append(" ".join(rest))
            case ["format", encoding, "1.0"] if encoding in _ORDERS and not elements:
                order = _ORDERS[encoding]
            case ["element", name, count] if count.isascii() and count.isdigit() and len(count) < 16:
                elements.append(_Element(name, int(count), []))
            case ["property", "list", count, kind, name] if elements and count in _TYPES and kind in _TYPES:
                length = np.dtype(order + _TYPES[count])
                elements[-1].properties.append(_Property(name, np.dtype(order + _TYPES[kind]), length))
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1].properties.append(_Property(name, np.dtype(order + _TYPES[kind])))
            case _:
                raise CloudError(f'found "{line[:60]}" in the header, which PLY does not know.')
    if not encoding:
        raise CloudError("the header names no known format.")
    for element in elements:
        names = [each.name for each in element.properties]
        if any(each.length is not None and each.length.kind == "f" for each in element.properties):
            raise CloudError("the header is wrong: a list has a number of items that is not whole.")
        if len(set(names)) < len(names):
            raise CloudError(f"the header is wrong: {element.name[:40]} has two properties of one name.")
    return _Header(encoding, comments, elements, end)


def _read_tables(file: BinaryIO, header: _Header) -> tuple[Records, np.ndarray | None]:
    """The vertices, which are still in the file, and the profiles where they can be read."""
    vertices: Records | None = None
    profiles: np.ndarray | None = None
    text = header.encoding == "ascii"
    file.seek(header.length)
    for element in header.elements:
        # After the vertices nothing with lists is of use: the profiles are numbers, and follow at once.
        if vertices is not None and element.has_lists:
            break
        _check_length(file, element, text)
        if element.name == "vertex":
            vertices = _vertices(file, element, text)
        if element.name == "profile":
            profiles = np.concatenate([np.empty(0, element.dtype), *_blocks(file, element, text)])
        else:
            _pass_over(file, element, text)
    # Only the list itself says how long it is; without lists the header tells the size of the file.
    if not any(element.has_lists for element in header.elements) and _has_more(file):
        raise CloudError("the file goes on after the data that its header announces; it is damaged.")
    if vertices is None:
        raise CloudError("has no vertices that can be read.")
    if len(vertices) == 0:
        raise CloudError("holds no points.")
    return vertices, profiles


def _pass_over(file: BinaryIO, element: _Element, text: bool) -> None:
    if text:
        for _ in text_lines(file, element.rows if element.properties else 0):
            pass
    elif element.has_lists:
        for _ in _blocks(file, element, text):
            pass
    else:
        file.seek(element.rows * element.dtype.itemsize, os.SEEK_CUR)


def _has_more(file: BinaryIO) -> bool:
    """Whether more follows than the end of a line."""
    rest = file.read(_BLOCK)
    while rest and not rest.strip():
        rest = file.read(_BLOCK)
    return bool(rest)


def _check_length(file: BinaryIO, element: _Element, text: bool) -> None:
    """Compare what the header announces with what is left of the file, before memory is taken."""
    count, size = element.rows, os.fstat(file.fileno()).st_size
    # In text, a number takes a digit and a separator; an empty list takes only its number of items.
    needed = count * (2 * len(element.properties) if text else element.shortest) - (1 if text and count else 0)
    if needed > size - file.tell():
        raise CloudError(
            f"announces {count} of {element.name[:60]}, but the file ends before; it is damaged or cut short."
        )


def _vertices(file: BinaryIO, element: _Element, text: bool) -> Records:
    """The vertices from where the file is."""
    start = file.tell()

    def read() -> Iterator[np.ndarray]:
        file.seek(start)
        return _blocks(file, element, text)

    return Records(element.dtype, element.rows if element.dtype.names else 0, read)


def _blocks(file: BinaryIO, element: _Element, text: bool) -> Iterator[np.ndarray]:
    """The rows of a table from where the file is, without their lists."""
    dtype, left = element.dtype, element.rows
    if element.has_lists and not text:
        yield from _rows_with_lists(file, element)
        return
    while left and dtype.names:
        count = min(left, sizes.BLOCK_POINTS)
        lines = text_lines(file, count)
        if text:
            block = numbers_of((_without_lists(line, element) for line in lines) if element.has_lists else lines, dtype)
        else:
            block = np.fromfile(file, dtype, count)
        if len(block) != count:
            rows, columns = element.rows - left + len(block), len(dtype.names)
            raise ValueError(f"found {(rows, columns)}, expected {(element.rows, columns)}")
        yield block
        left -= count


def _without_lists(line: str, element: _Element) -> str:
    """The numbers of a row that are in no list."""
    words, at, kept = line.split(), 0, []
    for each in element.properties:
        if at >= len(words):
            raise ValueError("a row ends before its last property")
        if each.length is None:
            kept.append(words[at])
            at += 1
        else:
            length = int(words[at])
            if length < 0:
                raise ValueError("a list has fewer than no items")
            at += 1 + length
    if at != len(words):
        raise ValueError(f"a row has {len(words)} words, and its properties {at}")
    return " ".join(kept)


def _rows_with_lists(file: BinaryIO, element: _Element) -> Iterator[np.ndarray]:
    """Read binary rows with lists, about a block of the file at a time."""
    left, size, end = element.rows, _BLOCK, os.fstat(file.fileno()).st_size
    while left:
        start = file.tell()
        data = file.read(size)
        places, used, needed = _walk(data, element, left)
        if not len(places) and start + needed > end:
            raise ValueError(f"row {element.rows - left + 1} with its lists of items is longer than the file")
        # A row that is longer than a block is read anew, whole.
        size = max(_BLOCK, 0 if len(places) else needed)
        file.seek(start + used)
        block, raw = np.empty(len(places), element.dtype), np.frombuffer(data, np.uint8)
        for k, name in enumerate(element.dtype.names or ()):
            kind = element.dtype[name]
            block[name] = raw[places[:, k, None] + np.arange(kind.itemsize)].view(kind)[:, 0]
        yield block
        left -= len(places)


def _walk(data: bytes, element: _Element, most: int) -> tuple[np.ndarray, int, int]:
    """Locate the numbers outside lists, for all whole rows of a block.

    Returns:
        places: int [rows, numbers], in bytes from the beginning.
        used: Bytes of these rows.
        needed: Bytes that the row after them has at least, as far as it was seen.
    """
    order: Literal["big", "little"] = "big" if any(each.item.str[0] == ">" for each in element.properties) else "little"
    steps = [(each.item.itemsize, each.length) for each in element.properties]
    places: list[list[int]] = []
    used, at = 0, 0
    while len(places) < most:
        row: list[int] = []
        for item, length in steps:
            if length is None:
                row.append(at)
                at += item
            else:
                count = data[at : at + length.itemsize]
                at += length.itemsize
                if at > len(data):
                    break
                items = int.from_bytes(count, order, signed=length.kind == "i")
                if items < 0:
                    raise ValueError("a list has fewer than no items")
                at += items * item
        if at > len(data):
            break
        places.append(row)
        used = at
    width = sum(length is None for _, length in steps)
    return np.array(places, np.int64).reshape(len(places), width), used, at - used


# Int, because Open3D's reader skips ushort. The profiles hold the record, and the angle as a double.
VERTEX = np.dtype(
    [(name, "<f4" if name == "angle" else POINT[name].str) for name in POINT.names or () if name != "record"]
)
PROFILE = np.dtype([("angle", "<f8"), ("record", "<i4"), ("laser", "u1")])
"""A second element after the vertices, which other readers ignore: the values of each profile, also of those
without a point. The angle is in rad from home."""

JOINED_PROFILE = np.dtype([*((name, PROFILE[name].str) for name in PROFILE.names or ()), ("station", "u1")])

_TYPE_NAMES = {"<f4": "float", "<f8": "double", "<i4": "int", "|u1": "uchar"}
_GEOMETRY = {"x", "y", "z", "nx", "ny", "nz", "red", "green", "blue"}


def write_ply(cloud: PointCloud, path: Part, about: About) -> None:
    """Write the valid points as binary little-endian PLY; x, y and z are doubles where the cloud holds doubles.

    All but coordinates, normals and colours begin with `scalar_`: CloudCompare keeps only numbers of such names,
    and MeshLab would take `intensity` for the colour.
    """
    profiles = len(cloud.valid)
    vertex = record_of(VERTEX, cloud)
    header = ["ply", "format binary_little_endian 1.0"]
    header += [f"comment {line}" for line in (*header_lines(cloud, about), SEAL_LINE)]
    header += _element("vertex", int(np.count_nonzero(cloud.valid)), vertex)
    profile = PROFILE if cloud.stations is None else JOINED_PROFILE
    gridded = "grid" not in cloud.lacks
    header += _element("profile", profiles, profile, plain=True) if gridded else []
    per_profile = np.empty(profiles, profile)
    if cloud.stations is not None:
        per_profile["station"] = cloud.stations.number
    per_profile["angle"], per_profile["record"], per_profile["laser"] = cloud.angle, cloud.record, cloud.laser
    with open(path, "wb") as file:
        file.write("\n".join([*header, "end_header", ""]).encode("ascii"))
        for points in blocks(cloud):
            file.write(table(columns(points, cloud), vertex).data)
        if gridded:
            file.write(per_profile.data)
    seal(path)


def _element(name: str, count: int, dtype: np.dtype, *, plain: bool = False) -> list[str]:
    names = dtype.names or ()
    spelled = {field: field if plain or field in _GEOMETRY else f"scalar_{field}" for field in names}
    return [
        f"element {name} {count}",
        *(f"property {_TYPE_NAMES[dtype[field].str]} {spelled[field]}" for field in names),
    ]
