"""Reading LAS and LAZ: files of this library on their grid, others as a single row of points."""

import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.clouds import points as sizes
from jaxscan.files.clouds.about import StoredCloud, about_of
from jaxscan.files.clouds.columns import COLOURS, Reading, decide
from jaxscan.files.clouds.crs import Frame, epsg_of, epsg_of_keys, frame_of_keys, frame_of_wkt
from jaxscan.files.clouds.grid import Records, cloud_of
from jaxscan.files.clouds.las.compressed import Sizes, check_compressed
from jaxscan.files.clouds.las.library import load_laspy
from jaxscan.files.clouds.las.writer import HEADER_RECORD
from jaxscan.files.disk import open_regular


_SINGLE_STEPS = 1 << 20
"""Steps of a coordinate up to which a single holds it sixteen times finer than the file."""
_SINGLE_M = 1e6
_LARGEST_STEP_M = 1.0
"""Of a coordinate; no program writes a coarser one."""
_COMPRESSED = 0x80
_DOUBLES = 34736
"""Number of the record that holds the values of keys that are not whole."""
_MOST_BEHIND, _LONGEST_WKT = 1000, 1 << 20
_DAMAGE = (
    *(ValueError, TypeError, LookupError, AttributeError, ArithmeticError, EOFError, MemoryError, OSError),
    *(RuntimeError, struct.error),
)


def read_las(path: Path, reading: Reading | None = None) -> StoredCloud:
    """A cloud from a LAS or LAZ file of version 1.0 to 1.4.

    Raises:
        CloudError: If it is damaged, has no points, or would take far more memory than its size.
        DependencyError: If laspy, or lazrs for a compressed file, is not installed.
    """
    reading = reading or Reading()
    if reading.columns:
        raise CloudError(f"{path}: the columns of LAS are named by the format; leave --columns out.")
    with open_regular(path, error=CloudError) as file:
        size = os.fstat(file.fileno()).st_size
        given = _sizes_of(file, path)
        compressed = bool(given.kind & _COMPRESSED)
        laspy = load_laspy(compressed=compressed)
        _check(file, given, size, path)
        try:
            with _opened(laspy, file, compressed) as reader:
                lines = _lines_of(reader.header)
                wkt, keys = _wkt_of(reader.header) or _wkt_behind(file, size), _keys_of(reader.header)
            points, reached = _points_of(laspy, file, given)
            decided = decide(points, str(path), ours=bool(lines), reading=reading, reached=reached, by="the format")
            cloud = cloud_of(decided.points, lines, str(path))
        except (laspy.errors.LaspyException, *_DAMAGE) as problem:
            raise CloudError(
                f"{path}: not a readable LAS file: {(str(problem).splitlines() or [type(problem).__name__])[0]:.100}."
            ) from problem
        except BaseException as problem:
            # The library that unpacks is written in Rust, whose panics are no `Exception`.
            if type(problem).__name__ != "PanicException":
                raise
            raise CloudError(f"{path}: the compressed points are damaged.") from problem
    about = about_of(lines)._replace(upright=True)
    if about.epsg is None:
        about = about._replace(epsg=epsg_of(wkt) or epsg_of_keys(keys.whole))
    if lines and about.metres is not None:
        return StoredCloud(cloud, about)
    stated = [(frame_of_wkt(wkt), "WKT"), (frame_of_keys(*keys), "GeoKeys")]
    frame, why = next((one for one in stated if one[0] != Frame()), (Frame(), ""))
    why = f"the {why} of {path.name}" if frame.in_degrees else f"its {why}" if why else ""
    about = about._replace(metres=frame.metres, in_degrees=frame.in_degrees, unit_by=why)
    return StoredCloud(cloud, about, () if lines else decided.words)


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


