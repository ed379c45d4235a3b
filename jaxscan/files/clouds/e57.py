"""E57 (ASTM E2807), the exchange format of terrestrial scanning: read by our own bounded reader, written by libE57."""

import contextlib
import functools
import itertools
import math
import os
import struct
import time
import uuid
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from jaxscan.errors import CloudError, DependencyError
from jaxscan.files.clouds.columns import AXES, NORMALS, Range, Reach, Reading, as_bytes, range_of
from jaxscan.files.clouds.header import (
    METRE,
    About,
    StoredCloud,
    about_of,
    covariance_text,
    header_lines,
    lines_of_grid,
)
from jaxscan.files.clouds.placing import epsg_of, wkt_of
from jaxscan.files.clouds.points import Records, blocks, cloud_of, columns, known_names
from jaxscan.files.disk import Element, Part, parse_xml
from jaxscan.geometry import from_quaternion, quaternion
from jaxscan.reconstruction import SMOOTHED, PointCloud, Stations, of_station


NORMALS_URI = "http://www.libe57.org/E57_EXT_surface_normals.txt"
"""Namespace of the normals `nor:normalX` and so on, an extension that other programs know."""
OWN_URI = "https://jaxscan.invalid/e57"
"""Our own namespace: `jaxscan:header`, the lines of a header, and values of points by the names of their columns."""
OWN = "jaxscan:"
COLUMNS = {
    "cartesianX": "x",
    "cartesianY": "y",
    "cartesianZ": "z",
    "intensity": "intensity",
    "colorRed": "red",
    "colorGreen": "green",
    "colorBlue": "blue",
    "rowIndex": "row",
    "columnIndex": "step",
    "nor:normalX": "nx",
    "nor:normalY": "ny",
    "nor:normalZ": "nz",
}
"""Columns that the standard and the extension of normals know."""
_OWN_COLUMNS = {
    f"{OWN}{name}": name
    for name in (
        *("sigma", "sigma_random", "sigma_systematic", "laser", "angle", "record"),
        *(*SMOOTHED, "profile", "station"),
    )
}
"""Columns that only our own extension has a place for."""


def load_libe57() -> Any:
    """The module."""
    try:
        import pye57
    except ImportError as problem:
        raise DependencyError('E57 needs pye57: pip install "jaxscan[export]"') from problem
    return pye57.libe57


# The pages of an E57 file: 1020 bytes each, and a checksum that is compared whenever a page is read.
#
# Source: ASTM E2807, 6.2; CRC-32C (Castagnoli) as in RFC 3720.

PAGE, PAYLOAD = 1024, 1020
_BLOCK = 1024


