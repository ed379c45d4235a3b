"""The way from a cloud on its grid to tables of points, as file formats hold them, and back."""

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, BinaryIO

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.clouds.header import JOINED_FORMAT, lacking, read_stations, version_of
from jaxscan.reconstruction import MAY_LACK, SMOOTHED, CloudPoints, PointCloud, Stations


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
    + [*((name, "<f4") for name in SMOOTHED), ("station", "u1")]
)
"""Values of a point as files hold them: `step` is the profile, `row` the line; angle [rad from home] and record
are those of the profile. The last ones are those of smoothed clouds and of joined ones."""

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
    """The values of points of a cloud, one array [n] per name of `POINT`, as far as the cloud has it."""
    scalars = ("intensity", "sigma", "sigma_random", "sigma_systematic", "step", "row", "laser")
    values = {
        **dict(zip(("x", "y", "z"), points.xyz.T, strict=True)),
        **dict(zip(("nx", "ny", "nz"), points.normals.T, strict=True)),
        **dict(zip(("red", "green", "blue"), points.rgb.T, strict=True)),
        **{name: getattr(points, name) for name in (*scalars, *SMOOTHED, "station")},
        "angle": np.asarray(cloud.angle, np.float64)[points.step],
        "record": np.asarray(cloud.record, np.int32)[points.step],
    }
    return {name: value for name, value in values.items() if value is not None}


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
    lacked |= {name for name in SMOOTHED if getattr(cloud, name) is None}
    lacked |= {"station"} if cloud.stations is None else set()
    return [name for name in names if name not in lacked]


def record_of(dtype: np.dtype, cloud: PointCloud) -> np.dtype:
    """The fields of a format's record without those that the cloud lacks.

    Coordinates are doubles where the cloud's are: a single has 24 bits, half a metre in a national grid.
    """
    coordinate = "<f8" if np.dtype(cloud.xyz.dtype) == np.float64 else "<f4"
    names = known_names(dtype.names or (), cloud)
    return np.dtype([(name, coordinate if name in ("x", "y", "z") else dtype[name]) for name in names])


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


# Clouds from the columns of a file: on their grid, or as a single row of points.


MAX_CELLS = 1 << 28
"""Largest accepted grid, 13 GB: 18 000 steps of two lasers on 7000 lines."""
SPARSE_CELLS = 1 << 24
"""Largest grid however few its points, 0.7 GB, where the file lists the profiles: 8000 steps on 2000 lines."""
SPARSE_CELLS_UNLISTED = 1 << 22
"""The same where it does not list them."""
CELLS_PER_POINT = 256
"""A larger grid with fewer points is not built: its points become a single profile."""

_NEEDED = set(POINT.names or ()) - {"angle", "record", "station", *SMOOTHED}
"""Columns of every file of ours; those of the first versions have no angle and no record."""
_REGAINED = ("step", "row", "laser", "sigma_random", "sigma_systematic")
"""Columns that show that a cloud is ours although another program wrote the file."""
_COLOURS, _NORMALS = ("red", "green", "blue"), ("nx", "ny", "nz")
_FIELDS = {
    "xyz": ("x", "y", "z"),
    "rgb": _COLOURS,
    "normals": _NORMALS,
    **{name: (name,) for name in ("intensity", "sigma_random", "sigma_systematic", *SMOOTHED)},
}
_PER_PROFILE = {"angle": np.float64, "record": np.int32, "laser": np.int32}
USED = set(POINT.names or ()) - {"sigma"}
"""Columns of which a cloud is made; "sigma" follows from two others."""


