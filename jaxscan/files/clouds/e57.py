"""E57 (ASTM E2807), the exchange format of terrestrial scanning, through pye57's binding of libE57."""

import contextlib
import uuid
from pathlib import Path
from typing import Any

import numpy as np

from jaxscan.errors import DependencyError
from jaxscan.files.clouds.points import columns
from jaxscan.reconstruction import PointCloud


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
    """Write one scan: metres, pose, row and column index, colour, intensity [DN].

    The column is the profile, the row the line. Coordinates are float32, or float64 where the cloud holds it;
    intensity is float32. The library holds neither normals nor sigmas.

    Raises:
        DependencyError: If pye57 is not installed.
        OSError: If the file cannot be written.
    """
    try:
        import pye57
    except ImportError as problem:
        raise DependencyError('E57 needs pye57: pip install "jaxscan[export]"') from problem
    points = cloud.points()
    values = columns(points)
    fields = {name: np.ascontiguousarray(values[column], dtype) for name, (column, dtype) in _FIELDS.items()}
    name = f"jaxscan, calibration {digest}" if digest else "jaxscan"
    try:
        with contextlib.closing(pye57.E57(str(path), mode="w")) as file:
            _write_scan(pye57.libe57, file, fields, name, double=points.xyz.dtype == np.float64)
    except pye57.libe57.E57Exception as problem:
        raise OSError(str(problem).splitlines()[0]) from problem


def _write_scan(e57: Any, file: Any, fields: dict[str, np.ndarray], name: str, *, double: bool) -> None:
    """Append a scan with the identity as its pose.

    pye57's own function writes singles alone, and row numbers modulo 65536.
    """
    image = file.image_file

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
    scan.set("name", e57.StringNode(image, name))
    scan.set("description", e57.StringNode(image, "jaxscan"))
    scan.set("indexBounds", bounds({"row": "rowIndex", "column": "columnIndex"}))
    scan.set("intensityLimits", bounds({"intensity": "intensity"}))
    colours = ("colorRed", "colorGreen", "colorBlue")
    scan.set("colorLimits", structure({f"{key}{end}": k * 255 for key in colours for k, end in _ENDS}))
    scan.set("cartesianBounds", bounds({axis: f"cartesian{axis.upper()}" for axis in "xyz"}))
    scan.set("pose", pose)
    pose.set("rotation", structure({"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0}))
    pose.set("translation", structure(dict.fromkeys("xyz", 0.0)))
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
