"""Reading E57: files of this library on their grid, others by rows and columns, or as a single row of points.

The format is read here, in blocks, and not by libE57: its parser of XML follows what a file says, to other files and
addresses too, and hears no signal while it does.
"""

import math
import os
import struct
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.clouds.about import METRE, StoredCloud, about_of, version_of
from jaxscan.files.clouds.columns import Reading, as_bytes, range_of
from jaxscan.files.clouds.crs import epsg_of
from jaxscan.files.clouds.e57.library import COLUMNS, OWN
from jaxscan.files.clouds.e57.packets import Field, read_blocks
from jaxscan.files.clouds.e57.pages import PAGE, Pages, without_checksums
from jaxscan.files.clouds.e57.scans import Scan, joined
from jaxscan.files.disk import Element, open_regular, parse_xml
from jaxscan.geometry import from_quaternion


MAX_XML_BYTES = 1 << 24
"""Of 1024 scans with their pictures, or of 64 stations that each name all others."""
MAX_SCANS = 1024
_SPHERICAL = {"sphericalRange": "range", "sphericalAzimuth": "azimuth", "sphericalElevation": "elevation"}
_COLOURS = {"red": "colorLimits/colorRedMaximum", "green": "colorLimits/colorGreenMaximum"}
_COLOURS["blue"] = "colorLimits/colorBlueMaximum"
_OWN_COLUMNS = {
    f"{OWN}{name}": name
    for name in (
        *("sigma", "sigma_random", "sigma_systematic", "laser", "angle", "record", "profile", "station"),
        *("sigma_row", "shift_px", "shared_lines"),
    )
}


def read_e57(path: Path, reading: Reading | None = None) -> StoredCloud:
    """A cloud of all scans of an E57 file, in the frame of the file.

    Raises:
        CloudError: If it is damaged or has no points.
    """
    reading = reading or Reading()
    if reading.columns:
        raise CloudError(f"{path}: the columns of E57 are named by the format; leave --columns out.")
    with open_regular(path, error=CloudError) as file:
        size = os.fstat(file.fileno()).st_size
        place, length = _places(file.read(48), size, path)
        pages = Pages(file, size)
        try:
            text = pages.read(without_checksums(place), length)
            root = parse_xml(text, name=str(path), error=CloudError, limit=MAX_XML_BYTES)
            scans = list(_scans(pages, root, size, path, reading))
            if sum(scan.points for scan in scans) == 0:
                raise CloudError(f"{path}: holds no points.")
            lines = scans[0].lines
            version_of(lines, str(path))
            cloud = joined(scans, str(path))
        except (ValueError, OverflowError, struct.error, OSError) as problem:
            raise CloudError(f"{path}: not a readable E57 file: {problem!s:.100}.") from problem
    about = about_of(lines)
    frame = root.find("coordinateMetadata")
    epsg = about.epsg if about.epsg is not None or frame is None else epsg_of(frame.text)
    # The standard knows no other unit, and z up in the frame of a levelled scanner.
    about = about._replace(epsg=epsg, metres=METRE, unit_by="the format", upright=True)
    return StoredCloud(cloud, about, () if lines else _words(scans))


def _words(scans: list[Scan]) -> tuple[str, ...]:
    """What was decided, as people read it."""
    filled = [scan for scan in scans if scan.points]
    known = {*COLUMNS.values(), *_SPHERICAL.values()}
    columns = dict.fromkeys(name for scan in filled for name in scan.types if name in known)
    unused = dict.fromkeys(name for scan in filled for name in scan.unused)
    ranges = dict.fromkeys(scan.colours for scan in filled if scan.colours)
    return (
        f"{', '.join(columns)} by the format",
        *([f"not used: {', '.join(unused)[:80]}"] if unused else []),
        *ranges,
        *([f"{len(filled)} scans in one frame"] if len(filled) > 1 else []),
    )