class Records:
    """The points of a file, a block of records at a time; they can be read several times."""

    def __init__(self, dtype: np.dtype, count: int, read: Callable[[], Iterable[np.ndarray]]) -> None:
        """Store how to read the points; nothing is read yet.

        Args:
            dtype: Fields of `POINT`, as far as there; others are not used. Colours
                are bytes: `columns.stored_cloud` makes them so.
            count: Number of points.
            read: Gives the points from the first to the last, structured arrays with fields of these names.
        """
        self.dtype, self._count, self._read = dtype, count, read
        self.names = frozenset(dtype.names or ())

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[np.ndarray]:
        """All points."""
        found = 0
        for block in self._read():
            found += len(block)
            if found > self._count:
                break
            yield block
        if found != self._count:
            raise ValueError(f"found {found} points of {self._count}")


def cloud_of(points: Records, lines: Sequence[str], *, profiles: np.ndarray | None = None) -> PointCloud:
    """The cloud of a file.

    On the grid where the file is ours and whole, or where another program has kept the numbers of steps and rows;
    else the points as a single profile. Beside the cloud only a block of points is in memory at a time.

    Args:
        points: The points with the fields of `POINT`, as far as there.
        lines: Text of the header; `header_lines` writes it.
        profiles: Structured array [profiles] with angle, record and laser, where the file lists the profiles.
    """
    version, names, stated = version_of(lines), points.names, lacking(lines)
    if not {"x", "y", "z"} <= names:
        raise CloudError("the points have no x, y and z.")
    # Another program may have kept the header but dropped columns.
    smoothed = len(names & set(SMOOTHED)) in (0, len(SMOOTHED))
    wanted = _NEEDED | ({"station"} if version == JOINED_FORMAT else set())
    wanted -= {part for field in stated if field != "grid" for part in PARTS[field]}
    if version and smoothed and names >= wanted:
        return _organised(points, lines, profiles, joined=version == JOINED_FORMAT)
    if not version and smoothed and names >= set(_REGAINED) and (grid := _regained_grid(points)):
        return on_grid(points, grid)
    # A file of this library has lost a column; in files of other programs these columns give the grid.
    cloud = _unorganised(points, ours=bool(version) or bool(names & set(SMOOTHED)), lacks=stated)
    placed = [line for line in lines if line.startswith("station")] if version == JOINED_FORMAT else []
    if not placed or "station 1" in " ".join(line[:9] for line in placed):
        return cloud
    # With one station all points were seen from it, with or without a grid.
    return dataclasses.replace(cloud, stations=read_stations(lines, np.zeros(1, np.int32)))


def _organised(points: Records, lines: Sequence[str], profiles: np.ndarray | None, *, joined: bool) -> PointCloud:
    """A cloud on the grid that its header names; its points alone where the grid is far too large for them."""
    words = next((line.split() for line in lines if line.startswith("grid ")), [])
    if len(words) != 3 or not all(word.isascii() and word.isdigit() and len(word) < 12 for word in words[1:]):
        raise CloudError('the comment "grid <profiles> <lines>" is missing or wrong.')
    grid = int(words[1]), int(words[2])
    if not 0 < grid[0] * grid[1] <= MAX_CELLS:
        raise CloudError(
            f"found a grid of {grid[0]} x {grid[1]}, none or more than the {MAX_CELLS} cells that a cloud can have; it "
            "is damaged."
        )
    checked = Records(points.dtype, len(points), lambda: (_checked(block, grid) for block in points))
    listed = profiles is not None and len(profiles) == grid[0]
    if _is_sparse(grid, len(points), listed=listed):
        return _unorganised(checked, ours=True)
    stations = read_stations(lines, np.zeros(grid[0], np.int32)) if joined else None
    # Profiles without a point have their station in this list alone.
    if stations is not None and profiles is not None and listed and "station" in (profiles.dtype.names or ()):
        stations = stations._replace(number=profiles["station"].astype(np.int32))
        joined = False
    return on_grid(checked, grid, profiles, stations=stations, stations_of_points=joined)


