"""LAS 1.4 and LAZ, the formats of surveying, through laspy, with the uncertainty of every point."""

import os
import struct
from collections.abc import Iterator, Sequence
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from jaxscan.errors import CloudError, DependencyError
from jaxscan.files.clouds import points as sizes
from jaxscan.files.clouds.columns import COLOURS, Reach, Reading, stored_cloud
from jaxscan.files.clouds.header import About, StoredCloud, frame_of, header_lines
from jaxscan.files.clouds.placing import (
    LOCAL_WKT,
    FileFrame,
    epsg_of,
    epsg_of_keys,
    frame_of_keys,
    frame_of_wkt,
    wkt_of,
)
from jaxscan.files.clouds.points import Records, blocks, columns, known_names
from jaxscan.files.disk import Part
from jaxscan.reconstruction import CloudPoints, PointCloud


def load_laspy(*, compressed: bool) -> Any:
    """The module."""
    missing = DependencyError('LAS and LAZ need laspy and lazrs: pip install "jaxscan[export]"')
    try:
        import laspy
    except ImportError as problem:
        raise missing from problem
    if compressed and not laspy.LazBackend.detect_available():
        raise missing
    return laspy


# Sizes within a LAZ file, compared with its length before the library takes memory for them.
#
# Source: LASzip 3.4, "LAZ specification" (M. Isenburg).

MAX_EXPANSION = 64
"""Largest accepted ratio of the points to the size of a compressed file; a MiB more is always accepted."""
_SMALL = 1 << 20
_LAYERED = 3
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
"""Layers of an item by its type: points, colours, colours with infrared, waves. Type 14 has a layer for each byte."""


class Sizes(NamedTuple):
    """The numbers of a header that decide how much memory is taken."""

    head: int
    offset: int
    records: int
    kind: int
    point_bytes: int
    points: int

    @property
    def compressed(self) -> bool:
        """Whether it is a LAZ file."""
        return bool(self.kind & _COMPRESSED)


def check_compressed(file: BinaryIO, sizes: Sizes, size: int) -> None:
    """Check the points, their parts, and the layers of each part."""
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
        # A chunk holds its first point uncompressed, its number of points, the length of each layer, and the layers.
        at += sizes.point_bytes + 4
        at += 4 * layers + sum(struct.unpack(f"<{layers}I", _bytes_at(file, at, 4 * layers)))
        if at > table:
            raise ValueError("a part of its compressed points is longer than the file")


def _layers(file: BinaryIO, sizes: Sizes) -> int:
    """How many layers a chunk of points has; 0 for formats without layers."""
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


_SINGLE_STEPS = 1 << 20
"""Steps of a coordinate up to which a single holds it sixteen times finer than the file."""
_SINGLE_M = 1e6
_LARGEST_STEP_M = 1.0
_COMPRESSED = 0x80
_DOUBLES = 34736
_MOST_BEHIND, _LONGEST_WKT = 1000, 1 << 20


def read_las(file: BinaryIO, reading: Reading) -> StoredCloud:
    """A cloud from a LAS or LAZ file of version 1.0 to 1.4."""
    size = os.fstat(file.fileno()).st_size
    given = _sizes_of(file)
    laspy = load_laspy(compressed=given.compressed)
    _check(file, given, size)
    try:
        with _opened(laspy, file, given) as reader:
            lines = _lines_of(reader.header)
            wkt, keys = _wkt_of(reader.header) or _wkt_behind(file, size), _keys_of(reader.header)
        points, reach = _points_of(laspy, file, given)
        stored = stored_cloud(points, lines, reading, reach=reach, by="the format")
    except laspy.errors.LaspyException as problem:
        raise ValueError(str(problem)) from problem
    except BaseException as problem:
        # The library that unpacks is written in Rust, whose panics are no `Exception`.
        if type(problem).__name__ != "PanicException":
            raise
        raise CloudError("the compressed points are damaged.") from problem
    about = stored.about._replace(upright=True)
    if about.epsg is None:
        about = about._replace(epsg=epsg_of(wkt) or epsg_of_keys(keys.whole))
    if about.metres is None:
        stated = [(frame_of_wkt(wkt), "WKT"), (frame_of_keys(*keys), "GeoKeys")]
        frame, why = next(((one, f"its {kind}") for one, kind in stated if one != FileFrame()), (FileFrame(), ""))
        why = why or ("its WKT states no unit that is known" if wkt else "")
        about = about._replace(metres=frame.metres, in_degrees=frame.in_degrees, unit_by=why)
    return stored._replace(about=about)


