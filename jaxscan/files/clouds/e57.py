"""E57 (ASTM E2807), the exchange format of terrestrial scanning, through pye57."""

import contextlib
from pathlib import Path

import numpy as np

from jaxscan.errors import DependencyError
from jaxscan.files.clouds.points import columns
from jaxscan.reconstruction import PointCloud


# Coordinates and intensity are float32 in the file, but its bounds are checked in double.
_FIELDS = {
    "cartesianX": ("x", np.float64),
    "cartesianY": ("y", np.float64),
    "cartesianZ": ("z", np.float64),
    "intensity": ("intensity", np.float64),
    "colorRed": ("red", np.uint8),
    "colorGreen": ("green", np.uint8),
    "colorBlue": ("blue", np.uint8),
    "rowIndex": ("row", np.uint32),
    "columnIndex": ("step", np.uint32),
}


def write_e57(cloud: PointCloud, path: Path, digest: str) -> None:
    """Write one scan: metres, pose, row and column index, colour, intensity [DN].

    The column is the profile, the row the line. The library holds neither normals nor sigmas.

    Raises:
        DependencyError: If pye57 is not installed.
        OSError: If the file cannot be written.
    """
    try:
        import pye57
    except ImportError as problem:
        raise DependencyError('E57 needs pye57: pip install "jaxscan[export]"') from problem
    values = columns(cloud.points())
    fields = {name: np.ascontiguousarray(values[column], dtype) for name, (column, dtype) in _FIELDS.items()}
    name = f"jaxscan, calibration {digest}" if digest else "jaxscan"
    try:
        with contextlib.closing(pye57.E57(str(path), mode="w")) as file:
            file.write_scan_raw(fields, name=name, rotation=np.array([1.0, 0.0, 0.0, 0.0]), translation=np.zeros(3))
    except pye57.libe57.E57Exception as problem:
        raise OSError(str(problem).splitlines()[0]) from problem
