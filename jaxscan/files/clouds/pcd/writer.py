"""PCD, the format of the Point Cloud Library and of ROS; binary."""

import numpy as np

from jaxscan.files.clouds.about import About, header_lines
from jaxscan.files.clouds.points import POINT, blocks, columns, profiles_at_a_time, record_of, table
from jaxscan.files.clouds.seal import SEAL_LINE, seal
from jaxscan.files.disk import Part
from jaxscan.reconstruction import CloudPoints, PointCloud


_LONG = {"nx": "normal_x", "ny": "normal_y", "nz": "normal_z"}
_COLOURS = ("red", "green", "blue")
_POINT = np.dtype(
    [(_LONG.get(name, name), POINT[name].str) for name in (POINT.names or ())[:6]]
    # The library packs a colour as 0x00rrggbb and calls the four bytes a float.
    + [("rgb", "<u4")]
    + [(name, POINT[name].str) for name in (POINT.names or ())[6:] if name not in _COLOURS]
)
_KINDS = {"f": "F", "i": "I", "u": "U"}
CELLS_PER_POINT = 16
"""Emptier grids are written as a list of points, whose step and row tell their cells."""


def write_pcd(cloud: PointCloud, path: Part, about: About) -> None:
    """Write the grid, a profile as a row, with NaN where there is no point; coordinates as doubles if they are.

    A cloud of one profile, and one whose grid is almost empty, is written as a list of its points.
    """
    point = record_of(_POINT, cloud)
    names, count = point.names or (), int(np.count_nonzero(cloud.valid))
    profiles, lines = cloud.valid.shape
    organised = profiles > 1 and profiles * lines <= CELLS_PER_POINT * count
    width, height = (lines, profiles) if organised else (count, 1)
    header = [
        "# .PCD v0.7 - Point Cloud Data file format",
        *(f"# {line}" for line in (*header_lines(cloud, about), SEAL_LINE)),
        "VERSION 0.7",
        f"FIELDS {' '.join(names)}",
        f"SIZE {' '.join(str(point[name].itemsize) for name in names)}",
        f"TYPE {' '.join('F' if name == 'rgb' else _KINDS[point[name].kind] for name in names)}",
        f"COUNT {' '.join('1' for _ in names)}",
        f"WIDTH {width}",
        f"HEIGHT {height}",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {width * height}",
        "DATA binary",
        "",
    ]
    with open(path, "wb") as file:
        file.write("\n".join(header).encode("ascii"))
        if organised:
            for start, stop in profiles_at_a_time(cloud):
                cells = _empty(point, (stop - start, lines))
                points = cloud.points(start, stop)
                cells[points.step - start, points.row] = _records(cloud, points, point)
                file.write(cells.data)
        else:
            for points in blocks(cloud):
                file.write(_records(cloud, points, point).data)
    seal(path)


def _records(cloud: PointCloud, points: CloudPoints, point: np.dtype) -> np.ndarray:
    red, green, blue = points.rgb.astype(np.uint32).T
    packed = red << np.uint32(16) | green << np.uint32(8) | blue
    return table({**columns(points, cloud), "rgb": packed}, point)


def _empty(point: np.dtype, shape: tuple[int, int]) -> np.ndarray:
    """Cells without a point: NaN, which is how the format says so, and zero in whole numbers."""
    cells = np.zeros(shape, point)
    for name in point.names or ():
        if point[name].kind == "f":
            cells[name] = np.nan
    return cells
