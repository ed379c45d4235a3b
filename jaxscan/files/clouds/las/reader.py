"""Reading LAS and LAZ: files of this library on their grid, others as a single row of points."""

import os
import struct
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.clouds.about import StoredCloud, about_of
from jaxscan.files.clouds.crs import epsg_of, is_in_metres
from jaxscan.files.clouds.grid import cloud_of
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
        sizes = _sizes_of(file, path)
        compressed = bool(sizes.kind & _COMPRESSED)
        laspy = load_laspy(compressed=compressed)
        _check(file, sizes, size, path)
        file.seek(0)
        try:
            # In one thread: several would take memory for each part as its size is stated.
            backend = laspy.LazBackend.Lazrs if compressed else None
            with laspy.LasReader(file, closefd=False, laz_backend=backend, read_evlrs=False) as reader:
                las = reader.read()
            if len(las.points) != sizes.points:
                raise ValueError(f"found {len(las.points)} points of {sizes.points}")
            points, lines, wkt = _points_of(las), _lines_of(las), _wkt_of(las)
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
    return StoredCloud(cloud_of(points, lines, str(path)), about)


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


def _points_of(las: Any) -> np.ndarray:
    """The columns that a cloud has, as records."""
    names = set(las.point_format.dimension_names)
    extra = list(las.point_format.extra_dimension_names)
    plain = dict(zip(plain_names(extra), extra, strict=True))
    values = {name: np.asarray(las[given]) for name, given in plain.items()}
    values = {name: value for name, value in values.items() if value.ndim == 1}
    # Before our extra bytes held the amplitude, it was in the 16 bits alone.
    values["intensity"] = values.get("amplitude", np.asarray(las.intensity).astype(np.float32))
    if "step" in values:
        values["laser"] = np.asarray(las.user_data)
        if "amplitude" not in values:
            values["intensity"] = values["intensity"] / np.float32(257)
    scales, offsets = np.array(las.header.scales), np.array(las.header.offsets)
    # NaN fails too; a negative step mirrors the cloud. Short, as the reader cuts what libraries say.
    wrong = [step for step in scales.tolist() if not 0 < step <= _LARGEST_STEP_M]
    if wrong or not np.isfinite(offsets).all():
        found = f"a step of its coordinates is {wrong[0]:g}" if wrong else "an offset is not finite"
        raise ValueError(f"{found}, expected steps above 0, up to {_LARGEST_STEP_M:g}")
    xyz = np.stack([np.asarray(las[axis]) for axis in "XYZ"], -1) * scales + offsets
    single = (np.abs(xyz).max(0) <= np.minimum(scales * _SINGLE_STEPS, _SINGLE_M)).all()
    values |= dict(zip("xyz", (xyz.astype(np.float32) if single else xyz).T, strict=True))
    if {"red", "green", "blue"} <= names:
        colours = np.stack([np.asarray(las[name]) for name in ("red", "green", "blue")])
        # Some programs write 8 bits into the 16.
        colours = colours if colours.max() < 256 else colours >> 8
        values |= dict(zip(("red", "green", "blue"), colours.astype(np.uint8), strict=True))
    points = np.empty(len(las.points), [(name, value.dtype.str) for name, value in values.items()])
    for name, value in values.items():
        points[name] = value
    return points


def _lines_of(las: Any) -> list[str]:
    for record in las.header.vlrs:
        if (record.user_id, record.record_id) == HEADER_RECORD:
            data = record.record_data_bytes()
            return [line[:4096] for line in data.decode("latin-1").splitlines()]
    return []


def _wkt_of(las: Any) -> str:
    found = las.header.vlrs.get("WktCoordinateSystemVlr")
    return str(found[0].string) if found else ""
