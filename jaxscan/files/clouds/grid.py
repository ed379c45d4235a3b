"""Clouds from the columns of a file: on their grid, or as a single row of points."""

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.clouds.header import JOINED_FORMAT, lacking, read_stations, version_of
from jaxscan.files.clouds.points import PARTS, POINT
from jaxscan.reconstruction import MAY_LACK, SMOOTHED, PointCloud, Stations


MAX_CELLS = 1 << 28
"""Largest accepted grid, 13 GB: 18 000 steps of two lasers on 7000 lines."""
SPARSE_CELLS = 1 << 24
"""Largest grid however few its points, 0.7 GB, where the file lists the profiles: 8000 steps on 2000 lines."""
SPARSE_CELLS_UNLISTED = 1 << 22
"""The same where it does not list them."""
CELLS_PER_POINT = 256
"""A larger grid with fewer points is not built: its points become a single profile."""

_LATER = {"angle", "record"}
"""Columns that files of the first versions do not have."""
_NEEDED = set(POINT.names or ()) - _LATER
_REGAINED = ("step", "row", "laser", "sigma_random", "sigma_systematic")
"""Columns by which a cloud of ours is known that another program has written."""
_COLOURS, _NORMALS = ("red", "green", "blue"), ("nx", "ny", "nz")
_FIELDS = {
    "xyz": ("x", "y", "z"),
    "rgb": _COLOURS,
    "normals": _NORMALS,
    **{name: (name,) for name in ("intensity", "sigma_random", "sigma_systematic", *SMOOTHED)},
}
_PER_PROFILE = {"angle": np.float64, "record": np.int32, "laser": np.int32}
USED = {*(POINT.names or ()), *SMOOTHED, "station"} - {"sigma"}
"""Columns of which a cloud is made; "sigma" follows from two others."""


class Records:
    """The points of a file, a block of records at a time, as often as they are asked for."""

    def __init__(self, dtype: np.dtype, count: int, read: Callable[[], Iterable[np.ndarray]]) -> None:
        """Store how to read the points; nothing is read yet.

        Args:
            dtype: Fields of `POINT`, of smoothed points and of stations, as far as there; others are not used. Colours
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
        points: With the fields of `POINT`, of smoothed points and of stations, as far as there.
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
    # Of one station, all points are from there, grid or not.
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
        if field in _NEEDED | _LATER | set(SMOOTHED) and field != "sigma" and not np.isfinite(block[field]).all():
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
        stations: Of a joined cloud.
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
