"""Reading PLY: files of this library on their grid, others as a single row of points."""

import os
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.clouds.ply import CLOUD_FORMAT, PROFILE, VERTEX
from jaxscan.files.disk import open_regular
from jaxscan.reconstruction import SMOOTHED, PointCloud


MAX_HEADER_BYTES = 64 << 10
MAX_CELLS = 1 << 28
"""Largest accepted grid, 13 GB: 18 000 steps of two lasers on 7000 lines."""
SPARSE_CELLS = 1 << 24
"""Largest grid however few its points, 0.7 GB, where the file lists the profiles: 8000 steps on 2000 lines."""
SPARSE_CELLS_UNLISTED = 1 << 22
"""The same where it does not list them."""
CELLS_PER_POINT = 256
"""Of a larger grid with fewer points, the points are read alone."""

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


def read_ply(path: Path) -> PointCloud:
    """A cloud from a PLY file, ASCII or binary.

    A file of this library is read onto its grid, unless its points are too few for so large a one. Of other
    files, `x y z` and, where present, colours, normals, intensity and sigmas are read, as a single profile.

    Raises:
        CloudError: If it is damaged or has no points.
    """
    try:
        with open_regular(path, error=CloudError) as file:
            header = _read_header(file, path)
            size = os.fstat(file.fileno()).st_size
            tables = _read_tables(file, header, size, path)
    except (OSError, EOFError) as problem:
        raise CloudError(f"{path}: cannot be read: {getattr(problem, 'strerror', None) or problem}.") from problem
    vertices = tables["vertex"]
    versions = [comment for comment in header.comments if comment.startswith("jaxscan-cloud/")]
    if versions and versions[0] != CLOUD_FORMAT:
        raise CloudError(
            f"{path}: found {versions[0][:60]}, expected {CLOUD_FORMAT}; a newer version of jaxscan reads it."
        )
    # Another program may have kept the comments but dropped the columns.
    names = set(vertices.dtype.names or ())
    if versions and names >= set(VERTEX.names or ()) and len(names & set(SMOOTHED)) in (0, len(SMOOTHED)):
        return _organised(vertices, tables.get("profile"), header.comments, path)
    return _unorganised(vertices, path, ours=bool(versions))


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


def _read_tables(file: BinaryIO, header: _Header, size: int, path: Path) -> dict[str, np.ndarray]:
    """The tables up to the first that cannot be read, which must come after the vertices."""
    tables: dict[str, np.ndarray] = {}
    file.seek(header.length)
    listless = [element for element in header.elements if element.dtype is not None]
    for element in header.elements:
        if element.dtype is None:
            break
        table = _read_table(file, element, header.encoding == "ascii", size, path)
        if element.name in ("vertex", "profile"):
            tables[element.name] = table
    # The length of a list is in the list alone; without lists the header says where the file ends.
    if len(listless) == len(header.elements) and _has_more(file):
        raise CloudError(f"{path}: the file goes on after the data that its header announces; it is damaged.")
    vertices = tables.get("vertex")
    if vertices is None:
        raise CloudError(f"{path}: has no vertices that can be read; lists in or before them are not supported.")
    if not {"x", "y", "z"} <= set(vertices.dtype.names or ()):
        raise CloudError(f"{path}: the vertices have no x, y and z.")
    if len(vertices) == 0:
        raise CloudError(f"{path}: holds no points.")
    return tables


def _has_more(file: BinaryIO) -> bool:
    """Whether more follows than the end of a line."""
    rest = file.read(_BLOCK)
    while rest and not rest.strip():
        rest = file.read(_BLOCK)
    return bool(rest)


