"""Reading LAS and LAZ: files of this library on their grid, others as a single row of points."""

import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.clouds import points as sizes
from jaxscan.files.clouds.about import StoredCloud, about_of
from jaxscan.files.clouds.crs import epsg_of, is_in_metres
from jaxscan.files.clouds.grid import Records, cloud_of
from jaxscan.files.clouds.las.compressed import Sizes, check_compressed
from jaxscan.files.clouds.las.library import load_laspy
from jaxscan.files.clouds.las.writer import HEADER_RECORD
from jaxscan.files.clouds.points import plain_names
from jaxscan.files.disk import open_regular


_SINGLE_STEPS = 1 << 20
"""Steps of a coordinate up to which a single holds it sixteen times finer than the file."""
_SINGLE_M = 1e6
_LARGEST_STEP_M = 1.0
"""Of a coordinate; no program writes a coarser one."""
_COMPRESSED = 0x80
_DAMAGE = (
    *(ValueError, TypeError, LookupError, AttributeError, ArithmeticError, EOFError, MemoryError, OSError),
    *(RuntimeError, struct.error),
)


def read_las(path: Path) -> StoredCloud:
    """A cloud from a LAS or LAZ file of version 1.0 to 1.4.

    Raises:
        CloudError: If it is damaged, has no points, or would take far more memory than its size.
        DependencyError: If laspy, or lazrs for a compressed file, is not installed.
    """
    with open_regular(path, error=CloudError) as file:
        size = os.fstat(file.fileno()).st_size
        given = _sizes_of(file, path)
        compressed = bool(given.kind & _COMPRESSED)
        laspy = load_laspy(compressed=compressed)
        _check(file, given, size, path)
        try:
            with _opened(laspy, file, compressed) as reader:
                lines, wkt = _lines_of(reader.header), _wkt_of(reader.header)
            cloud = cloud_of(_points_of(laspy, file, given), lines, str(path))
        except (laspy.errors.LaspyException, *_DAMAGE) as problem:
            raise CloudError(
                f"{path}: not a readable LAS file: {(str(problem).splitlines() or [type(problem).__name__])[0]:.100}."
            ) from problem
        except BaseException as problem:
            # The library that unpacks is written in Rust, whose panics are no `Exception`.
            if type(problem).__name__ != "PanicException":
                raise
            raise CloudError(f"{path}: the compressed points are damaged.") from problem
    about = about_of(lines)
    if about.epsg is None:
        about = about._replace(epsg=epsg_of(wkt))
    about = about._replace(in_metres=about.in_metres or is_in_metres(wkt), upright=True)
    return StoredCloud(cloud, about)


def _opened(laspy: Any, file: BinaryIO, compressed: bool, only: Any = None) -> Any:
    """A reader of the file from its beginning; of compressed points perhaps of some parts only."""
    file.seek(0)
    # In one thread: several would take memory for each part as its size is stated.
    backend = laspy.LazBackend.Lazrs if compressed else None
    selected = {} if only is None else {"decompression_selection": only}
    return laspy.LasReader(file, closefd=False, laz_backend=backend, read_evlrs=False, **selected)


def _sizes_of(file: BinaryIO, path: Path) -> Sizes:
    head = file.read(375)
    if len(head) < 227 or head[:4] != b"LASF":
        raise CloudError(f"{path}: not a LAS file.")
    length, offset, records = struct.unpack_from("<HII", head, 94)
    kind, point_bytes, points = struct.unpack_from("<BHI", head, 104)
    if (head[24], head[25]) >= (1, 4) and len(head) == 375:
        points = struct.unpack_from("<Q", head, 247)[0]
    if points == 0:
        raise CloudError(f"{path}: holds no points.")
    return Sizes(length, offset, records, kind, point_bytes, points)


def _check(file: BinaryIO, sizes: Sizes, size: int, path: Path) -> None:
    """Compare what the header announces with the size of the file, before memory is taken."""
    # A record has a head of 54 bytes.
    if sizes.offset > size or sizes.records * 54 > sizes.offset:
        raise CloudError(f"{path}: the header is longer than the file; it is damaged or cut short.")
    if sizes.kind & _COMPRESSED:
        try:
            check_compressed(file, sizes, size)
        except (ValueError, struct.error) as problem:
            raise CloudError(f"{path}: {problem}; it is damaged or cut short.") from problem
    elif sizes.points * sizes.point_bytes > size - sizes.offset:
        raise CloudError(
            f"{path}: announces {sizes.points} points, but the file ends before; it is damaged or cut short."
        )


