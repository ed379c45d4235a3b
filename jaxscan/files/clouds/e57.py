"""E57 (ASTM E2807), the exchange format of terrestrial scanning, through pye57's binding of libE57."""

import contextlib
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxscan.errors import DependencyError
from jaxscan.files.clouds.points import columns
from jaxscan.files.clouds.stations import covariance_text, quaternion
from jaxscan.reconstruction import PointCloud, of_station


# Bounds of coordinates and intensity are checked in double. The binding takes NumPy's int64 for 32 bits, not longlong.
_FIELDS = {
    "cartesianX": ("x", np.float64),
    "cartesianY": ("y", np.float64),
    "cartesianZ": ("z", np.float64),
    "intensity": ("intensity", np.float64),
    "colorRed": ("red", np.uint8),
    "colorGreen": ("green", np.uint8),
    "colorBlue": ("blue", np.uint8),
    "rowIndex": ("row", np.longlong),
    "columnIndex": ("step", np.longlong),
}


def write_e57(cloud: PointCloud, path: Path, digest: str) -> None:
    """Write one scan for each station: metres, pose, row and column index, colour, intensity [DN].

    The column is the profile of the station, the row the line. Points are in the station's own frame; the pose of the
    scan carries them into that of the room, and its description holds the covariance. Coordinates are float32, or
    float64 where the cloud holds it; intensity is float32. The library holds neither normals nor sigmas.

    Raises:
        DependencyError: If pye57 is not installed.
        OSError: If the file cannot be written.
    """
    try:
        import pye57
    except ImportError as problem:
        raise DependencyError('E57 needs pye57: pip install "jaxscan[export]"') from problem
    name = f"jaxscan, calibration {digest}" if digest else "jaxscan"
    try:
        with contextlib.closing(pye57.E57(str(path), mode="w")) as file:
            for scan in _scans(cloud, name):
                _write_scan(pye57.libe57, file, scan)
    except pye57.libe57.E57Exception as problem:
        raise OSError(str(problem).splitlines()[0]) from problem


class _Scan(NamedTuple):
    name: str
    description: str
    rotation: tuple[float, float, float, float]
    """Unit quaternion (w, x, y, z)."""
    translation: tuple[float, float, float]
    fields: dict[str, np.ndarray]
    double: bool


def _scans(cloud: PointCloud, name: str) -> Iterator[_Scan]:
    """The stations that saw something, one at a time."""
    poses = np.eye(4)[None] if cloud.stations is None else np.asarray(cloud.stations.pose, np.float64)
    for number, pose in enumerate(poses):
        station, described = name, "jaxscan"
        if cloud.stations is not None:
            station = f"{name}, station {number}"
            described = (
                "jaxscan; covariance of the pose, of a step (translation x y z [m], rotation x y z [rad]) in the "
                f"scan's own frame, upper triangle by rows: {covariance_text(cloud.stations.covariance[number])}"
            )
        points = of_station(cloud, number).points()
        if len(points.xyz) == 0:
            continue
        values = columns(points)
        fields = {key: np.ascontiguousarray(values[column], dtype) for key, (column, dtype) in _FIELDS.items()}
        double = points.xyz.dtype == np.float64
        yield _Scan(station, described, quaternion(pose[:3, :3]), tuple(pose[:3, 3].tolist()), fields, double)


def _write_scan(e57: Any, file: Any, written: _Scan) -> None:
    """Append a scan.

    pye57's own function writes singles alone, and row numbers modulo 65536.
    """
    image, fields, double = file.image_file, written.fields, written.double

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
                f"{key}{end}": limit(fields[field]).item()
                for key, field in limits.items()
                for end, limit in (("Minimum", np.min), ("Maximum", np.max))
            }
        )

    scan, pose = e57.StructureNode(image), e57.StructureNode(image)
    scan.set("guid", e57.StringNode(image, f"{{{uuid.uuid4()}}}"))
    scan.set("name", e57.StringNode(image, written.name))
    scan.set("description", e57.StringNode(image, written.description))
    scan.set("indexBounds", bounds({"row": "rowIndex", "column": "columnIndex"}))
    scan.set("intensityLimits", bounds({"intensity": "intensity"}))
    colours = ("colorRed", "colorGreen", "colorBlue")
    scan.set("colorLimits", structure({f"{key}{end}": k * 255 for key in colours for k, end in _ENDS}))
    scan.set("cartesianBounds", bounds({axis: f"cartesian{axis.upper()}" for axis in "xyz"}))
    scan.set("pose", pose)
    pose.set("rotation", structure(dict(zip("wxyz", written.rotation, strict=True))))
    pose.set("translation", structure(dict(zip("xyz", written.translation, strict=True))))
    prototype, buffers = e57.StructureNode(image), e57.VectorSourceDestBuffer()
    for key, values in fields.items():
        least, most = values.min().item(), values.max().item()
        if values.dtype == np.float64:
            precision = e57.E57_DOUBLE if double and key != "intensity" else e57.E57_SINGLE
            node = e57.FloatNode(image, least, precision, least, most)
        else:
            limits = (0, 255) if key in colours else (least, most)
            node = e57.IntegerNode(image, limits[0], *limits)
        prototype.set(key, node)
        buffers.append(e57.SourceDestBuffer(image, key, values, len(values), True, True))
    points = e57.CompressedVectorNode(image, prototype, e57.VectorNode(image, True))
    scan.set("points", points)
    file.data3d.append(scan)
    with contextlib.closing(points.writer(buffers)) as writer:
        writer.write(len(fields["rowIndex"]))


_ENDS = ((0, "Minimum"), (1, "Maximum"))