def _read_table(file: BinaryIO, element: _Element, ascii_text: bool, size: int, path: Path) -> np.ndarray:
    dtype, count = element.dtype or np.dtype([]), element.rows
    properties = len(dtype.names or ())
    # As text, a number takes a digit and a separator. Nothing is allocated before this check.
    needed = count * (2 * properties if ascii_text else dtype.itemsize) - (1 if ascii_text and count else 0)
    if needed > size - file.tell():
        raise CloudError(
            f"{path}: announces {count} of {element.name[:60]}, but the file ends before; it is damaged or cut short."
        )
    if count == 0 or properties == 0:
        return np.zeros(count if properties else 0, dtype)
    if not ascii_text:
        return np.fromfile(file, dtype, count)
    try:
        lines = (line.decode("latin-1") for line in (file.readline(1 << 16) for _ in range(count)))
        values = np.loadtxt(lines, np.float64, comments=None, ndmin=2)
    except ValueError as problem:
        raise CloudError(f"{path}: {element.name[:60]}: not a table of numbers: {str(problem)[:60]}.") from problem
    if values.shape != (count, properties):
        raise CloudError(f"{path}: {element.name[:60]}: found {values.shape}, expected {(count, properties)}.")
    table = np.empty(count, dtype)
    for name, column in zip(dtype.names or (), values.T, strict=True):
        if dtype[name].kind in "iu":
            limits = np.iinfo(dtype[name])
            column = np.clip(np.nan_to_num(column), limits.min, limits.max)
        with np.errstate(over="ignore"):
            table[name] = column
    return table


def _organised(
    vertices: np.ndarray, per_profile: np.ndarray | None, comments: tuple[str, ...], path: Path
) -> PointCloud:
    words = next((comment.split() for comment in comments if comment.startswith("grid ")), [])
    if len(words) != 3 or not all(word.isascii() and word.isdigit() and len(word) < 12 for word in words[1:]):
        raise CloudError(f'{path}: the comment "grid <profiles> <lines>" is missing or wrong.')
    profiles, lines = int(words[1]), int(words[2])
    if not 0 < profiles * lines <= MAX_CELLS:
        raise CloudError(
            f"{path}: found a grid of {profiles} x {lines}, none or more than the {MAX_CELLS} cells that a cloud can "
            "have; it is damaged."
        )
    step, row = vertices["step"], vertices["row"]
    if step.min() < 0 or step.max() >= profiles or row.min() < 0 or row.max() >= lines:
        raise CloudError(f"{path}: a point lies outside the grid of {profiles} x {lines}.")
    # "sigma" follows from the others and is not used.
    smoothed = [name for name in SMOOTHED if name in (vertices.dtype.names or ())]
    for name in (*(VERTEX.names or ()), *smoothed):
        if name != "sigma" and not np.isfinite(vertices[name]).all():
            raise CloudError(f"{path}: {name} of a point is not finite.")
    listed = per_profile is not None and len(per_profile) == profiles
    if profiles * lines > max(SPARSE_CELLS if listed else SPARSE_CELLS_UNLISTED, CELLS_PER_POINT * len(vertices)):
        # A few points ask for gigabytes.
        return _unorganised(vertices, path, ours=True)
    valid = np.zeros((profiles, lines), bool)
    valid[step, row] = True
    if np.count_nonzero(valid) != len(vertices):
        raise CloudError(f"{path}: two points have the same step and row.")

    def spread(dtype: type, *names: str) -> np.ndarray:
        field: np.ndarray = np.zeros((profiles, lines, len(names)), dtype)
        for k, name in enumerate(names):
            field[step, row, k] = vertices[name]
        return field if len(names) > 1 else field[..., 0]

    if per_profile is not None and set(PROFILE.names or ()) <= set(per_profile.dtype.names or ()):
        if len(per_profile) != profiles or not np.isfinite(per_profile["angle"]).all():
            raise CloudError(f"{path}: found {len(per_profile)} profiles, expected {profiles} with finite angles.")
        angle = per_profile["angle"].astype(np.float64)
        record, laser = per_profile["record"].astype(np.int32), per_profile["laser"].astype(np.int32)
    else:
        angle, record, laser = np.zeros(profiles), np.arange(profiles, dtype=np.int32), np.zeros(profiles, np.int32)
        laser[step] = vertices["laser"]
    return PointCloud(
        xyz=spread(_coordinates(vertices), "x", "y", "z"),
        rgb=spread(np.uint8, "red", "green", "blue"),
        intensity=spread(np.float32, "intensity"),
        normals=spread(np.float32, "nx", "ny", "nz"),
        sigma_random=spread(np.float32, "sigma_random"),
        sigma_systematic=spread(np.float32, "sigma_systematic"),
        valid=valid,
        record=record,
        laser=laser,
        angle=angle,
        **{name: spread(np.float32, name) for name in smoothed},
    )