def _places(head: bytes, size: int, path: Path) -> tuple[int, int]:
    """Place and length of the XML, after a look at the sizes in the head."""
    if len(head) < 48 or head[:8] != b"ASTM-E57":
        raise CloudError(f"{path}: not an E57 file.")
    (version,) = struct.unpack_from("<I", head, 8)
    length, place, xml, page = struct.unpack_from("<QQQQ", head, 16)
    if length > size or place > size or xml > min(size, MAX_XML_BYTES) or page != PAGE:
        raise CloudError(f"{path}: the head announces more than the file holds; it is damaged or cut short.")
    if version > 1:
        raise CloudError(f"{path}: found version {version} of E57, expected 1.")
    return place, xml


def _scans(pages: Pages, root: Element, size: int, path: Path, reading: Reading) -> Iterator[Scan]:
    listed = root.find("data3D")
    scans = [] if listed is None else listed.children
    if len(scans) > MAX_SCANS:
        raise CloudError(f"{path}: found {len(scans)} scans, expected at most {MAX_SCANS}.")
    left = 8 * size
    for scan in scans:
        points = scan.find("points")
        if points is None:
            continue
        count = int(points.attributes.get("recordCount", "0"))
        fields = _fields_of(points.find("prototype"))
        # A point takes more than a byte; without data a file could announce any number of equal ones.
        left -= max(8, sum(field.bits for field in fields)) * count
        if count < 0 or left < 0:
            raise CloudError(f"{path}: announces {count} points, which the file cannot hold; it is damaged.")
        header = scan.find(f"{OWN}header")
        lines = [] if header is None else header.text.splitlines()
        yield _scan(pages, scan, points, count, fields, lines, reading)


def _fields_of(prototype: Element | None) -> list[Field]:
    """The columns of a scan in their order."""
    found = [] if prototype is None else list(_leaves(prototype, ""))
    if len({field.name for field in found}) < len(found):
        raise ValueError("a scan has two columns of one name")
    return found


def _leaves(parent: Element, before: str) -> Iterator[Field]:
    for child in parent.children:
        name, kind = before + child.tag, child.attributes.get("type", "")
        if kind in ("Structure", "Vector"):
            yield from _leaves(child, f"{name}/")
        else:
            yield _field(name, kind, child.attributes)


def _field(name: str, kind: str, words: dict[str, str]) -> Field:
    if kind == "Float":
        single = words.get("precision", "double") == "single"
        brightest = float(words.get("maximum", "inf"))
        return Field(name, 32 if single else 64, single, brightest=brightest)
    if kind == "String":
        return Field(name, 0, readable=False)
    if kind not in ("Integer", "ScaledInteger"):
        raise ValueError(f"a column has the unknown type {kind:.40}")
    least, most = int(words.get("minimum", -(1 << 63))), int(words.get("maximum", (1 << 63) - 1))
    if not -(1 << 63) <= least <= most < 1 << 63:
        raise ValueError(f"the limits {least:.6g} and {most:.6g} of a column cannot be")
    bits = (most - least).bit_length()
    if kind == "Integer":
        return Field(name, bits, least=least, brightest=most)
    scale, offset = float(words.get("scale", "1")), float(words.get("offset", "0"))
    return Field(name, bits, least=least, scale=scale, offset=offset, brightest=most * scale + offset)


def _wanted(fields: list[Field]) -> dict[str, str]:
    """Names of the columns that a cloud can use, by their names in the file."""
    names = {field.name for field in fields if field.readable}
    known = COLUMNS | _OWN_COLUMNS
    cartesian = ("cartesianX", "cartesianY", "cartesianZ")
    # Where both are there, the state of the one is not that of the other.
    if set(cartesian) <= names:
        known = known | {"cartesianInvalidState": "invalid"}
    else:
        known = {name: column for name, column in known.items() if name not in cartesian}
        known |= _SPHERICAL | {"sphericalInvalidState": "invalid"}
    return {name: column for name, column in known.items() if name in names}