class Pages:
    """The bytes of a file without their checksums."""

    def __init__(self, file: BinaryIO, size: int) -> None:
        """A file of so many bytes."""
        self._file, self._pages = file, size // PAGE
        self._first, self._held = 0, b""

    def read(self, at: int, count: int) -> bytes:
        """Bytes from a place that is counted without checksums."""
        if at < 0 or count < 0 or at + count > self._pages * PAYLOAD:
            raise ValueError("a part of it lies behind its end")
        parts = []
        while count:
            start = at - self._first * PAYLOAD
            if not 0 <= start < len(self._held):
                self._fill(at // PAYLOAD)
                continue
            part = self._held[start : start + count]
            parts.append(part)
            at, count = at + len(part), count - len(part)
        return parts[0] if len(parts) == 1 else b"".join(parts)

    def _fill(self, first: int) -> None:
        self._file.seek(first * PAGE)
        data = self._file.read(min(_BLOCK, self._pages - first) * PAGE)
        if len(data) < PAGE:
            raise ValueError("the file ends before its end")
        pages = np.frombuffer(data, np.uint8, len(data) // PAGE * PAGE).reshape(-1, PAGE)
        stated = np.ascontiguousarray(pages[:, PAYLOAD:]).view(">u4")[:, 0]
        if wrong := np.flatnonzero(checksums(pages[:, :PAYLOAD]) != stated).tolist():
            raise ValueError(f"the checksum of page {first + wrong[0]} is not that of its bytes")
        self._first, self._held = first, pages[:, :PAYLOAD].tobytes()


def without_checksums(place: int) -> int:
    """A place in the file as it is counted without checksums; one within a checksum is the end of its page."""
    return place // PAGE * PAYLOAD + min(place % PAGE, PAYLOAD)


def checksums(pages: np.ndarray) -> np.ndarray:
    """CRC-32C of rows of bytes, uint8 [n, 4 k], as uint32 [n]: all rows at once, four bytes at a time."""
    low, high = _tables()
    found = np.full(len(pages), 0xFFFFFFFF, np.uint32)
    for word in np.ascontiguousarray(np.ascontiguousarray(pages).view("<u4").T):
        found ^= word
        found = low[found & np.uint32(0xFFFF)] ^ high[found >> np.uint32(16)]
    return ~found


@functools.cache
def _tables() -> tuple[np.ndarray, np.ndarray]:
    """Tables that update a checksum by four bytes: by the lower and by the upper two."""
    table = np.arange(1 << 16, dtype=np.uint32)
    halves = []
    for _ in range(2):
        for _ in range(16):
            table = (table >> np.uint32(1)) ^ np.where(table & np.uint32(1), np.uint32(0x82F63B78), np.uint32(0))
        halves.append(table)
    return halves[1], halves[0]


# The points of a scan in E57: packets with a part of each column, whose values are floats or packed bits.
#
# Source: ASTM E2807, 9.3 and 9.4.

_SECTION, _DATA, _OTHERS = 1, 1, (0, 2)
BLOCK_POINTS = 1 << 16
"""Points that are decoded together; a multiple of eight."""


class Field(NamedTuple):
    """How the values of a column are stored."""

    name: str
    bits: int
    """Bits of a value; 0 where all values are equal, and for texts, which are not read."""
    single: bool | None = None
    """Whether values are singles or doubles; None for whole numbers."""
    least: int = 0
    """The whole number that is stored as 0."""
    scale: float | None = None
    """Factor of a whole number; None where it is taken as it is."""
    offset: float = 0.0
    brightest: float = float("inf")
    """Largest value that it can have."""
    readable: bool = True

    @property
    def type(self) -> str:
        """Type that holds the values."""
        if self.single is not None:
            return "f4" if self.single else "f8"
        if self.scale is not None:
            return "f8"
        if self.least >= 0 and self.least + (1 << self.bits) <= 1 << 8:
            return "u1"
        return "i4" if self.least >= -(1 << 31) and self.least + (1 << self.bits) <= 1 << 31 else "i8"


def read_blocks(
    pages: Pages, place: int, count: int, fields: Sequence[Field], wanted: Sequence[int]
) -> Iterator[list[np.ndarray]]:
    """Values of some columns of a scan, of the same points each, from the first point to the last.

    Args:
        place: Where the section begins, counted with checksums.
        count: Number of points.
        fields: All columns in their order.
        wanted: Numbers of the columns to read.
    """
    columns = [_Column(fields[k]) for k in wanted]
    packets = _packets(pages, place, len(fields))
    for start in range(0, count, BLOCK_POINTS):
        points = min(BLOCK_POINTS, count - start)
        while any(column.whole < points for column in columns):
            parts = next(packets, None)
            if parts is None:
                raise ValueError(f"the section of {count} points ends too early")
            for k, column in zip(wanted, columns, strict=True):
                column.hold(parts[k], count - start)
        yield [column.take(points) for column in columns]


def _packets(pages: Pages, place: int, columns: int) -> Iterator[list[bytes]]:
    """The bytes of each column, packet by packet."""
    at = without_checksums(place)
    section, length, data = struct.unpack("<B7xQQ8x", pages.read(at, 32))
    if section != _SECTION:
        raise ValueError("a scan has no section of points")
    end, at = at + length, without_checksums(data)
    while at < end:
        kind, packet = struct.unpack("<BxH", pages.read(at, 4))
        if kind == _DATA:
            yield _parts(pages.read(at, packet + 1), columns)
        elif kind not in _OTHERS:
            raise ValueError("found an unknown packet")
        at += packet + 1


def _parts(packet: bytes, count: int) -> list[bytes]:
    """The part of each column that a packet holds."""
    if len(packet) < 6 + 2 * count or struct.unpack_from("<H", packet, 4) != (count,):
        raise ValueError("a packet does not have the columns of its scan")
    places = np.cumsum([6 + 2 * count, *struct.unpack_from(f"<{count}H", packet, 6)]).tolist()
    if places[-1] > len(packet):
        raise ValueError("a packet is shorter than its columns")
    return [packet[start:stop] for start, stop in itertools.pairwise(places)]


class _Column:
    """The bytes of a column that are not decoded yet."""

    def __init__(self, field: Field) -> None:
        self._field, self._held = field, bytearray()

    @property
    def whole(self) -> float:
        """Number of values that can be decoded."""
        return float(8 * len(self._held) // self._field.bits) if self._field.bits else math.inf

    def hold(self, data: bytes, left: int) -> None:
        """Keep the bytes of a packet, but no more than the remaining points need."""
        if self.whole < left:
            self._held += data

    def take(self, count: int) -> np.ndarray:
        """The next values. Eight values always end on a byte; only the last block may hold another number of them."""
        used = (count * self._field.bits + 7) // 8
        found = _decoded(self._field, self._held[:used], count)
        del self._held[:used]
        return found


def _decoded(field: Field, data: bytearray, count: int) -> np.ndarray:
    if field.single is not None:
        return np.frombuffer(data, f"<{field.type}", count)
    # Differences of 64 bits wrap around, and so do their sums.
    whole = _unpacked(data, field.bits, count).view(np.int64) + np.int64(field.least)
    if field.scale is None:
        return whole
    return whole * field.scale + field.offset


def _unpacked(data: bytearray, bits: int, count: int) -> np.ndarray:
    """Whole numbers [count] of so many bits each, the lowest bit first."""
    if bits == 0:
        return np.zeros(count, np.uint64)
    if bits in (8, 16, 32, 64):
        return np.frombuffer(data, f"<u{bits // 8}", count).astype(np.uint64)
    groups = -(-count // 8)
    # Eight values take as many bytes as one has bits.
    table = np.zeros((groups, bits), np.uint8)
    table.reshape(-1)[: len(data)] = np.frombuffer(data, np.uint8)
    found = np.zeros((groups, 8), np.uint64)
    for k in range(8):
        first, shift = divmod(k * bits, 8)
        for place in range((shift + bits + 7) // 8):
            part = table[:, first + place].astype(np.uint64)
            move = 8 * place - shift
            found[:, k] |= part << np.uint64(move) if move >= 0 else part >> np.uint64(-move)
    mask = np.uint64((1 << bits) - 1)
    return (found & mask).reshape(-1)[:count]


class RoundPicture(NamedTuple):
    """A whole turn as seen from the scanner's origin: its x axis in the middle, azimuth falling to the right.

    Rows are equal steps of elevation, as wide as those of azimuth, and the horizon is half way down.
    """

    jpeg: bytes
    width: int
    height: int


class FlatPicture(NamedTuple):
    """A photograph by a camera without distortion."""

    jpeg: bytes
    width: int
    height: int
    focal_px: float
    centre: tuple[float, float]
    """Principal point (u, v) [px], from the centre of the first pixel."""
    pose: np.ndarray
    """T_scanner_camera [4, 4], metres; the camera's x right, y up, z backward, as the format has it."""


class Surroundings(NamedTuple):
    """Pictures and times of a scan."""

    panorama: RoundPicture
    photographs: Iterable[FlatPicture] = ()
    started_s: float | None = None
    """When the scan began, seconds since 1970; None where it is not known."""


# Reading E57: files of this library on their grid, others by rows and columns, or as a single row of points.
#
# The format is read here, in blocks, and not by libE57: its XML parser resolves external entities, from files and over
# the network, and cannot be interrupted meanwhile.

MAX_XML_BYTES = 1 << 24
"""Enough for 1024 scans with pictures, or for 64 stations that each name all others."""
MAX_SCANS = 1024
_SINGLE_M = 128.0
"""Coordinates up to which a single is good to 8 um."""
_UNIT = 1e-2
"""How far the length of a quaternion may differ from 1, since it may be written with few digits."""
_CARTESIAN = {f"cartesian{axis}": axis.lower() for axis in "XYZ"}
_SPHERICAL = {"sphericalRange": "range", "sphericalAzimuth": "azimuth", "sphericalElevation": "elevation"}
_STATES = ("cartesianInvalidState", "sphericalInvalidState")
_COLOUR_LIMITS = {colour: f"colorLimits/color{colour.title()}Maximum" for colour in ("red", "green", "blue")}
Block = dict[str, np.ndarray]


def read_e57(file: BinaryIO, reading: Reading) -> StoredCloud:
    """A cloud of all scans of an E57 file, in the frame of the file; our own files give the grid and its stations."""
    size = os.fstat(file.fileno()).st_size
    place, length = _places(file.read(48), size)
    pages = Pages(file, size)
    root = parse_xml(
        pages.read(without_checksums(place), length), name=file.name, error=CloudError, limit=MAX_XML_BYTES
    )
    scans = list(_scans_of(root, pages, size, reading))
    if not scans:
        raise CloudError("holds no points.")
    lines = scans[0].lines
    cloud, about = _joined(scans), about_of(lines)
    frame = root.find("coordinateMetadata")
    epsg = about.epsg if about.epsg is not None or frame is None else epsg_of(frame.text)
    # The standard has no other unit, and z is up in the frame of a levelled scanner.
    about = about._replace(epsg=epsg, metres=METRE, unit_by="the format", upright=True)
    return StoredCloud(cloud, about, () if lines else _words(scans))


def _places(head: bytes, size: int) -> tuple[int, int]:
    """Place and length of the XML, after a look at the sizes in the head."""
    if len(head) < 48 or head[:8] != b"ASTM-E57":
        raise CloudError("not an E57 file.")
    (version,) = struct.unpack_from("<I", head, 8)
    length, place, xml, page = struct.unpack_from("<QQQQ", head, 16)
    if length > size or place > size or xml > min(size, MAX_XML_BYTES) or page != PAGE:
        raise CloudError("the head announces more than the file holds; it is damaged or cut short.")
    if version > 1:
        raise CloudError(f"found version {version} of E57, expected 1.")
    return place, xml


def _scans_of(root: Element, pages: Pages, size: int, reading: Reading) -> Iterator["_StoredScan"]:
    """The scans that have points."""
    listed = root.find("data3D")
    scans = [] if listed is None else listed.children
    if len(scans) > MAX_SCANS:
        raise CloudError(f"found {len(scans)} scans, expected at most {MAX_SCANS}.")
    left = 8 * size
    for scan in scans:
        points = scan.find("points")
        if points is None:
            continue
        count, fields = int(points.attributes.get("recordCount", "0")), _fields_of(points.find("prototype"))
        # A point takes more than a byte; without data a file could announce any number of equal ones.
        left -= max(8, sum(field.bits for field in fields)) * count
        if count < 0 or left < 0:
            raise CloudError(f"announces {count} points, which the file cannot hold; it is damaged.")
        if count:
            place = int(points.attributes.get("fileOffset", "0"))
            yield _StoredScan(scan, fields, partial(read_blocks, pages, place, count, fields), count, reading)


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
        return Field(name, 32 if single else 64, single, brightest=float(words.get("maximum", "inf")))
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


class _StoredScan:
    """A scan of a file with all columns that a cloud can use, in the frame of the file."""

    def __init__(
        self,
        scan: Element,
        fields: list[Field],
        read: Callable[[Sequence[int]], Iterator[list[np.ndarray]]],
        count: int,
        reading: Reading,
    ) -> None:
        """`read` gives the values of some of the `fields`, a block at a time."""
        header = scan.find(f"{OWN}header")
        self.lines = [] if header is None else header.text.splitlines()
        """The lines of our header; none where another program wrote it."""
        self._read, self._pose = read, _pose(scan)
        self._turns = not np.array_equal(self._pose, np.eye(4))
        names = {field.name: k for k, field in enumerate(fields) if field.readable}
        self._cartesian = _CARTESIAN.keys() <= names.keys()
        if not (self._cartesian or _SPHERICAL.keys() <= names.keys()):
            raise CloudError("the points have no x, y and z.")
        # A file may hold both; the state of one says nothing of the other.
        known = {name: column for name, column in (COLUMNS | _OWN_COLUMNS).items() if name not in _CARTESIAN}
        known = (_CARTESIAN if self._cartesian else _SPHERICAL) | known | {_STATES[not self._cartesian]: "invalid"}
        self._numbers = {column: names[name] for name, column in known.items() if name in names}
        unused = [field.name for field in fields if field.name not in (*known, *_STATES)]
        self.unused = [name for name in unused if not name.startswith("spherical")]
        """Columns that a cloud has no place for."""
        self._full: dict[str, float] = {}
        ranges = self._ranges(scan, fields, reading)
        self.colours = ranges[0].words if ranges else ""
        """The decision on the range of its colours, in words."""
        if all(one.brightest for one in ranges):
            self._full = {colour: one.brightest for colour, one in zip(_COLOUR_LIMITS, ranges, strict=False)}
        for colour in () if self._full else _COLOUR_LIMITS:
            self._numbers.pop(colour, None)
        self.named = [column for column in self._numbers if column not in ("invalid", *_OWN_COLUMNS.values())]
        """Columns that the standard names."""
        self.points, single = count, self._cartesian and all(fields[self._numbers[one]].type == "f4" for one in AXES)
        if "invalid" in self._numbers or (self._turns and single):
            # Singles suffice where nothing is lost by them; what is not finite is dropped later.
            self.points, reach = 0, 0.0
            for block in self.blocks(()):
                self.points += len(block["x"])
                places = np.abs([block[axis] for axis in AXES])
                reach = max(reach, float(np.max(places, where=np.isfinite(places), initial=0.0)))
            single = single and (not self._turns or reach <= _SINGLE_M)
        kept = [name for name in self._numbers if name not in (*AXES, *_SPHERICAL.values(), "invalid")]
        self.types = dict.fromkeys(AXES, "f4" if single else "f8") | {
            name: "u1" if name in self._full else _type_in_cloud(fields[self._numbers[name]], name) for name in kept
        }
        """Type of each column."""

    def _ranges(self, scan: Element, fields: list[Field], reading: Reading) -> list[Range]:
        """The number of full brightness of each colour; none without colours.

        By what they reach together, the limits of the scan, and those of its columns: limits are not always true, and
        often not there.
        """
        if not _COLOUR_LIMITS.keys() <= self._numbers.keys():
            return []
        mine = {colour: fields[self._numbers[colour]] for colour in _COLOUR_LIMITS}
        kind, reach = np.result_type(*(np.dtype(field.type) for field in mine.values())), Reach()
        for block in () if kind == np.uint8 else self._columns(mine):
            for values in block.values():
                reach = reach.with_more(values)
        found = []
        for colour, path in _COLOUR_LIMITS.items():
            stated = _number(scan.find(path), 0.0)
            stated = stated if 0 < stated < math.inf else float(mine[colour].brightest)
            found.append(range_of(kind, reach, reading, stated=stated if 0 < stated <= 65535 else None))
        return found

    def _columns(self, wanted: Iterable[str]) -> Iterator[Block]:
        """Columns as they are stored."""
        names = list(wanted)
        for values in self._read([self._numbers[name] for name in names]):
            yield dict(zip(names, values, strict=True))

    def blocks(self, wanted: Iterable[str]) -> Iterator[Block]:
        """The points that the scan calls valid with x, y, z and other columns, carried along by the pose."""
        chosen = {*wanted, *AXES, *_SPHERICAL.values(), "invalid"}
        for block in self._columns([name for name in self._numbers if name in chosen]):
            if "invalid" in block:
                valid = block.pop("invalid") == 0
                block = {name: values[valid] for name, values in block.items()}
            for colour in self._full.keys() & block.keys():
                block[colour] = as_bytes(block[colour], self._full[colour])
            block = block if self._cartesian else _cartesian(block)
            for names, place in ((AXES, self._pose[:3, 3]), (NORMALS, np.zeros(3))) if self._turns else ():
                if set(names) <= block.keys():
                    moved = np.stack([block[name].astype(np.float64) for name in names], -1) @ self._pose[:3, :3].T
                    block |= dict(zip(names, (moved + place).T, strict=True))
            yield block


def _type_in_cloud(field: Field, column: str) -> str:
    """Type of a column: what is turned is a float, and what counts profiles or lines counts further in other scans."""
    if column in NORMALS:
        return field.type if field.single is not None else "f8"
    return "i4" if field.type == "u1" and column in ("step", "row", "profile", "record") else field.type


def _cartesian(block: Block) -> Block:
    distance, azimuth, elevation = (block.pop(name).astype(np.float64) for name in _SPHERICAL.values())
    flat = distance * np.cos(elevation)
    return block | {"x": flat * np.cos(azimuth), "y": flat * np.sin(azimuth), "z": distance * np.sin(elevation)}


def _number(element: Element | None, default: float) -> float:
    """The number that an element holds: 0 where it is empty."""
    return default if element is None else float(element.text.strip() or "0")


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


def _joined(scans: list[_StoredScan]) -> PointCloud:
    """The cloud of all scans; beside it only a block of points is in memory at a time."""
    parts = [scan for scan in scans if scan.points]
    if not parts:
        raise CloudError("holds no valid point.")
    together = sorted({field for part in parts for field in part.types})
    kinds = [(field, np.result_type(*(one.types[field] for one in parts if field in one.types))) for field in together]

    def read() -> Iterator[np.ndarray]:
        for part in parts:
            for block in part.blocks(part.types):
                points = np.zeros(len(block["x"]), kinds)
                for field, values in block.items():
                    points[field] = values
                # In our own files profiles are counted through all stations, and steps within each.
                if part.lines and "profile" in block:
                    points["step"] = points["profile"]
                yield points

    return cloud_of(Records(np.dtype(kinds), sum(part.points for part in parts), read), scans[0].lines)


def _words(scans: list[_StoredScan]) -> tuple[str, ...]:
    """The decisions in words, for the note."""
    named = dict.fromkeys(name for scan in scans for name in scan.named)
    unused = dict.fromkeys(name for scan in scans for name in scan.unused)
    ranges = dict.fromkeys(scan.colours for scan in scans if scan.colours)
    return (
        f"{', '.join(named)} by the format",
        *([f"not used: {', '.join(unused)[:80]}"] if unused else []),
        *ranges,
        *([f"{len(scans)} scans in one frame"] if len(scans) > 1 else []),
    )


_COLOURS = ("colorRed", "colorGreen", "colorBlue")
_GPS_EPOCH_S, _LEAP_S = 315964800, 18
"""GPS time counts from 1980-01-06 without leap seconds."""


def write_e57(cloud: PointCloud, path: Part, about: About, around: Surroundings | None = None) -> None:
    """Write one scan for each station: metres, pose, row and column index, colour, intensity [DN], normals.

    The column is the profile of the station, the row the line. Points are in the station's own frame; the pose of the
    scan carries them into that of the room, and its description holds digest and covariance. Coordinates are float32,
    or float64 where the cloud holds it; intensity is float32. Sigmas, laser, angle and record are an extension.
    The surroundings belong to the first scan.

    Raises:
        CloudError: If the EPSG code is none in metres.
        DependencyError: If pye57, or pyproj for a code, is not installed.
        OSError: If the file cannot be written.
    """
    with _created(path, about) as file:
        file.add_stations(cloud, about, header_lines(cloud, about))
        if around is not None:
            pose = np.eye(4) if cloud.stations is None else np.asarray(cloud.stations.pose, np.float64)[0]
            file.add_surroundings(around, pose)


def write_e57_stations(stations: Sequence[Callable[[], PointCloud]], path: Part, about: About) -> None:
    """Write the clouds of several stations as `write_e57` writes the joined one; only one is in memory.

    Args:
        stations: Each gives the cloud of one station in the frame of the room, with its pose, whenever it is called:
            twice, for the first scan already says where all stations are.
        about: What is said of them all.

    Raises:
        CloudError: As `write_e57`, or if the clouds are not of one camera, or one has no pose.
        DependencyError: If pye57, or pyproj for a code, is not installed.
        OSError: If the file cannot be written.
    """
    # Said before the clouds are read.
    load_libe57()
    shapes: list[tuple[int, ...]] = []
    placed: list[Stations] = []
    for load in stations:
        cloud = load()
        if cloud.stations is None or len(cloud.stations.pose) != 1:
            raise CloudError("a scan of several: expected the cloud of one station with its pose.")
        placed.append(cloud.stations)
        shapes.append(cloud.valid.shape)
        del cloud
    if len({lines for _, lines in shapes}) != 1:
        raise CloudError(f"{path}: expected clouds of one camera, with the same number of lines.")
    first = [0, *itertools.accumulate(profiles for profiles, _ in shapes)]
    number = np.repeat(np.arange(len(placed), dtype=np.int32), np.diff(first))
    pose, covariance = (np.concatenate([np.asarray(one[k], np.float64) for one in placed]) for k in (1, 2))
    header = lines_of_grid((len(number), shapes[0][1]), Stations(number, pose, covariance), about)
    with _created(path, about) as file:
        for k, load in enumerate(stations):
            file.add_stations(load(), about, header, station=k, profile=first[k])


def _columns(cloud: PointCloud, profile: np.ndarray | None, station: int) -> Iterator[dict[str, np.ndarray]]:
    """The columns of a scan by the names of the format, a block at a time, in types that the binding takes.

    Where the cloud has several stations, points also have their profile in the whole cloud.
    """
    for points in blocks(cloud):
        values = columns(points, cloud)
        kept = set(known_names(values, cloud))
        if profile is not None:
            values |= {"profile": profile[points.step], "station": np.full(len(points.step), station)}
            kept |= {"profile", "station"}
        # A constant column takes no room in the file, and some readers require it.
        block: dict[str, np.ndarray] = {"cartesianInvalidState": np.zeros(len(points.step), np.longlong)}
        for key, name in (COLUMNS | _OWN_COLUMNS).items():
            if name in kept:
                # Bounds are checked in double. The binding takes NumPy's int64 for 32 bits, not longlong.
                whole = np.uint8 if key in _COLOURS else np.longlong
                kind = np.float64 if values[name].dtype.kind == "f" else whole
                block[key] = np.ascontiguousarray(values[name], kind)
        yield block


def _pose_of(pose: np.ndarray) -> dict[str, Any]:
    """A pose [4, 4] as the format has it."""
    turn, place = quaternion(pose[:3, :3]), pose[:3, 3].tolist()
    return {"rotation": dict(zip("wxyz", turn, strict=True)), "translation": dict(zip("xyz", place, strict=True))}


def _guid() -> str:
    return f"{{{uuid.uuid4()}}}"


def _moment(unix_s: float) -> dict[str, Any]:
    return {"dateTimeValue": unix_s - _GPS_EPOCH_S + _LEAP_S, "isAtomicClockReferenced": 0}


@contextlib.contextmanager
def _created(path: Part, about: About) -> "Iterator[_File]":
    e57 = load_libe57()
    frame = "" if about.epsg is None else wkt_of(about.epsg)
    try:
        with contextlib.closing(e57.ImageFile(str(path), "w")) as image:
            yield _File(e57, image, frame)
    except e57.E57Exception as problem:
        raise OSError(str(problem).splitlines()[0]) from problem


class _File:
    """A file of libE57 that is written."""

    def __init__(self, e57: Any, image: Any, frame: str) -> None:
        """Write the head of the file; `frame` is the WKT of its coordinates, or empty."""
        self._e57, self._image = e57, image
        for prefix, uri in (("", e57.E57_V1_0_URI), ("nor", NORMALS_URI), (OWN.rstrip(":"), OWN_URI)):
            image.extensionsAdd(prefix, uri)
        self._scans, self._pictures = e57.VectorNode(image, True), e57.VectorNode(image, True)
        for key, value in {
            "formatName": "ASTM E57 3D Imaging Data File",
            "guid": _guid(),
            "versionMajor": e57.E57_FORMAT_MAJOR,
            "versionMinor": e57.E57_FORMAT_MINOR,
            "e57LibraryVersion": e57.E57_LIBRARY_ID,
            "coordinateMetadata": frame,
            "creationDateTime": _moment(time.time()),
            "data3D": self._scans,
            "images2D": self._pictures,
        }.items():
            image.root().set(key, self._node(value))

    def _node(self, value: Any) -> Any:
        """A tree of dicts, texts and numbers as nodes; nodes stay."""
        if isinstance(value, dict):
            made = self._e57.StructureNode(self._image)
            for key, inner in value.items():
                made.set(key, self._node(inner))
            return made
        for kind, node in ((str, "StringNode"), (int, "IntegerNode"), (float, "FloatNode")):
            if isinstance(value, kind):
                return getattr(self._e57, node)(self._image, value)
        return value

    def add_stations(
        self, cloud: PointCloud, about: About, header: Sequence[str], *, station: int = 0, profile: int = 0
    ) -> None:
        """Append a scan for each station of a cloud that saw something.

        Args:
            header: Lines of the whole file.
            station, profile: The first numbers of the cloud's stations and profiles in the whole file.
        """
        words = ["jaxscan", *([f"calibration {about.calibration}"] if about.calibration else [])]
        poses = np.eye(4)[None] if cloud.stations is None else np.asarray(cloud.stations.pose, np.float64)
        for k, pose in enumerate(poses):
            name, described, profiles = ", ".join(words), "; ".join(words), None
            if cloud.stations is not None:
                name += f", station {station + k}"
                described += (
                    "; covariance of the pose, of a step (translation x y z [m], rotation x y z [rad]) in the scan's "
                    f"own frame, upper triangle by rows: {covariance_text(cloud.stations.covariance[k])}"
                )
                # The column counts the profiles of the scan.
                profiles = profile + np.flatnonzero(cloud.stations.number == k)
            mine = of_station(cloud, k)
            if np.any(mine.valid):
                tree = {"guid": _guid(), "name": name, "description": described, f"{OWN}header": "\n".join(header)}
                points = partial(_columns, mine, profiles, station + k)
                self._add_scan(tree | {"pose": _pose_of(pose)}, points, double=mine.xyz.dtype == np.float64)

    def _add_scan(
        self, tree: dict[str, Any], columns: Callable[[], Iterator[dict[str, np.ndarray]]], *, double: bool
    ) -> None:
        """Append a scan: the bounds of its columns, which stand before the points, and then the points."""
        least: dict[str, Any] = {}
        most: dict[str, Any] = {}
        types: dict[str, np.dtype] = {}
        largest = 0
        for block in columns():
            largest = max(largest, len(block["cartesianX"]))
            for key, values in block.items():
                types[key] = values.dtype
                least[key] = min(values.min().item(), least.get(key, math.inf))
                most[key] = max(values.max().item(), most.get(key, -math.inf))
        for key in set(_COLOURS) & types.keys():
            least[key], most[key] = 0, 255

        for limits, ends in (
            ("cartesianBounds", {axis: f"cartesian{axis.upper()}" for axis in "xyz"}),
            ("indexBounds", {"row": "rowIndex", "column": "columnIndex"}),
            ("intensityLimits", {"intensity": "intensity"}),
            ("colorLimits", {key: key for key in _COLOURS}),
        ):
            if set(ends.values()) <= types.keys():
                tree[limits] = {f"{name}Minimum": least[key] for name, key in ends.items()}
                tree[limits] |= {f"{name}Maximum": most[key] for name, key in ends.items()}
        e57, image = self._e57, self._image
        prototype, buffers = e57.StructureNode(image), e57.VectorSourceDestBuffer()
        buffer = {key: np.empty(largest, kind) for key, kind in types.items()}
        for key, values in buffer.items():
            if values.dtype == np.float64:
                wide = key == f"{OWN}angle" or (double and key.startswith("cartesian"))
                kind = e57.E57_DOUBLE if wide else e57.E57_SINGLE
                node = e57.FloatNode(image, least[key], kind, least[key], most[key])
            else:
                node = e57.IntegerNode(image, least[key], least[key], most[key])
            prototype.set(key, node)
            buffers.append(e57.SourceDestBuffer(image, key, values, len(values), True, True))
        points = e57.CompressedVectorNode(image, prototype, e57.VectorNode(image, True))
        self._scans.append(self._node(tree | {"points": points}))
        with contextlib.closing(points.writer(buffers)) as writer:
            for block in columns():
                count = len(block["cartesianX"])
                for key, values in block.items():
                    buffer[key][:count] = values
                writer.write(count)

    def add_surroundings(self, around: Surroundings, pose: np.ndarray) -> None:
        """Append pictures and times of the first scan, whose pose T_file_scan is given."""
        if around.started_s is not None:
            self._scans[0].set("acquisitionStart", self._node(_moment(around.started_s)))
        panorama = around.panorama
        step = 2 * np.pi / panorama.width
        shown = {"pixelWidth": step, "pixelHeight": step}
        words = "panorama", "laser-off images of the sweep, blended"
        self._add_picture(panorama, ("sphericalRepresentation", shown), pose, words)
        for number, picture in enumerate(around.photographs):
            # Only ratios matter: the sensor's pixels are taken to be a micrometre.
            shown = {"focalLength": 1e-6 * picture.focal_px, "pixelWidth": 1e-6, "pixelHeight": 1e-6}
            shown |= {"principalPointX": picture.centre[0], "principalPointY": picture.centre[1]}
            words = f"photograph {number}", "laser-off image, without distortion"
            self._add_picture(picture, ("pinholeRepresentation", shown), pose @ picture.pose, words)

    def _add_picture(
        self,
        picture: RoundPicture | FlatPicture,
        shown: tuple[str, dict[str, float]],
        pose: np.ndarray,
        words: tuple[str, str],
    ) -> None:
        """Append a picture: name and numbers of its representation, pose T_file_picture, name and description."""
        blob = self._e57.BlobNode(self._image, len(picture.jpeg))
        pixels = {"jpegImage": blob, "imageWidth": picture.width, "imageHeight": picture.height}
        tree = {
            "guid": _guid(),
            "name": words[0],
            "description": words[1],
            "associatedData3DGuid": self._scans[0]["guid"].value(),
            "pose": _pose_of(pose),
            shown[0]: shown[1] | pixels,
        }
        self._pictures.append(self._node(tree))
        # A blob has a place in the file only when its node has one.
        blob.write(np.frombuffer(picture.jpeg, np.uint8).copy(), 0, len(picture.jpeg))
