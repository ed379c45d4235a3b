"""Reading E57: files of this library on their grid, others by rows and columns, or as a single row of points."""

import contextlib
import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.clouds.about import StoredCloud, about_of, version_of
from jaxscan.files.clouds.crs import epsg_of
from jaxscan.files.clouds.e57.library import COLUMNS, OWN, load_libe57, node_at, value_at
from jaxscan.files.clouds.e57.scans import Scan, joined
from jaxscan.files.disk import open_regular


MAX_XML_BYTES = 1 << 24
MAX_SCANS = 1024
_BLOCK_POINTS = 1 << 18
_SPHERICAL = {"sphericalRange": "range", "sphericalAzimuth": "azimuth", "sphericalElevation": "elevation"}
_INVALID = {"cartesianInvalidState": "invalid", "sphericalInvalidState": "invalid"}
_KNOWN = COLUMNS | _SPHERICAL | _INVALID
_OWN_COLUMNS = {
    f"{OWN}{name}": name
    for name in (
        *("sigma", "sigma_random", "sigma_systematic", "laser", "angle", "record", "profile", "station"),
        *("sigma_row", "shift_px", "shared_lines"),
    )
}


def read_e57(path: Path) -> StoredCloud:
    """A cloud of all scans of an E57 file, in the frame of the file.

    Raises:
        CloudError: If it is damaged or has no points.
        DependencyError: If pye57 is not installed.
    """
    with open_regular(path, error=CloudError) as file:
        size = os.fstat(file.fileno()).st_size
        _check(file, size, path)
    e57 = load_libe57()
    try:
        with contextlib.closing(e57.ImageFile(str(path), "r")) as image:
            root = image.root()
            frame = str(value_at(root, "coordinateMetadata") or "")
            scans = list(_scans(e57, image, root, size, path))
    except (e57.E57Exception, ValueError, TypeError, KeyError, AttributeError, RuntimeError, OverflowError) as problem:
        reason = (str(problem).splitlines() or [""])[0]
        raise CloudError(f"{path}: not a readable E57 file: {reason:.100}.") from problem
    lines = scans[0].lines if scans else []
    if sum(len(scan.points) for scan in scans) == 0:
        raise CloudError(f"{path}: holds no points.")
    version_of(lines, str(path))
    about = about_of(lines)
    epsg = about.epsg if about.epsg is not None else epsg_of(frame)
    # The standard knows no other unit, and z up in the frame of a levelled scanner.
    return StoredCloud(joined(scans, str(path)), about._replace(epsg=epsg, in_metres=True, upright=True))


def _check(file: BinaryIO, size: int, path: Path) -> None:
    """Look at the sizes in the head, and at the XML for definitions that unfold: its parser would unfold them."""
    head = file.read(48)
    if len(head) < 48 or head[:8] != b"ASTM-E57":
        raise CloudError(f"{path}: not an E57 file.")
    length, place, xml, page = struct.unpack_from("<QQQQ", head, 16)
    if length > size or place > size or xml > min(size, MAX_XML_BYTES) or page != 1024:
        raise CloudError(f"{path}: the head announces more than the file holds; it is damaged or cut short.")
    file.seek(place // page * page)
    data = file.read((place % page + xml) * page // (page - 4) + 2 * page)
    # A checksum ends every page.
    text = b"".join(data[k : k + page - 4] for k in range(0, len(data), page))[place % page :][:xml]
    if b"<!" in text.replace(b"<![CDATA[", b"") or b"\0" in text:
        raise CloudError(f"{path}: its XML holds definitions, which no E57 file needs; it is refused.")


def _scans(e57: Any, image: Any, root: Any, size: int, path: Path) -> Iterator[Scan]:
    if not root.isDefined("data3D"):
        return
    listed = node_at(root, "data3D")
    if listed.childCount() > MAX_SCANS:
        raise CloudError(f"{path}: found {listed.childCount()} scans, expected at most {MAX_SCANS}.")
    left = size
    for k in range(listed.childCount()):
        scan = node_at(listed, k)
        if not scan.isDefined("points"):
            continue
        vector = node_at(scan, "points")
        # A point takes more than a byte; without data a file could announce any number of equal ones.
        left -= vector.childCount()
        if left < 0:
            raise CloudError(
                f"{path}: announces {vector.childCount()} points, which the file cannot hold; it is damaged."
            )
        points = _read_points(e57, image, vector, _colour_limit(scan))
        yield Scan(points, _pose(scan), str(value_at(scan, f"{OWN}header") or "").splitlines())


def _read_points(e57: Any, image: Any, vector: Any, brightest: float) -> np.ndarray:
    """All columns of a scan that a cloud can use, as records."""
    prototype = e57.StructureNode(vector.prototype())
    names = [prototype.get(k).elementName() for k in range(prototype.childCount())]
    wanted = {name: (_KNOWN | _OWN_COLUMNS)[name] for name in names if name in _KNOWN or name in _OWN_COLUMNS}
    types = {column: _type_of(e57, node_at(prototype, name)) for name, column in wanted.items()}
    colours = [column for column in ("red", "green", "blue") if column in types]
    stored = {column: "u1" if column in colours else kind for column, kind in types.items()}
    count = vector.childCount()
    points = np.empty(count, list(stored.items()))
    if not wanted or count == 0:
        return points
    block = {name: np.empty(min(_BLOCK_POINTS, count), types[column]) for name, column in wanted.items()}
    buffers = e57.VectorSourceDestBuffer()
    for name, values in block.items():
        buffers.append(e57.SourceDestBuffer(image, name, values, len(values), True, True))
    done = 0
    with contextlib.closing(vector.reader(buffers)) as reader:
        while done < count and (read := reader.read()):
            for name, column in wanted.items():
                values = block[name][:read]
                if column in colours and brightest != 255:
                    values = np.clip(np.round(values * (255 / brightest)), 0, 255)
                points[column][done : done + read] = values
            done += read
    if done < count:
        raise ValueError(f"found {done} points of {count}")
    return points


def _type_of(e57: Any, node: Any) -> str:
    """A type that holds the values of a column and that the binding takes."""
    if isinstance(node, e57.FloatNode):
        return "f4" if node.precision() == e57.E57_SINGLE else "f8"
    return "q" if isinstance(node, e57.IntegerNode) else "f8"


def _colour_limit(scan: Any) -> float:
    """The number of full brightness."""
    value = value_at(scan, "colorLimits/colorRedMaximum")
    return float(value) if value is not None and value > 0 else 255.0


def _pose(scan: Any) -> np.ndarray:
    """T_file_scan [4, 4]."""

    def read(key: str, default: float) -> float:
        value = value_at(scan, f"pose/{key}")
        return default if value is None else float(value)

    pose = np.eye(4)
    pose[:3, 3] = [read(f"translation/{axis}", 0.0) for axis in "xyz"]
    q = np.array([read("rotation/w", 1.0), *(read(f"rotation/{axis}", 0.0) for axis in "xyz")])
    if not (np.isfinite(q).all() and np.isfinite(pose).all() and np.linalg.norm(q) > 0):
        raise ValueError("the pose of a scan is no rigid motion")
    w, x, y, z = q / np.linalg.norm(q)
    pose[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return pose