def _scan(
    pages: Pages,
    scan: Element,
    points: Element,
    count: int,
    fields: list[Field],
    lines: list[str],
    reading: Reading,
) -> Scan:
    """A scan with all columns that a cloud can use."""
    wanted = _wanted(fields)
    place = int(points.attributes.get("fileOffset", "0"))
    numbers = {wanted[field.name]: k for k, field in enumerate(fields) if field.name in wanted}

    def read(columns: Iterable[str]) -> Iterator[dict[str, np.ndarray]]:
        names = list(columns)
        for values in read_blocks(pages, place, count, fields, [numbers[name] for name in names]):
            yield dict(zip(names, values, strict=True))

    stated = _full_brightness(scan, fields)
    full: dict[str, float] = {}
    words = ""
    if count and numbers.keys() >= stated.keys():
        # By what they reach together: limits are not always true, and often not there.
        kind = np.result_type(*(np.dtype(fields[numbers[colour]].type) for colour in stated))
        most, whole = 0.0, True
        for block in () if kind == np.uint8 else read(stated):
            for values in map(np.nan_to_num, block.values()):
                most, whole = max(most, float(values.max())), whole and bool((values == np.floor(values)).all())
        found = [range_of(kind, most, whole=whole, stated=limit, reading=reading) for limit in stated.values()]
        full = {colour: one.brightest for colour, one in zip(stated, found, strict=True)}
        words = found[0].words
    if not all(full.values()):
        full = {}
    numbers = {name: k for name, k in numbers.items() if name in full or name not in stated}
    types = {name: "u1" if name in full else _stored(fields[k], name) for name, k in numbers.items()}

    def blocks(columns: Iterable[str]) -> Iterator[dict[str, np.ndarray]]:
        for block in read(columns):
            for colour in full.keys() & block.keys():
                block[colour] = as_bytes(block[colour], full[colour])
            yield block

    used = {*wanted, "cartesianInvalidState", "sphericalInvalidState"}
    unused = tuple(field.name for field in fields if field.name not in used and not field.name.startswith("spherical"))
    return Scan(count, types, blocks, _pose(scan), lines, unused, words)


def _stored(field: Field, column: str) -> str:
    """Type of a column: what is turned is a float, and what counts profiles or lines counts further in other scans."""
    if column in ("x", "y", "z", "nx", "ny", "nz"):
        return field.type if field.single is not None else "f8"
    return "i4" if field.type == "u1" and column in ("step", "row", "profile", "record") else field.type


def _full_brightness(scan: Element, fields: list[Field]) -> dict[str, float | None]:
    """The number of full brightness of each colour: that of the scan, else that of the column; None where none is."""
    most = {COLUMNS.get(field.name): field.brightest for field in fields}
    found: dict[str, float | None] = {}
    for colour, path in _COLOURS.items():
        limit = scan.find(path)
        stated = _number(limit, 0.0)
        if not 0 < stated < math.inf:
            stated = float(most.get(colour, math.inf))
        found[colour] = stated if 0 < stated <= 65535 else None
    return found


def _number(element: Element | None, default: float) -> float:
    """The number that an element holds: 0 where it is empty."""
    return default if element is None else float(element.text.strip() or "0")


_UNIT = 1e-2
"""By how much the length of a quaternion may differ from 1, as it is written with few digits."""


def _pose(scan: Element) -> np.ndarray:
    """T_file_scan [4, 4]."""

    def read(key: str, default: float) -> float:
        return _number(scan.find(f"pose/{key}"), default)

    pose = np.eye(4)
    pose[:3, 3] = [read(f"translation/{axis}", 0.0) for axis in "xyz"]
    q = np.array([read("rotation/w", 1.0), *(read(f"rotation/{axis}", 0.0) for axis in "xyz")])
    if not (np.isfinite(q).all() and np.isfinite(pose).all() and abs(np.linalg.norm(q) - 1.0) < _UNIT):
        raise ValueError(
            f"the pose of a scan is no rigid motion: its quaternion has the length {np.linalg.norm(q):.4g}"
        )
    pose[:3, :3] = from_quaternion(q)
    return pose