def _points_of(laspy: Any, file: BinaryIO, given: Sizes) -> Records:
    """The columns that a cloud has, as records."""
    compressed = bool(given.kind & _COMPRESSED)
    with _opened(laspy, file, compressed) as reader:
        header = reader.header
    scales, offsets = np.array(header.scales), np.array(header.offsets)
    if not (np.isfinite(scales).all() and np.isfinite(offsets).all()):
        raise ValueError("the steps or offsets of its coordinates are not finite")
    if not ((scales > 0) & (scales <= _LARGEST_STEP_M)).all():
        words = ", ".join(f"{one:g}" for one in scales)
        raise ValueError(f"steps of {words} m mirror or squash it, expected above 0 and up to {_LARGEST_STEP_M:g} m")
    names, extra = set(header.point_format.dimension_names), list(header.point_format.extra_dimension_names)
    single, brightest = _looked_through(laspy, file, given, "red" in names)

    def columns(chunk: Any) -> dict[str, np.ndarray]:
        plain = dict(zip(plain_names(extra), extra, strict=True))
        values = {name: np.asarray(chunk[stored]) for name, stored in plain.items()}
        values = {name: value for name, value in values.items() if value.ndim == 1}
        # Before our extra bytes held the amplitude, it was in the 16 bits alone.
        values["intensity"] = values.get("amplitude", np.asarray(chunk["intensity"]).astype(np.float32))
        if "step" in values:
            values["laser"] = np.asarray(chunk["user_data"])
            if "amplitude" not in values:
                values["intensity"] = values["intensity"] / np.float32(257)
        xyz = np.stack([np.asarray(chunk[axis]) for axis in "XYZ"], -1) * scales + offsets
        values |= dict(zip("xyz", (xyz.astype(np.float32) if single else xyz).T, strict=True))
        if {"red", "green", "blue"} <= names:
            colours = np.stack([np.asarray(chunk[name]) for name in ("red", "green", "blue")])
            # Some programs write 8 bits into the 16.
            colours = colours if brightest < 256 else colours >> 8
            values |= dict(zip(("red", "green", "blue"), colours.astype(np.uint8), strict=True))
        return values

    def typed(values: dict[str, np.ndarray]) -> np.dtype:
        return np.dtype([(name, value.dtype.str) for name, value in values.items()])

    def read() -> Iterator[np.ndarray]:
        with _opened(laspy, file, compressed) as reader:
            for chunk in reader.chunk_iterator(sizes.BLOCK_POINTS):
                values = columns(chunk)
                points = np.empty(len(chunk), typed(values))
                for name, value in values.items():
                    points[name] = value
                yield points

    none = laspy.ScaleAwarePointRecord.zeros(0, header=header)
    return Records(typed(columns(none)), given.points, read)


def _looked_through(laspy: Any, file: BinaryIO, given: Sizes, coloured: bool) -> tuple[bool, int]:
    """Whether singles hold the coordinates as finely as the file does, and its largest colour.

    Raises:
        ValueError: If the file has another number of points than its header says.
    """
    compressed = bool(given.kind & _COMPRESSED)
    parts = laspy.DecompressionSelection
    largest, brightest, found = np.zeros(3), 0, 0
    with _opened(laspy, file, compressed, parts.XY_RETURNS_CHANNEL | parts.Z | parts.RGB) as reader:
        scales, offsets = np.array(reader.header.scales), np.array(reader.header.offsets)
        for chunk in reader.chunk_iterator(sizes.BLOCK_POINTS):
            xyz = np.stack([np.asarray(chunk[axis]) for axis in "XYZ"], -1) * scales + offsets
            largest = np.maximum(largest, np.abs(xyz).max(0))
            if coloured:
                brightest = max(brightest, *(int(np.max(chunk[name])) for name in ("red", "green", "blue")))
            found += len(chunk)
    if found != given.points:
        raise ValueError(f"found {found} points of {given.points}")
    return bool((largest <= np.minimum(scales * _SINGLE_STEPS, _SINGLE_M)).all()), brightest


def _lines_of(header: Any) -> list[str]:
    for record in header.vlrs:
        if (record.user_id, record.record_id) == HEADER_RECORD:
            data = record.record_data_bytes()
            return [line[:4096] for line in data.decode("latin-1").splitlines()]
    return []


def _wkt_of(header: Any) -> str:
    found = header.vlrs.get("WktCoordinateSystemVlr")
    return str(found[0].string) if found else ""
