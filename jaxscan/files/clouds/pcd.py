"""PCD, the format of the Point Cloud Library and of ROS; binary."""

from pathlib import Path

import numpy as np

from jaxscan.files.clouds.points import blocks, columns, frame_of, record_of, table
from jaxscan.reconstruction import PointCloud


_POINT = np.dtype(
    [(name, "<f4") for name in ("x", "y", "z", "normal_x", "normal_y", "normal_z")]
    # The library packs a colour as 0x00rrggbb and calls the four bytes a float.
    + [("rgb", "<u4")]
    + [(name, "<f4") for name in ("intensity", "sigma", "sigma_random", "sigma_systematic")]
)


def write_pcd(cloud: PointCloud, path: Path, digest: str) -> None:
    """Write the valid points, with normals, colours and uncertainties; doubles where the cloud holds doubles."""
    point = record_of(_POINT, cloud)
    names, count = point.names or (), int(np.count_nonzero(cloud.valid))
    header = [
        "# .PCD v0.7 - Point Cloud Data file format",
        f"# unit metre, frame {frame_of(cloud)}{', calibration ' + digest if digest else ''}",
        "VERSION 0.7",
        f"FIELDS {' '.join(names)}",
        f"SIZE {' '.join(str(point[name].itemsize) for name in names)}",
        f"TYPE {' '.join('U' if name == 'station' else 'F' for name in names)}",
        f"COUNT {' '.join('1' for _ in names)}",
        f"WIDTH {count}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {count}",
        "DATA binary",
        "",
    ]
    with open(path, "wb") as file:
        file.write("\n".join(header).encode("ascii"))
        for points in blocks(cloud):
            red, green, blue = points.rgb.astype(np.uint32).T
            packed = red << np.uint32(16) | green << np.uint32(8) | blue
            file.write(table({**columns(points), "rgb": packed}, point).data)