def _points_of(laspy: Any, file: BinaryIO, given: Sizes) -> tuple[Records, tuple[float, bool]]:
    """All columns that a cloud may use, and the largest colour; without those of the format that are 0 throughout."""
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
    single, brightest, loudest = _looked_through(laspy, file, given, "red" in names)

    def columns(chunk: Any) -> dict[str, np.ndarray]:
        values = {name: np.asarray(chunk[name]) for name in extra if name not in "xyz"}
        values = {name: value for name, value in values.items() if value.ndim == 1}
        if "amplitude" in values:
            values["intensity"] = values.pop("amplitude")
        elif loudest:
            # Before our extra bytes held the amplitude, it was in the 16 bits alone.
            scale = np.float32(257 if "step" in values else 1)
            values["intensity"] = np.asarray(chunk["intensity"]).astype(np.float32) / scale
        if "step" in values:
            values["laser"] = np.asarray(chunk["user_data"])
        xyz = np.stack([np.asarray(chunk[axis]) for axis in "XYZ"], -1) * scales + offsets
        values |= dict(zip("xyz", (xyz.astype(np.float32) if single else xyz).T, strict=True))
        if set(COLOURS) <= names and brightest:
            values |= {name: np.asarray(chunk[name]) for name in COLOURS}
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
    return Records(typed(columns(none)), given.points, read), (float(brightest), True)


def _looked_through(laspy: Any, file: BinaryIO, given: Sizes, coloured: bool) -> tuple[bool, int, int]:
    """Whether singles hold the coordinates as finely as the file does, and its largest colour and intensity.

    Raises:
        ValueError: If the file has another number of points than its header says.
    """
    compressed = bool(given.kind & _COMPRESSED)
    parts = laspy.DecompressionSelection
    largest, brightest, loudest, found = np.zeros(3), 0, 0, 0
    wanted = parts.XY_RETURNS_CHANNEL | parts.Z | parts.RGB | parts.INTENSITY
    with _opened(laspy, file, compressed, wanted) as reader:
        scales, offsets = np.array(reader.header.scales), np.array(reader.header.offsets)
        for chunk in reader.chunk_iterator(sizes.BLOCK_POINTS):
            xyz = np.stack([np.asarray(chunk[axis]) for axis in "XYZ"], -1) * scales + offsets
            largest = np.maximum(largest, np.abs(xyz).max(0))
            if coloured:
                brightest = max(brightest, *(int(np.max(chunk[name])) for name in ("red", "green", "blue")))
            loudest = max(loudest, int(np.max(chunk["intensity"])))
            found += len(chunk)
    if found != given.points:
        raise ValueError(f"found {found} points of {given.points}")
    return bool((largest <= np.minimum(scales * _SINGLE_STEPS, _SINGLE_M)).all()), brightest, loudest


def _lines_of(header: Any) -> list[str]:
    for record in header.vlrs:
        if (record.user_id, record.record_id) == HEADER_RECORD:
            data = record.record_data_bytes()
            return [line[:4096] for line in data.decode("latin-1").splitlines()]
    return []


class _Keys(NamedTuple):
    """The keys of a GeoTIFF."""

    whole: dict[int, int]
    sizes: dict[int, float]


def _keys_of(header: Any) -> _Keys:
    found, doubles = header.vlrs.get("GeoKeyDirectoryVlr"), header.vlrs.get("GeoDoubleParamsVlr")
    keys = _Keys({}, {})
    # laspy keeps the numbers of a file as `c_double`, and those that a program gave it as they came.
    numbers = np.frombuffer(doubles[0].record_data_bytes(), "<f8") if doubles else np.zeros(0)
    for key in found[0].geo_keys if found else ():
        if key.tiff_tag_location == 0:
            keys.whole[int(key.id)] = int(key.value_offset)
        elif key.tiff_tag_location == _DOUBLES and key.value_offset < len(numbers):
            keys.sizes[int(key.id)] = float(numbers[key.value_offset])
    return keys


def _wkt_behind(file: BinaryIO, size: int) -> str:
    """The WKT in a record behind the points, where LAS 1.4 may have it."""
    file.seek(24)
    head = file.read(351)
    if len(head) < 351 or (head[0], head[1]) < (1, 4):
        return ""
    at, count = struct.unpack_from("<QI", head, 235 - 24)
    for _ in range(min(count, _MOST_BEHIND)):
        if not 0 < at <= size - 60:
            return ""
        file.seek(at)
        user, number, length = struct.unpack("<2x16sHQ32x", file.read(60))
        if (user.rstrip(b"\0"), number) == (b"LASF_Projection", 2112) and length <= min(_LONGEST_WKT, size - at - 60):
            return file.read(length).decode("latin-1").strip("\0")
        at += 60 + length
    return ""


def _wkt_of(header: Any) -> str:
    found = header.vlrs.get("WktCoordinateSystemVlr")
    return str(found[0].string) if found else ""
