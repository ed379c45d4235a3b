"""Writing E57 through pye57's binding of libE57."""

import contextlib
import time
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.clouds.about import About, header_lines, lines_of_grid
from jaxscan.files.clouds.crs import wkt_of
from jaxscan.files.clouds.e57.library import COLUMNS, NORMALS_URI, OWN, OWN_URI, load_libe57
from jaxscan.files.clouds.e57.pictures import Surroundings, append_panorama, append_photograph
from jaxscan.files.clouds.points import blocks, columns, known_names, smoothed_names
from jaxscan.files.clouds.stations import covariance_text
from jaxscan.files.disk import Part
from jaxscan.geometry import quaternion
from jaxscan.reconstruction import PointCloud, Stations, of_station


_OURS = ("sigma", "sigma_random", "sigma_systematic", "laser", "angle", "record")
"""Columns that only an extension has a place for."""
_COLOURS = ("colorRed", "colorGreen", "colorBlue")
_ENDS = ((0, "Minimum"), (1, "Maximum"))
_GPS_EPOCH_S, _LEAP_S = 315964800, 18
"""GPS time counts from 1980-01-06 without leap seconds."""


def write_e57(cloud: PointCloud, path: Part, about: About, around: Surroundings | None = None) -> None:
    """Write one scan for each station: metres, pose, row and column index, colour, intensity [DN], normals.

    The column is the profile of the station, the row the line. Points are in the station's own frame; the pose of the
    scan carries them into that of the room, and its description holds digest and covariance. Coordinates are float32,
    or float64 where the cloud holds it; intensity is float32. Sigmas, laser, angle and record are an extension.
    What is around belongs to the first scan.

    Raises:
        CloudError: If the EPSG code is none in metres.
        DependencyError: If pye57, or pyproj for a code, is not installed.
        OSError: If the file cannot be written.
    """
    e57 = load_libe57()
    frame = "" if about.epsg is None else wkt_of(about.epsg)
    try:
        with contextlib.closing(e57.ImageFile(str(path), "w")) as image:
            scans = _begin(e57, image, frame)
            for scan in _scans(cloud, about):
                _write_scan(e57, image, scans, scan)
            if around is not None:
                _add_surroundings(e57, image, around, cloud)
    except e57.E57Exception as problem:
        raise OSError(str(problem).splitlines()[0]) from problem


def write_e57_stations(stations: Sequence[Callable[[], PointCloud]], path: Part, about: About) -> None:
    """Write the clouds of several stations as `write_e57` writes the joined one; only one is in memory.

    Args:
        stations: Each gives the cloud of one station in the frame of the room, with its pose, whenever it is called:
            twice, for the first scan already says where all stations are.
        path: The file.
        about: What is said of them all.

    Raises:
        CloudError: As `write_e57`, or if the clouds are not of one camera, or one has no pose.
        DependencyError: If pye57, or pyproj for a code, is not installed.
        OSError: If the file cannot be written.
    """
    e57 = load_libe57()
    frame = "" if about.epsg is None else wkt_of(about.epsg)
    known = [_known(load()) for load in stations]
    if len({one.lines for one in known}) != 1:
        raise CloudError(f"{path}: expected clouds of one camera, with the same number of lines.")
    numbers = np.repeat(np.arange(len(known), dtype=np.int32), [one.profiles for one in known])
    placed = Stations(numbers, np.stack([one.pose for one in known]), np.stack([one.covariance for one in known]))
    header = "\n".join(lines_of_grid((len(numbers), known[0].lines), placed, about))
    try:
        with contextlib.closing(e57.ImageFile(str(path), "w")) as image:
            scans, profiles = _begin(e57, image, frame), 0
            for number, load in enumerate(stations):
                for scan in _scans(load(), about, _Whole(header, number, profiles)):
                    _write_scan(e57, image, scans, scan)
                profiles += known[number].profiles
    except e57.E57Exception as problem:
        raise OSError(str(problem).splitlines()[0]) from problem


class _Whole(NamedTuple):
    """The joined cloud of which a cloud is one station."""

    header: str
    station: int
    """Number of the station."""
    profiles: int
    """Of the stations before it."""


class _Known(NamedTuple):
    """What is kept of a cloud that was looked at."""

    profiles: int
    lines: int
    pose: np.ndarray
    covariance: np.ndarray


