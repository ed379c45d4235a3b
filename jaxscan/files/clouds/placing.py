"""Clouds of other programs in metres with z up, and clouds moved into a map's coordinates."""

import dataclasses
import re
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

import numpy as np

from jaxscan.errors import CloudError, DependencyError
from jaxscan.files.clouds.columns import METRES, UNIT_WORDS, Unit
from jaxscan.files.clouds.header import StoredCloud
from jaxscan.geometry import Array
from jaxscan.printable import printable
from jaxscan.reconstruction import PointCloud, Stations, some_points


Up = Literal["x", "-x", "y", "-y", "z", "-z"]
_TURNS: dict[Up, list[list[int]]] = {
    "z": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "-z": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
    "y": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
    "-y": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
    "x": [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
    "-x": [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
}

MILLIMETRES_FROM, CENTIMETRES_FROM = 1500.0, 200.0
"""Extents from which a cloud is taken for one in a smaller unit: no room is 200 m large, and few are 15 m."""
FAR_AWAY = 10.0
"""A cloud that is this many times its extent from the origin is in map coordinates, which are in metres."""
SMALLEST_M, LARGEST_M = 0.005, 1000.0
"""Extents of things on a table and of places: others are in another unit, whatever the file says."""
_COMMON: tuple[Unit, ...] = ("m", "cm", "mm", "foot")
_SMALL_M = 0.02
"""Extent of a thing that somebody scans."""
LOW = 0.75
"""Rooms are lower than wide: an extent of less than this share of z's is taken for the height."""


def in_metres(stored: StoredCloud, unit: Unit | None = None) -> tuple[PointCloud, list[str]]:
    """The cloud in metres, and a note of what its columns, colours and unit were taken for, and why.

    Nothing is said of our own files, which say all that themselves.

    Raises:
        CloudError: If the file says that its coordinates are degrees, and no unit is given.
    """
    cloud, about = stored.cloud, stored.about
    if about.in_degrees and unit is None:
        raise CloudError(
            f"the coordinates are degrees of longitude and latitude by {about.unit_by}, expected lengths; project them "
            "onto a map first, or say --unit if they are none."
        )
    words = list(stored.words)
    factors: tuple[float, float, float] = (1.0, 1.0, 1.0)
    if unit is not None:
        factors = (METRES[unit],) * 3
        words += [f"{UNIT_WORDS[unit]} by --unit"] if words else []
    elif about.metres is not None:
        factors = about.metres
        words += [f"{_unit_words(factors)} by {about.unit_by}"] if words else []
    else:
        guess, said = _guessed_unit(cloud)
        factors = (METRES[guess],) * 3
        words.append(f"{about.unit_by or 'the file does not say its unit'}; {said} (--unit)")
    cloud = cloud if factors == (1.0, 1.0, 1.0) else _scaled(cloud, factors)
    # Names of columns and comments are another program's words.
    notes = [printable(f"{'; '.join(words)}.")] if words else []
    return cloud, notes + _size_notes(cloud, factors[0])


def _unit_words(factors: tuple[float, float, float]) -> str:
    """A unit as people read it; that of the heights may be another one."""
    across, along, up = (
        next((UNIT_WORDS[unit] for unit, metres in METRES.items() if abs(metres - one) < 1e-9), f"units of {one:g} m")
        for one in factors
    )
    return across if across == along == up else f"{across}, heights in {up}"


def _guessed_unit(cloud: PointCloud) -> tuple[Unit, str]:
    """The unit that a cloud's extent has most likely, and what it would be in others."""
    extent, away = float(np.linalg.norm(_extents(cloud))), float(np.linalg.norm(_middle(cloud)))
    unit: Unit = "m"
    if away < FAR_AWAY * extent and extent >= CENTIMETRES_FROM:
        unit = "mm" if extent >= MILLIMETRES_FROM else "cm"
    # A thing on a table is as large in millimetres as a place in metres.
    sizes = {other: METRES[other] * extent for other in _COMMON if other != unit and away < FAR_AWAY * extent}
    others = [f"in {UNIT_WORDS[other]} {size:.3g} m" for other, size in sizes.items() if _SMALL_M <= size <= LARGEST_M]
    would = f"; {', '.join(others)}" if others else ""
    return unit, f"an extent of {extent:.4g} is taken as {UNIT_WORDS[unit]}, {METRES[unit] * extent:.3g} m{would}"


def _size_notes(cloud: PointCloud, factor: float) -> list[str]:
    """A note where a cloud has the size of neither a place nor a thing on a table, with the unit that would fit."""
    extent, away = float(np.linalg.norm(_extents(cloud))), float(np.linalg.norm(_middle(cloud)))
    if extent == 0.0 or SMALLEST_M <= extent <= LARGEST_M or (extent > LARGEST_M and away >= FAR_AWAY * extent):
        return []
    number = extent / factor
    unit: Unit = "mm" if number >= MILLIMETRES_FROM else "cm" if number >= CENTIMETRES_FROM else "m"
    fitting = METRES[unit] * number
    fits = f"in {UNIT_WORDS[unit]} it would be {fitting:.4g} m (--unit {unit})"
    return [
        f"the cloud is {extent:.4g} m large, which no room and no thing on a table is; "
        + (fits if SMALLEST_M <= fitting <= LARGEST_M else "check its unit.")
    ]


def with_z_up(stored: StoredCloud, cloud: PointCloud, up: Up | None = None) -> tuple[PointCloud, list[str]]:
    """The cloud with z up, and a note where its file does not say what is up and nothing is given.

    Args:
        stored: The cloud as it was read.
        cloud: The same in metres.
        up: The direction of the cloud that is up.
    """
    notes = []
    if up is None and not stored.about.upright:
        extents = _extents(cloud)
        lowest = int(np.argmin(extents))
        up = ("x", "y", "z")[lowest] if extents[lowest] < LOW * extents[2] else "z"
        notes = [f"the file does not say what is up; {up} is taken for it (--up)."]
    return (cloud if up in (None, "z") else _turned(cloud, np.array(_TURNS[up or "z"], float))), notes


def shifted(cloud: PointCloud, offset: tuple[float, float, float]) -> PointCloud:
    """The cloud moved by an offset [m], in double precision; its places of the scanner are moved with it."""
    step = np.eye(4)
    step[:3, 3] = offset
    if cloud.stations is None:
        stations = Stations(np.zeros(len(cloud.valid), np.int32), step[None], np.zeros((1, 6, 6)))
    else:
        stations = cloud.stations._replace(pose=step @ np.asarray(cloud.stations.pose, np.float64))
    xyz = np.asarray(cloud.xyz).astype(np.float64)
    xyz += step[:3, 3]
    xyz[~np.asarray(cloud.valid)] = 0
    return dataclasses.replace(cloud, xyz=xyz, stations=stations)


def _extents(cloud: PointCloud) -> np.ndarray:
    """Extents [3] of the cloud without its outermost hundredth on every side."""
    low, high = np.percentile(some_points(cloud, 100_000), [1, 99], axis=0)
    return np.asarray(high - low)


def _middle(cloud: PointCloud) -> np.ndarray:
    return np.asarray(np.median(some_points(cloud, 100_000), axis=0))


def _scaled(cloud: PointCloud, factors: tuple[float, float, float]) -> PointCloud:
    """The cloud with each axis in another unit; sigmas, whose ray may go anywhere, in the largest of them."""

    def times(field: Array | None, by: float | tuple[float, float, float]) -> np.ndarray | None:
        return None if field is None else np.asarray(field) * np.asarray(by, np.asarray(field).dtype)

    stations = cloud.stations
    if stations is not None:
        pose = np.array(stations.pose, np.float64)
        pose[:, :3, 3] *= factors
        stations = stations._replace(pose=pose)
    sigmas = ("sigma_random", "sigma_systematic", "sigma_row")
    fields: dict[str, Any] = {name: times(getattr(cloud, name), max(factors)) for name in sigmas}
    fields["xyz"] = times(cloud.xyz, factors)
    return dataclasses.replace(cloud, **fields, stations=stations)


def _turned(cloud: PointCloud, rotation: np.ndarray) -> PointCloud:
    stations = cloud.stations
    if stations is not None:
        turn = np.eye(4)
        turn[:3, :3] = rotation
        stations = stations._replace(pose=turn @ np.asarray(stations.pose, np.float64))
    vectors = {name: np.asarray(getattr(cloud, name)) for name in ("xyz", "normals")}
    turned = {name: field @ rotation.T.astype(field.dtype) for name, field in vectors.items()}
    return dataclasses.replace(cloud, **turned, stations=stations)


LOCAL_WKT = (
    'LOCAL_CS["jaxscan, frame of the {frame}",LOCAL_DATUM["jaxscan",32767],UNIT["metre",1,AUTHORITY["EPSG","9001"]],'
    'AXIS["x",OTHER],AXIS["y",OTHER],AXIS["z",UP]]'
)

_CODE_AT_END = re.compile(r'(?:AUTHORITY\["EPSG","(\d{1,6})"\]|ID\["EPSG",(\d{1,6})\])\s*\]\s*\Z')
_UNITS_OF_LENGTH = {9001: 1.0, 9002: 0.3048, 9003: 1200 / 3937, 9036: 1000.0, 9030: 1852.0, 9096: 0.9144}
"""Metres of units by their EPSG codes, as GeoTIFF names them."""
_MODEL, _PROJECTED, _LENGTH_UNIT, _LENGTH_SIZE, _HEIGHT_UNIT = 1024, 3072, 3076, 3077, 4099
_BY_USER = 32767


def wkt_of(epsg: int) -> str:
    """OGC WKT of a reference system whose coordinates are metres."""
    try:
        import pyproj
    except ImportError as problem:
        raise DependencyError('An EPSG code needs pyproj: pip install "jaxscan[export]"') from problem
    try:
        crs = pyproj.CRS.from_epsg(epsg)
    except pyproj.exceptions.CRSError as problem:
        raise CloudError(f"EPSG:{epsg}: no coordinate reference system has this code.") from problem
    factors = {axis.unit_conversion_factor for axis in crs.axis_info}
    if not (crs.is_projected and factors == {1.0}):
        raise CloudError(
            f"EPSG:{epsg}: is {crs.name}, whose coordinates are not metres on a map; choose a projected one in metres, "
            "such as that of a UTM zone (EPSG:25832)."
        )
    text: str = crs.to_wkt("WKT1_GDAL")
    return text


def epsg_of(wkt: str) -> int | None:
    """The code that a WKT names for the whole system; None where it names none."""
    found = _CODE_AT_END.search(wkt.strip("\0 \n"))
    return int(found[1] or found[2]) if found else None


class FileFrame(NamedTuple):
    """The coordinate reference system that a file states: units and axes."""

    metres: tuple[float, float, float] | None = None
    in_degrees: bool = False


def frame_of_wkt(wkt: str) -> FileFrame:
    """Units of a WKT, of version 1 or 2: that of the map, and that of the heights where they have their own.

    Nothing is stated where PROJ does not understand it, or pyproj is not installed.
    """
    return _frame_of("from_wkt", wkt) if wkt else FileFrame()


def _frame_of(known_by: Literal["from_wkt", "from_epsg"], what: str | int) -> FileFrame:
    try:
        import pyproj

        crs = getattr(pyproj.CRS, known_by)(what)
    except ImportError:
        return FileFrame()
    except pyproj.exceptions.CRSError:
        return FileFrame()
    if crs.is_geographic:
        return FileFrame(in_degrees=True)
    x, y, *z = [axis.unit_conversion_factor for axis in crs.axis_info] or (0.0, 0.0)
    metres = x, y, z[0] if z else x
    return FileFrame(metres) if 1e-6 < min(metres) <= max(metres) < 1e6 else FileFrame()


def frame_of_keys(keys: Mapping[int, int], sizes: Mapping[int, float]) -> FileFrame:
    """Units of the keys of a GeoTIFF, which LAS files of before 1.4 hold.

    Args:
        keys: Values by the numbers of the keys.
        sizes: Those that are not whole numbers.
    """
    if keys.get(_MODEL) == 2:
        return FileFrame(in_degrees=True)
    code = keys.get(_LENGTH_UNIT)
    flat = sizes.get(_LENGTH_SIZE) if code == _BY_USER else _UNITS_OF_LENGTH.get(code or 0)
    if flat is None and 0 < keys.get(_PROJECTED, 0) < _BY_USER:
        metres = _frame_of("from_epsg", keys[_PROJECTED]).metres
        flat = None if metres is None else metres[0]
    if flat is None or not flat > 0:
        return FileFrame()
    return FileFrame((flat, flat, _UNITS_OF_LENGTH.get(keys.get(_HEIGHT_UNIT, 0), flat)))


def epsg_of_keys(keys: Mapping[int, int]) -> int | None:
    """The code of the map that the keys of a GeoTIFF name."""
    code = keys.get(_PROJECTED, 0)
    return code if 1024 <= code < _BY_USER else None