def _opened(laspy: Any, file: BinaryIO, given: Sizes, only: Any = None) -> Any:
    """A reader of the file from its beginning; of compressed points perhaps of some parts only."""
    file.seek(0)
    # In one thread: several would take memory for each part as its size is stated.
    backend = laspy.LazBackend.Lazrs if given.compressed else None
    selected = {} if only is None else {"decompression_selection": only}
    return laspy.LasReader(file, closefd=False, laz_backend=backend, read_evlrs=False, **selected)


def _sizes_of(file: BinaryIO) -> Sizes:
    head = file.read(375)
    if len(head) < 227 or head[:4] != b"LASF":
        raise CloudError("not a LAS file.")
    length, offset, records = struct.unpack_from("<HII", head, 94)
    kind, point_bytes, points = struct.unpack_from("<BHI", head, 104)
    if (head[24], head[25]) >= (1, 4) and len(head) == 375:
        points = struct.unpack_from("<Q", head, 247)[0]
    if points == 0:
        raise CloudError("holds no points.")
    return Sizes(length, offset, records, kind, point_bytes, points)


def _check(file: BinaryIO, sizes: Sizes, size: int) -> None:
    """Compare what the header announces with the size of the file, before memory is taken."""
    # A record has a head of 54 bytes.
    if sizes.offset > size or sizes.records * 54 > sizes.offset:
        raise CloudError("the header is longer than the file; it is damaged or cut short.")
    if sizes.compressed:
        try:
            check_compressed(file, sizes, size)
        except (ValueError, struct.error) as problem:
            raise CloudError(f"{problem}; it is damaged or cut short.") from problem
    elif sizes.points * sizes.point_bytes > size - sizes.offset:
        raise CloudError(f"announces {sizes.points} points, but the file ends before; it is damaged or cut short.")


def _points_of(laspy: Any, file: BinaryIO, given: Sizes) -> tuple[Records, Reach]:
    """All columns that a cloud may use, except those of the format that are 0 everywhere; and the largest colour."""
    with _opened(laspy, file, given) as reader:
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
        with _opened(laspy, file, given) as reader:
            for chunk in reader.chunk_iterator(sizes.BLOCK_POINTS):
                values = columns(chunk)
                points = np.empty(len(chunk), typed(values))
                for name, value in values.items():
                    points[name] = value
                yield points

    none = laspy.ScaleAwarePointRecord.zeros(0, header=header)
    return Records(typed(columns(none)), given.points, read), Reach(float(brightest))


def _looked_through(laspy: Any, file: BinaryIO, given: Sizes, coloured: bool) -> tuple[bool, int, int]:
    """Whether singles hold the coordinates as finely as the file does, and its largest colour and intensity."""
    parts = laspy.DecompressionSelection
    largest, brightest, loudest, found = np.zeros(3), 0, 0, 0
    wanted = parts.XY_RETURNS_CHANNEL | parts.Z | parts.RGB | parts.INTENSITY
    with _opened(laspy, file, given, wanted) as reader:
        scales, offsets = np.array(reader.header.scales), np.array(reader.header.offsets)
        for chunk in reader.chunk_iterator(sizes.BLOCK_POINTS):
            xyz = np.stack([np.asarray(chunk[axis]) for axis in "XYZ"], -1) * scales + offsets
            largest = np.maximum(largest, np.abs(xyz).max(0))
            if coloured:
                brightest = max(brightest, *(int(np.max(chunk[name])) for name in COLOURS))
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


SCALE_M = 1e-4
"""Step of the stored coordinates: a tenth of a millimetre."""
COARSEST_M = 1e-3
"""Largest step, for clouds of more than 429 km."""
_STEPS = (1 << 31) - 1
"""Largest stored number of steps from the offset."""
HEADER_RECORD = ("jaxscan", 1)
"""User and number of the record that holds the lines of `header_lines`."""
_EXTRA = {
    "amplitude": "of the stripe [DN]",
    "sigma": "std. dev. along ray [m]",
    "sigma_random": "part by the noise [m]",
    "sigma_systematic": "shared part [m]",
    "normal_x": "towards the camera",
    "normal_y": "towards the camera",
    "normal_z": "towards the camera",
    "step": "profile of the grid",
    "row": "line of the grid",
    "angle": "of the profile [rad]",
    "record": "of the capture",
    "sigma_row": "noise, of the row alone [m]",
    "shift_px": "centre of the row - this [px]",
    "shared_lines": "lines that share its noise",
    "station": "place of the scanner",
}
_TYPES = {"step": np.int32, "row": np.int32, "record": np.int32, "angle": np.float64, "station": np.uint8}