def _known(cloud: PointCloud) -> _Known:
    if cloud.stations is None or len(cloud.stations.pose) != 1:
        raise CloudError("a scan of several: expected the cloud of one station with its pose.")
    pose, covariance = (np.asarray(field, np.float64)[0] for field in (cloud.stations.pose, cloud.stations.covariance))
    profiles, lines = cloud.valid.shape
    return _Known(profiles, lines, pose, covariance)


def _add_surroundings(e57: Any, image: Any, around: Surroundings, cloud: PointCloud) -> None:
    scan = image.root()["data3D"][0]
    pose = np.eye(4) if cloud.stations is None else np.asarray(cloud.stations.pose, np.float64)[0]
    if around.started_s is not None:
        scan.set("acquisitionStart", _moment(e57, image, around.started_s))
    append_panorama(e57, image, around.panorama, scan)
    for number, photograph in enumerate(around.photographs):
        append_photograph(e57, image, photograph, scan, number=number, T_file_scan=pose)


def _moment(e57: Any, image: Any, unix_s: float) -> Any:
    node = e57.StructureNode(image)
    node.set("dateTimeValue", e57.FloatNode(image, unix_s - _GPS_EPOCH_S + _LEAP_S))
    node.set("isAtomicClockReferenced", e57.IntegerNode(image, 0))
    return node


class _Scan(NamedTuple):
    name: str
    description: str
    header: str
    rotation: tuple[float, float, float, float]
    """Unit quaternion (w, x, y, z)."""
    translation: tuple[float, float, float]
    points: Callable[[], Iterator[dict[str, np.ndarray]]]
    """Gives the columns of all points, a block at a time, by the names of the format."""
    double: bool


def _begin(e57: Any, image: Any, frame: str) -> Any:
    """The head of the file; returns the list of scans."""
    for prefix, uri in (("", e57.E57_V1_0_URI), ("nor", NORMALS_URI), (OWN.rstrip(":"), OWN_URI)):
        image.extensionsAdd(prefix, uri)
    root, scans = image.root(), e57.VectorNode(image, True)
    for key, node in {
        "formatName": e57.StringNode(image, "ASTM E57 3D Imaging Data File"),
        "guid": e57.StringNode(image, f"{{{uuid.uuid4()}}}"),
        "versionMajor": e57.IntegerNode(image, e57.E57_FORMAT_MAJOR),
        "versionMinor": e57.IntegerNode(image, e57.E57_FORMAT_MINOR),
        "e57LibraryVersion": e57.StringNode(image, e57.E57_LIBRARY_ID),
        "coordinateMetadata": e57.StringNode(image, frame),
        "creationDateTime": _moment(e57, image, time.time()),
        "data3D": scans,
        "images2D": e57.VectorNode(image, True),
    }.items():
        root.set(key, node)
    return scans


def _scans(cloud: PointCloud, about: About, whole: _Whole | None = None) -> Iterator[_Scan]:
    """The stations that saw something, one at a time."""
    poses = np.eye(4)[None] if cloud.stations is None else np.asarray(cloud.stations.pose, np.float64)
    made = f"calibration {about.calibration}" if about.calibration else ""
    header = "\n".join(header_lines(cloud, about)) if whole is None else whole.header
    first, profiles = (0, 0) if whole is None else (whole.station, whole.profiles)
    for number, pose in enumerate(poses):
        name, described = ", ".join(filter(None, ("jaxscan", made))), "; ".join(filter(None, ("jaxscan", made)))
        if cloud.stations is not None:
            name = f"{name}, station {first + number}"
            described = (
                f"{described}; covariance of the pose, of a step (translation x y z [m], rotation x y z [rad]) in the "
                f"scan's own frame, upper triangle by rows: {covariance_text(cloud.stations.covariance[number])}"
            )
        mine = of_station(cloud, number)
        if not np.any(mine.valid):
            continue
        # The column counts the profiles of the scan.
        profile = None if cloud.stations is None else profiles + np.flatnonzero(cloud.stations.number == number)
        read = partial(_columns, mine, profile, first + number)
        rotation, translation = quaternion(pose[:3, :3]), tuple(pose[:3, 3].tolist())
        yield _Scan(name, described, header, rotation, translation, read, mine.xyz.dtype == np.float64)


def _columns(cloud: PointCloud, profile: np.ndarray | None, station: int) -> Iterator[dict[str, np.ndarray]]:
    """The columns of a scan, a block at a time; with the profile of the whole cloud where it has several stations."""
    for points in blocks(cloud):
        values = columns(points, cloud)
        if profile is not None:
            values |= {"profile": profile[points.step], "station": np.full(len(points.step), station)}
        kept = set(known_names(values, cloud))
        yield _fields({name: value for name, value in values.items() if name in kept}, smoothed_names(cloud))


