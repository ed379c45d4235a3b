"""Text formats: XYZ, which every program reads, and PTX, which keeps the grid."""

from pathlib import Path
from typing import TextIO

import numpy as np

from jaxscan.files.clouds.points import blocks
from jaxscan.reconstruction import PointCloud, of_station


# A micrometre is far below any scanner's noise, and near the resolution of float32.
_XYZ_LINE = "%.6f %.6f %.6f %d %d %d\n"
_PTX_LINE = "%.6f %.6f %.6f %.4f %d %d %d\n"
_PTX_HOLE = "0 0 0 0.500000 0 0 0\n"


def write_xyz(cloud: PointCloud, path: Path, digest: str) -> None:
    """Write `x y z r g b` of the valid points, a line each; metres."""
    with open(path, "w", encoding="ascii", newline="\n") as file:
        for points in blocks(cloud):
            rows = zip(points.xyz.tolist(), points.rgb.tolist(), strict=True)
            file.writelines(_XYZ_LINE % (*position, *colour) for position, colour in rows)


def write_ptx(cloud: PointCloud, path: Path, digest: str) -> None:
    """Write the whole grid, a block per station and laser: `x y z intensity r g b`, holes as zeros.

    Columns are profiles; a column runs upwards, from the last line to the first, as in files of
    other scanners. Points are in the scanner frame of the station, whose pose heads the block.
    """
    poses = np.eye(4)[None] if cloud.stations is None else np.asarray(cloud.stations.pose, np.float64)
    with open(path, "w", encoding="ascii", newline="\n") as file:
        for number, pose in enumerate(poses):
            station = of_station(cloud, number)
            for laser in np.unique(np.asarray(station.laser)):
                profiles = np.flatnonzero(np.asarray(station.laser) == laser)
                file.write(f"{len(profiles)}\n{station.valid.shape[1]}\n" + _ptx_pose(pose))
                for profile in profiles:
                    _write_column(file, station, int(profile))


def _ptx_pose(pose: np.ndarray) -> str:
    """Place and axes of the scanner, and the motion for rows of coordinates: the transpose of T_room_scanner."""
    rows = (pose[:3, 3], *pose[:3, :3].T, *pose.T)
    return "".join(" ".join(f"{value:.17g}" for value in row) + "\n" for row in rows)


def _write_column(file: TextIO, cloud: PointCloud, profile: int) -> None:
    def column(field):
        return np.asarray(field[profile])[::-1]

    valid = column(cloud.valid)
    # The format's intensity is between 0 and 1; an amplitude may exceed the range of a pixel.
    intensity = np.clip(column(cloud.intensity) / 255, 0, 1)
    rows = zip(valid, column(cloud.xyz).tolist(), intensity.tolist(), column(cloud.rgb).tolist(), strict=True)
    file.writelines(_PTX_LINE % (*xyz, level, *rgb) if seen else _PTX_HOLE for seen, xyz, level, rgb in rows)