def _checked(block: np.ndarray, grid: tuple[int, int]) -> np.ndarray:
    """The same points, which must be on the grid, and their numbers finite."""
    step, row = block["step"], block["row"]
    if step.min() < 0 or step.max() >= grid[0] or row.min() < 0 or row.max() >= grid[1]:
        raise CloudError(f"a point lies outside the grid of {grid[0]} x {grid[1]}.")
    # "sigma" follows from the others and is not used.
    for field in block.dtype.names or ():
        if field in USED and not np.isfinite(block[field]).all():
            raise CloudError(f"{field} of a point is not finite.")
    return block


def _is_sparse(grid: tuple[int, int], points: int, *, listed: bool) -> bool:
    return grid[0] * grid[1] > max(SPARSE_CELLS if listed else SPARSE_CELLS_UNLISTED, CELLS_PER_POINT * points)


def _regained_grid(points: Records) -> tuple[int, int] | None:
    """Size of the grid by steps and rows that another program has kept; None where they are no grid any more."""
    grid = (0, 0)
    for block in points:
        if not all(np.isfinite(block[field]).all() for field in (*_REGAINED, *"xyz")):
            return None
        for field, limit in (("step", MAX_CELLS), ("row", MAX_CELLS), ("laser", 256)):
            values = block[field]
            if values.min() < 0 or values.max() >= limit or (values != np.floor(values)).any():
                return None
        grid = max(grid[0], int(block["step"].max()) + 1), max(grid[1], int(block["row"].max()) + 1)
    if grid[0] * grid[1] > MAX_CELLS or _is_sparse(grid, len(points), listed=False):
        return None
    taken = np.zeros(grid, bool)
    for block in points:
        taken[block["step"].astype(np.int64), block["row"].astype(np.int64)] = True
    return grid if np.count_nonzero(taken) == len(points) else None


def on_grid(
    points: Records,
    grid: tuple[int, int],
    profiles: np.ndarray | None = None,
    *,
    stations: Stations | None = None,
    stations_of_points: bool = False,
) -> PointCloud:
    """The cloud of points that have step and row, on a grid of so many profiles and lines.

    Args:
        profiles: As in `cloud_of`.
        stations: The stations of a joined cloud.
        stations_of_points: Whether the points say which profile is of which station, and not yet `stations`.
    """
    per_profile = _unknown_profiles(grid[0])
    if profiles is not None and per_profile.keys() <= set(profiles.dtype.names or ()):
        if len(profiles) != grid[0] or not np.isfinite(profiles["angle"]).all():
            raise CloudError(f"found {len(profiles)} profiles, expected {grid[0]} with finite angles.")
        per_profile = {name: profiles[name].astype(kind) for name, kind in _PER_PROFILE.items()}
        by_points = set()
    else:
        by_points = per_profile.keys() & points.names
    number = None if stations is None else np.array(stations.number, np.int32)

    def placed() -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        for block in points:
            step = block["step"].astype(np.int64)
            yield block, step, block["row"].astype(np.int64)
            if number is not None and stations_of_points:
                number[step] = block["station"]
            for field in tuple(by_points):
                values = block[field]
                if np.isfinite(values).all() and np.abs(values).max() < 1 << 31:
                    per_profile[field][step] = values
                else:
                    # A column with numbers that no profile can have is not used at all.
                    by_points.remove(field)
                    per_profile[field] = _unknown_profiles(grid[0])[field]

    fields = _filled(placed(), grid, points.names, _coordinates(points), np.float32)
    if np.count_nonzero(fields["valid"]) != len(points):
        raise CloudError("two points have the same step and row.")
    return PointCloud(
        absent=_lacks(points.names, ()) or None,
        stations=None if stations is None or number is None else stations._replace(number=number),
        **fields,
        **per_profile,
    )


def _unknown_profiles(count: int) -> dict[str, Any]:
    return {"angle": np.zeros(count), "record": np.arange(count, dtype=np.int32), "laser": np.zeros(count, np.int32)}