def _fields(values: Mapping[str, np.ndarray], smoothed: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Columns by the names of the format, in types that the binding takes."""
    own = (*_OURS, *smoothed, *(name for name in ("profile", "station") if name in values))
    named = COLUMNS | {f"{OWN}{name}": name for name in own}
    named = {key: name for key, name in named.items() if name in values}
    fields: dict[str, np.ndarray] = {
        key: np.ascontiguousarray(values[name], _type_of(key, values[name])) for key, name in named.items()
    }
    # Takes no room in the file; some readers ask for it.
    return fields | {"cartesianInvalidState": np.zeros(len(values["x"]), np.longlong)}


def _type_of(key: str, values: np.ndarray) -> type:
    """Bounds are checked in double. The binding takes NumPy's int64 for 32 bits, not longlong."""
    if key in _COLOURS:
        return np.uint8
    return np.float64 if values.dtype.kind == "f" else np.longlong


def _write_scan(e57: Any, image: Any, scans: Any, written: _Scan) -> None:
    """Append a scan: the bounds of its columns, which stand before the points, and then the points."""
    least_of: dict[str, np.ndarray] = {}
    most_of: dict[str, np.ndarray] = {}
    largest = 0
    for block in written.points():
        largest = max(largest, len(block["cartesianX"]))
        for key, values in block.items():
            least_of[key] = np.minimum(values.min(), least_of.get(key, values.min()))
            most_of[key] = np.maximum(values.max(), most_of.get(key, values.max()))

    def number(value: Any) -> Any:
        return e57.IntegerNode(image, value) if isinstance(value, int) else e57.FloatNode(image, value)

    def structure(entries: dict[str, int | float]) -> Any:
        node = e57.StructureNode(image)
        for key, value in entries.items():
            node.set(key, number(value))
        return node

    def bounds(limits: dict[str, str]) -> Any:
        return structure(
            {
                f"{key}{end}": limit[field].item()
                for key, field in limits.items()
                for end, limit in (("Minimum", least_of), ("Maximum", most_of))
            }
        )

    scan, pose = e57.StructureNode(image), e57.StructureNode(image)
    scan.set("guid", e57.StringNode(image, f"{{{uuid.uuid4()}}}"))
    scan.set("name", e57.StringNode(image, written.name))
    scan.set("description", e57.StringNode(image, written.description))
    scan.set(f"{OWN}header", e57.StringNode(image, written.header))
    if "rowIndex" in least_of:
        scan.set("indexBounds", bounds({"row": "rowIndex", "column": "columnIndex"}))
    if "intensity" in least_of:
        scan.set("intensityLimits", bounds({"intensity": "intensity"}))
    if set(_COLOURS) <= least_of.keys():
        scan.set("colorLimits", structure({f"{key}{end}": k * 255 for key in _COLOURS for k, end in _ENDS}))
    scan.set("cartesianBounds", bounds({axis: f"cartesian{axis.upper()}" for axis in "xyz"}))
    scan.set("pose", pose)
    pose.set("rotation", structure(dict(zip("wxyz", written.rotation, strict=True))))
    pose.set("translation", structure(dict(zip("xyz", written.translation, strict=True))))
    prototype, buffers = e57.StructureNode(image), e57.VectorSourceDestBuffer()
    buffer = {key: np.empty(largest, value.dtype) for key, value in least_of.items()}
    for key, values in buffer.items():
        least, most = least_of[key].item(), most_of[key].item()
        if values.dtype == np.float64:
            double = key == f"{OWN}angle" or (written.double and key.startswith("cartesian"))
            node = e57.FloatNode(image, least, e57.E57_DOUBLE if double else e57.E57_SINGLE, least, most)
        else:
            limits = (0, 255) if key in _COLOURS else (least, most)
            node = e57.IntegerNode(image, limits[0], *limits)
        prototype.set(key, node)
        buffers.append(e57.SourceDestBuffer(image, key, values, len(values), True, True))
    points = e57.CompressedVectorNode(image, prototype, e57.VectorNode(image, True))
    scan.set("points", points)
    scans.append(scan)
    with contextlib.closing(points.writer(buffers)) as writer:
        for block in written.points():
            count = len(block["cartesianX"])
            for key, values in block.items():
                buffer[key][:count] = values
            writer.write(count)