def _coordinates(vertices: np.ndarray) -> type:
    """Type of the coordinates: a national grid needs the double that it came in."""
    return np.float32 if all(vertices.dtype[name].itemsize <= 4 for name in "xyz") else np.float64


def _unorganised(vertices: np.ndarray, path: Path, *, ours: bool) -> PointCloud:
    names = vertices.dtype.names or ()
    dtype = _coordinates(vertices)

    def column(*spellings: str) -> np.ndarray:
        for name in spellings:
            if name in names:
                # Values out of range become infinite, and are dropped below.
                with np.errstate(over="ignore"):
                    return vertices[name].astype(dtype)
        return np.zeros(len(vertices), dtype)

    xyz = np.stack([column(name) for name in "xyz"], -1)
    valid = np.isfinite(xyz).all(-1)
    if not valid.any():
        raise CloudError(f"{path}: holds no finite point.")
    normals = np.stack([column(name, f"normal_{name[1]}") for name in ("nx", "ny", "nz")], -1)
    # A part of a normal is another direction.
    whole = {"nx", "ny", "nz"} <= set(names) or {"normal_x", "normal_y", "normal_z"} <= set(names)
    with np.errstate(over="ignore"):
        lengths = np.sqrt((normals * normals).sum(-1, keepdims=True))
    usable = valid[:, None] & np.isfinite(lengths) & (lengths > 0) & whole
    # Without the grid nobody knows which points share their noise: each claims the sigma of its own row.
    own = "sigma_row" if {"sigma_row", "scalar_sigma_row"} & set(names) else "sigma_random"
    scalars = [column(name, f"scalar_{name}") for name in ("intensity", own, "sigma_systematic")]
    intensity, sigma_random, sigma_systematic = (np.where(valid & np.isfinite(one), one, 0) for one in scalars)
    shared = own == "sigma_random" and set(SMOOTHED) & set(names)
    if ours and (shared or not {"sigma_random", "sigma_systematic"} <= set(names)):
        # Ours have all. With one lost another would be taken for all of the uncertainty.
        sigma_random, sigma_systematic = np.zeros_like(sigma_random), np.zeros_like(sigma_systematic)
    return PointCloud(
        xyz=np.where(valid[:, None], xyz, 0)[None],
        rgb=np.where(valid[:, None], _colours(vertices), 0).astype(np.uint8)[None],
        intensity=intensity[None],
        normals=np.where(usable, normals / np.where(usable, lengths, 1), 0)[None],
        sigma_random=sigma_random[None],
        sigma_systematic=sigma_systematic[None],
        valid=valid[None],
        record=np.zeros(1, np.int32),
        laser=np.zeros(1, np.int32),
        angle=np.zeros(1),
    )


def _colours(vertices: np.ndarray) -> np.ndarray:
    names = vertices.dtype.names or ()
    if not {"red", "green", "blue"} <= set(names):
        return np.zeros((len(vertices), 3), np.uint8)
    colours = np.stack([vertices[name] for name in ("red", "green", "blue")], -1)
    if colours.dtype == np.uint8:
        return colours
    if colours.dtype.kind == "f":
        return (np.clip(np.nan_to_num(colours), 0, 1) * 255 + 0.5).astype(np.uint8)
    return (colours >> 8 if colours.dtype.itemsize == 2 else np.clip(colours, 0, 255)).astype(np.uint8)