def _filled(
    placed: Iterable[tuple[Any, np.ndarray | int, np.ndarray]],
    grid: tuple[int, int],
    names: Iterable[str],
    coordinates: type,
    others: type,
) -> dict[str, Any]:
    """Fields of a cloud from blocks of points, each with its steps and rows, in columns of these names.

    What no point fills takes no memory: the system gives pages when they are written.
    """
    kinds = {"xyz": coordinates, "rgb": np.uint8}
    fields: dict[str, np.ndarray] = {
        key: np.zeros((*grid, len(columns)), kinds.get(key, others))
        for key, columns in _FIELDS.items()
        if key not in SMOOTHED or key in names
    }
    valid = np.zeros(grid, bool)
    for block, step, row in placed:
        valid[step, row] = True
        for key, field in fields.items():
            for k, column in enumerate(_FIELDS[key]):
                if column in names:
                    field[step, row, k] = block[column]
    return {"valid": valid} | {key: field if len(_FIELDS[key]) > 1 else field[..., 0] for key, field in fields.items()}


def _lacks(names: Iterable[str], also: tuple[str, ...]) -> tuple[str, ...]:
    """Names of the fields that the columns of a file lack, and others, in their order."""
    needed = {field: set(_FIELDS[field]) for field in MAY_LACK if field in _FIELDS}
    return tuple(field for field in MAY_LACK if field in also or not needed.get(field, set()) <= set(names))


def _coordinates(points: Records) -> type:
    """Type of the coordinates: a national grid needs the double that it came in."""
    return np.float32 if all(points.dtype[name].itemsize <= 4 for name in "xyz") else np.float64


def _unorganised(points: Records, *, ours: bool, lacks: tuple[str, ...] = ()) -> PointCloud:
    """The points as a single profile; fields that they lack are zero, and listed as `absent`."""
    names, kind = points.names, _coordinates(points)
    # Without the grid it is unknown which points share their noise, so each has the sigma of its own row.
    own = "sigma_row" if "sigma_row" in names else "sigma_random"
    shared = own == "sigma_random" and set(SMOOTHED) & names
    # Files of this library have all sigmas. If one is missing, another would pass for the whole uncertainty.
    lost = ours and bool(shared or not {"sigma_random", "sigma_systematic"} - set(lacks) <= names)
    # A normal that lacks a component would point elsewhere.
    used = {name: name for part in (_COLOURS, _NORMALS) if set(part) <= names for name in part}
    used |= {"x": "x", "y": "y", "z": "z", "intensity": "intensity"}
    used |= {} if lost else {"sigma_random": own, "sigma_systematic": "sigma_systematic"}
    used = {name: column for name, column in used.items() if column in names}

    def cleaned() -> Iterator[tuple[dict[str, np.ndarray], int, np.ndarray]]:
        start = 0
        for block in points:
            seen = np.all([np.isfinite(block[axis].astype(kind)) for axis in "xyz"], axis=0)
            values = {name: block[column][seen] for name, column in used.items()}
            for name in values.keys() & set(_FIELDS):
                one: np.ndarray = values[name].astype(kind)
                values[name] = np.where(np.isfinite(one), one, 0)
            if set(_NORMALS) <= values.keys():
                normals: np.ndarray = np.stack([values[name].astype(kind) for name in _NORMALS])
                lengths = np.sqrt((normals * normals).sum(0))
                usable = np.isfinite(lengths) & (lengths > 0)
                normals = np.where(usable, normals / np.where(usable, lengths, 1), 0)
                values |= dict(zip(_NORMALS, normals, strict=True))
            yield values, 0, start + np.flatnonzero(seen)
            start += len(block)

    with np.errstate(over="ignore"):
        fields = _filled(cleaned(), (1, len(points)), used, kind, kind)
    if not fields["valid"].any():
        raise CloudError("holds no finite point.")
    return PointCloud(absent=_lacks(used, ("grid",)), **fields, **_unknown_profiles(1))
