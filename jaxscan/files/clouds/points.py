"""From the cloud on its grid to lists and tables of points, as file formats hold them."""

from collections.abc import Iterable, Iterator, Mapping
from typing import BinaryIO

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.reconstruction import SMOOTHED, CloudPoints, PointCloud, Stations


BLOCK_POINTS = 1 << 17
"""Points that are read or written at a time: enough to be fast, few enough for any memory."""

MAX_STATIONS = 64
"""Most stations of one cloud, so that their poses fit into the header of a PLY file."""

LARGEST = 1e15
"""Largest number of a point, so that its square is finite: micrometres on the Earth's orbit."""
_RANGES = {
    **dict.fromkeys(("xyz", "normals", "intensity", "shift_px"), (-LARGEST, LARGEST)),
    **dict.fromkeys(("sigma_random", "sigma_systematic", "sigma_row"), (0.0, LARGEST)),
    # Measurements compare every point with so many neighbours.
    "shared_lines": (0.0, 1e3),
}
POINT = np.dtype(
    [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")]
    + [(name, "u1") for name in ("red", "green", "blue")]
    + [(name, "<f4") for name in ("intensity", "sigma", "sigma_random", "sigma_systematic")]
    + [("step", "<i4"), ("row", "<i4"), ("laser", "u1"), ("angle", "<f8"), ("record", "<i4")]
)
"""Values of a point as files hold them: `step` is the profile, `row` the line; angle [rad from home] and record
are those of the profile."""

_LONG_NAMES = {"normal_x": "nx", "normal_y": "ny", "normal_z": "nz"}


def profiles_at_a_time(cloud: PointCloud) -> Iterator[tuple[int, int]]:
    """First profile and that after the last, of parts of the grid with about `BLOCK_POINTS` cells."""
    profiles, lines = cloud.valid.shape
    stride = max(1, BLOCK_POINTS // max(1, lines))
    for start in range(0, profiles, stride):
        yield start, min(start + stride, profiles)


def blocks(cloud: PointCloud, cells: int | None = None) -> Iterator[CloudPoints]:
    """The valid points, of `BLOCK_POINTS` or so many cells at a time; blocks without points are left out.

    A block may end within a profile: clouds of other programs have a single one.
    """
    stride = BLOCK_POINTS if cells is None else cells
    for start in range(0, cloud.valid.size, stride):
        points = cloud.points_of_cells(start, min(start + stride, cloud.valid.size))
        if len(points.xyz):
            yield points


def columns(points: CloudPoints, cloud: PointCloud) -> dict[str, np.ndarray]:
    """The values of points of a cloud, one array [n] per name: those of `POINT`, of smoothed points, of stations."""
    scalars = ("intensity", "sigma", "sigma_random", "sigma_systematic", "step", "row", "laser")
    return {
        **dict(zip(("x", "y", "z"), points.xyz.T, strict=True)),
        **dict(zip(("nx", "ny", "nz"), points.normals.T, strict=True)),
        **dict(zip(("red", "green", "blue"), points.rgb.T, strict=True)),
        **{name: getattr(points, name) for name in (*scalars, *smoothed_names(points))},
        "angle": np.asarray(cloud.angle, np.float64)[points.step],
        "record": np.asarray(cloud.record, np.int32)[points.step],
        **({} if points.station is None else {"station": points.station}),
    }


PARTS = {
    "rgb": ("red", "green", "blue", "rgb"),
    "intensity": ("intensity", "amplitude"),
    "normals": ("nx", "ny", "nz", "normal_x", "normal_y", "normal_z"),
    "sigma_random": ("sigma_random", "sigma"),
    "sigma_systematic": ("sigma_systematic", "sigma"),
    "grid": ("step", "row", "laser", "angle", "record"),
}
"""Columns that a file leaves out if its cloud lacks their field; the names are those of all formats."""


def known_names(names: Iterable[str], cloud: PointCloud) -> list[str]:
    """The columns of a format without those that a cloud lacks."""
    lacked = {part for name in cloud.lacks for part in PARTS[name]}
    return [name for name in names if name not in lacked]


def smoothed_names(cloud: PointCloud | CloudPoints) -> tuple[str, ...]:
    """Names of the fields that only a smoothed cloud has; empty for other clouds."""
    return tuple(name for name in SMOOTHED if getattr(cloud, name) is not None)


def record_of(dtype: np.dtype, cloud: PointCloud) -> np.dtype:
    """The fields of a format's record without those that the cloud lacks; smoothed points and stations have their own.

    Coordinates are doubles where the cloud's are: a single has 24 bits, half a metre in a national grid.
    """
    coordinate = "<f8" if np.dtype(cloud.xyz.dtype) == np.float64 else "<f4"
    fields = [
        (name, coordinate if name in ("x", "y", "z") else dtype[name]) for name in known_names(dtype.names or (), cloud)
    ]
    station = [] if cloud.stations is None else [("station", "u1")]
    return np.dtype(fields + [(name, "<f4") for name in smoothed_names(cloud)] + station)


def table(values: Mapping[str, np.ndarray], dtype: np.dtype) -> np.ndarray:
    """Columns as an array of records with the fields of `dtype`; a normal is "nx" or "normal_x" there."""
    records = np.empty(len(values["step"]), dtype)
    for name in dtype.names or ():
        records[name] = values[_LONG_NAMES.get(name, name)]
    return records


def check_cloud(cloud: PointCloud) -> None:
    """Check the numbers of a cloud that was read or is to be written.

    Normals may have any length: nothing computes with them, and programs that draw them scale them.
    """
    valid = np.asarray(cloud.valid)
    if cloud.stations is not None:
        check_stations(cloud.stations)
    if not valid.any():
        raise CloudError("the cloud has no valid point, so there is nothing in it.")
    for laser in (np.min(cloud.laser), np.max(cloud.laser)):
        if not 0 <= laser <= 255:
            raise CloudError(f"found laser {laser}, expected 0 to 255.")
    for field, (least, most) in _RANGES.items():
        if getattr(cloud, field) is None:
            continue
        values = np.asarray(getattr(cloud, field))
        # First one pass without a copy; only if it fails, look at the valid points alone. NaN fails too.
        if _within(values, least, most) or _within(seen := values[valid], least, most):
            continue
        if not np.isfinite(seen).all():
            raise CloudError(f"{field} of a valid point is not finite.")
        if least == 0 and seen.min() < 0:
            raise CloudError(f"{field} of a valid point is negative, expected 0 or more.")
        raise CloudError(f"{field} of a valid point is {np.abs(seen).max():.3g}, expected at most {most:g}.")


def check_stations(stations: Stations) -> None:
    """Check places of stations that were read or are to be written."""
    number, pose, covariance = (np.asarray(field) for field in stations)
    if not 1 <= len(pose) <= MAX_STATIONS or number.min() < 0 or number.max() >= len(pose):
        raise CloudError(
            f"found stations {number.min()} to {number.max()} and poses of {len(pose)}, expected 0 to at most "
            f"{MAX_STATIONS - 1}, each with its pose."
        )
    turned = pose[:, :3, :3] @ pose[:, :3, :3].swapaxes(1, 2)
    rigid = np.abs(turned - np.eye(3)).max() < 1e-6 and np.abs(pose[:, 3] - [0, 0, 0, 1]).max() == 0
    if not rigid or not (np.linalg.det(pose[:, :3, :3]) > 0).all() or np.abs(pose).max() > LARGEST:
        raise CloudError("the pose of a station is no rigid motion.")
    diagonal = np.diagonal(covariance, axis1=1, axis2=2)
    if not (diagonal >= 0).all() or np.abs(covariance).max() > LARGEST:
        raise CloudError(f"the covariance of a station's pose has a variance below 0 or above {LARGEST:g}.")


def _within(values: np.ndarray, least: float, most: float) -> bool:
    return bool(values.min() >= least and values.max() <= most)


LONGEST_LINE = 1 << 16


def text_lines(file: BinaryIO, count: int) -> Iterator[str]:
    """The next lines of a file, fewer where it ends; a longer one than `LONGEST_LINE` counts as several."""
    for _ in range(count):
        line = file.readline(LONGEST_LINE)
        if not line:
            return
        yield line.decode("latin-1")


def numbers_of(lines: Iterator[str], dtype: np.dtype) -> np.ndarray:
    """Lines of numbers as records [n]; whole numbers are cut to what their fields hold."""
    names = dtype.names or ()
    values = np.loadtxt(lines, np.float64, comments=None, ndmin=2)
    if values.shape[1] != len(names):
        raise ValueError(f"found {values.shape[1]} columns, expected {len(names)}")
    table = np.empty(len(values), dtype)
    for name, column in zip(names, values.T, strict=True):
        if dtype[name].kind in "iu":
            limits = np.iinfo(dtype[name])
            column = np.clip(np.nan_to_num(column), limits.min, limits.max)
        with np.errstate(over="ignore"):
            table[name] = column
    return table