def write_las(cloud: PointCloud, path: Part, about: About) -> None:
    """Write the valid points: point format 7, colours and intensity in 16 bit, extra bytes, the frame as WKT.

    The suffix `.laz` compresses. Intensity is the amplitude in 1/257 DN, or coarser where the largest would not fit;
    the extra bytes hold it in DN. A record of our own holds digest, grid and stations.
    """
    laspy = load_laspy(compressed=path.suffix.lower() == ".laz")
    # Point format 6 has no colours.
    header = laspy.LasHeader(point_format=6 if "rgb" in cloud.lacks else 7, version="1.4")
    header.offsets, header.scales = _placed(cloud)
    header.generating_software = "jaxscan"
    # Point formats 6 to 10 have their frame as WKT.
    header.global_encoding.wkt = True
    wkt = LOCAL_WKT.format(frame=frame_of(cloud.stations)) if about.epsg is None else wkt_of(about.epsg)
    header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(wkt))
    text = "\n".join(header_lines(cloud, about)).encode("ascii")
    header.vlrs.append(laspy.VLR(*HEADER_RECORD, "header of the cloud", text))
    extra = known_names(_EXTRA, cloud)
    header.add_extra_dims([laspy.ExtraBytesParams(name, _TYPES.get(name, np.float32), _EXTRA[name]) for name in extra])
    brightest = (
        0.0 if "intensity" in cloud.lacks else float(np.max(cloud.intensity, where=cloud.valid, initial=-np.inf))
    )
    scale = 257.0 if brightest <= 255 else 65535 / brightest
    try:
        # Opened here, for the writer leaves its file open where the disk is full.
        with (
            open(path, "w+b") as file,
            laspy.LasWriter(file, header, do_compress=path.suffix.lower() == ".laz", closefd=False) as writer,
        ):
            for points in blocks(cloud):
                writer.write_points(_record(laspy, header, points, cloud, extra, scale))
    except Exception as problem:
        # lazrs, which is loaded for compressed points alone, has an error of its own for a disk that takes no more.
        if type(problem).__name__ != "LazrsError":
            raise
        raise OSError(f"the points cannot be packed onto the disk ({problem})") from problem


def _record(laspy: Any, header: Any, points: CloudPoints, cloud: PointCloud, extra: Sequence[str], scale: float) -> Any:
    values = columns(points, cloud)
    values |= {"amplitude": points.intensity}
    values |= {f"normal_{axis}": values[f"n{axis}"] for axis in "xyz"}
    record = laspy.ScaleAwarePointRecord.zeros(len(points.step), header=header)
    for axis, places in zip("xyz", points.xyz.astype(np.float64).T, strict=True):
        record[axis] = places
    if "rgb" not in cloud.lacks:
        for name, colours in zip(COLOURS, points.rgb.astype(np.uint16).T * np.uint16(257), strict=True):
            record[name] = colours
    record["intensity"] = np.clip(np.round(points.intensity.astype(np.float64) * scale), 0, 65535).astype(np.uint16)
    record["return_number"] = record["number_of_returns"] = np.ones(len(points.step), np.uint8)
    record["user_data"] = points.laser
    for name in extra:
        record[name] = values[name]
    return record


def _placed(cloud: PointCloud) -> tuple[np.ndarray, np.ndarray]:
    """Offset and step [3] with which 32-bit numbers hold the coordinates: offset 0 where that suffices."""
    ends = np.array([(points.xyz.min(0), points.xyz.max(0)) for points in blocks(cloud)], np.float64)
    lowest, highest = ends[:, 0].min(0), ends[:, 1].max(0)
    if max(np.abs(lowest).max(), np.abs(highest).max()) <= SCALE_M * _STEPS:
        return np.zeros(3), np.full(3, SCALE_M)
    # The offset is in whole metres, so it is exact. One metre is left for this rounding.
    offset = np.round(lowest / 2 + highest / 2)
    reach = float((highest / 2 - lowest / 2).max()) + 1.0
    scale = SCALE_M if reach <= SCALE_M * _STEPS else COARSEST_M
    if reach > scale * _STEPS:
        raise CloudError(
            f"LAS holds points at most {2 * COARSEST_M * _STEPS / 1e3:.0f} km apart, and these are "
            f"{reach / 500:.3g} km apart; remove the ones far away, or choose .ply."
        )
    return offset, np.full(3, scale)
