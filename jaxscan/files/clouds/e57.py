"""E57 (ASTM E2807), the exchange format of terrestrial scanning, through pye57."""

from pathlib import Path

import numpy as np

from jaxscan.errors import DependencyError
from jaxscan.files.clouds.points import all_points
from jaxscan.reconstruction import PointCloud


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
    points = all_points(cloud)
    # Doubles that are exactly the singles which the file holds: its bounds are checked in double.
    x, y, z = points.xyz.astype(np.float64).T
    red, green, blue = points.rgb.T
    fields = {
        "cartesianX": x,
        "cartesianY": y,
        "cartesianZ": z,
        "intensity": points.intensity.astype(np.float64),
        "colorRed": red,
        "colorGreen": green,
        "colorBlue": blue,
        "rowIndex": points.row.astype(np.uint32),
        "columnIndex": points.step.astype(np.uint32),
    }
    fields = {name: np.ascontiguousarray(values) for name, values in fields.items()}
    name = f"jaxscan, calibration {digest}" if digest else "jaxscan"
    try:
        file = pye57.E57(str(path), mode="w")
        try:
            file.write_scan_raw(fields, name=name, rotation=np.array([1.0, 0.0, 0.0, 0.0]), translation=np.zeros(3))
        finally:
            file.close()
    except pye57.libe57.E57Exception as problem:
        raise OSError(str(problem).splitlines()[0]) from problem
