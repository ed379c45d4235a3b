"""Clouds from the columns of a file: on their grid, or as a single row of points."""

import dataclasses
from collections.abc import Callable, Iterator, Sequence

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
_FIELDS = {
    "intensity": (np.float32, ("intensity",)),
    "normals": (np.float32, ("nx", "ny", "nz")),
    "sigma_random": (np.float32, ("sigma_random",)),
    "sigma_systematic": (np.float32, ("sigma_systematic",)),
    **{name: (np.float32, (name,)) for name in SMOOTHED},
}


USED = {*(POINT.names or ()), *SMOOTHED, "station"} - {"sigma"}
"""Columns of which a cloud is made; "sigma" follows from two others."""


class Records:
    """The points of a file, a block of records at a time, as often as they are asked for."""

    def __init__(self, dtype: np.dtype, count: int, read: Callable[[], Iterator[np.ndarray]]) -> None:
        """Store how to read the points; nothing is read yet.

        Args:
            dtype: Fields of `POINT`, of smoothed points and of stations, as far as there; others are not used. Colours
                are bytes: `columns.decide` makes them so.
            count: Number of points.
            read: Gives the points from the first to the last, structured arrays with fields of these names.
        """
        self.dtype, self._count, self._read = dtype, count, read
        self.names = frozenset(dtype.names or ())

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[np.ndarray]:
        """All points.

        Raises:
            ValueError: If the file has another number of them than it had before.
        """
        found = 0
        for block in self._read():
            found += len(block)
            if found > self._count:
                break
            yield block
        if found != self._count:
            raise ValueError(f"found {found} points of {self._count}")


def cloud_of(points: Records, lines: Sequence[str], name: str, *, profiles: np.ndarray | None = None) -> PointCloud:
    """The cloud of a file.

    On the grid where the file is ours and whole, or where another program has kept the numbers of steps and rows;
    else the points as a single profile. Beside the cloud only a block of points is in memory at a time.

    Args:
        points: With the fields of `POINT`, of smoothed points and of stations, as far as there.
        lines: Text of the header; `about.header_lines` writes it.
        profiles: Structured array [profiles] with angle, record and laser, where the file lists the profiles.

    Raises:
        CloudError: If grid, profiles, poses of stations, or numbers of points cannot be.
        ValueError: If the file changes while it is read.
    """
    version = version_of(lines, name)
    names = points.names
    if not {"x", "y", "z"} <= names:
        raise CloudError(f"{name}: the points have no x, y and z.")
    # Another program may have kept the header but dropped columns.
    smoothed = len(names & set(SMOOTHED)) in (0, len(SMOOTHED))
    stated = lacking(lines)
    wanted = _NEEDED | ({"station"} if version == JOINED_FORMAT else set())
    wanted -= {part for field in stated if field != "grid" for part in PARTS[field]}
    if version and smoothed and names >= wanted:
        return _organised(points, lines, profiles, name, joined=version == JOINED_FORMAT)
    if not version and smoothed and names >= set(_REGAINED) and (grid := _regained_grid(points)):
        return on_grid(points, grid, None, name)
    # Of ours, a column is lost; of others, these columns make them ours.
    ours = bool(version) or bool(names & set(SMOOTHED))
    cloud = _unorganised(points, name, ours=ours, lacks=stated)
    placed = [line for line in lines if line.startswith("station")] if version == JOINED_FORMAT else []
    if not placed or "station 1" in " ".join(line[:9] for line in placed):
        return cloud
    # Of one station, all points are from there, grid or not.
    return dataclasses.replace(cloud, stations=read_stations(lines, np.zeros(1, np.int32), name))


def _organised(
    points: Records, lines: Sequence[str], profiles: np.ndarray | None, name: str, *, joined: bool
) -> PointCloud:
    """A cloud on the grid that its header names; its points alone where the grid is far too large for them."""
    words = next((line.split() for line in lines if line.startswith("grid ")), [])
    if len(words) != 3 or not all(word.isascii() and word.isdigit() and len(word) < 12 for word in words[1:]):
        raise CloudError(f'{name}: the comment "grid <profiles> <lines>" is missing or wrong.')
    grid = int(words[1]), int(words[2])
    if not 0 < grid[0] * grid[1] <= MAX_CELLS:
        raise CloudError(
            f"{name}: found a grid of {grid[0]} x {grid[1]}, none or more than the {MAX_CELLS} cells that a cloud can "
            "have; it is damaged."
        )
    if _is_sparse(grid, len(points), listed=profiles is not None and len(profiles) == grid[0]):
        # A few points ask for gigabytes.
        for block in points:
            _check_block(block, grid, name)
        return _unorganised(points, name, ours=True)
    stations = None
    if joined:
        # The points fill the numbers in.
        stations = read_stations(lines, np.zeros(grid[0], np.int32), name)
        # Profiles without a point have their station in this list alone.
        if profiles is not None and len(profiles) == grid[0] and "station" in (profiles.dtype.names or ()):
            stations = stations._replace(number=profiles["station"].astype(np.int32))
            joined = False
    return on_grid(
        points,
        grid,
        profiles,
        name,
        stations=stations,
        check=lambda block: _check_block(block, grid, name),
        stations_of_points=joined,
    )


def _check_block(block: np.ndarray, grid: tuple[int, int], name: str) -> None:
    """Check that points are on the grid, and their numbers finite."""
    step, row = block["step"], block["row"]
    if step.min() < 0 or step.max() >= grid[0] or row.min() < 0 or row.max() >= grid[1]:
        raise CloudError(f"{name}: a point lies outside the grid of {grid[0]} x {grid[1]}.")
    # "sigma" follows from the others and is not used.
    for field in block.dtype.names or ():
        if field in _NEEDED | _LATER | set(SMOOTHED) and field != "sigma" and not np.isfinite(block[field]).all():
            raise CloudError(f"{name}: {field} of a point is not finite.")


def _is_sparse(grid: tuple[int, int], points: int, *, listed: bool) -> bool:
    return grid[0] * grid[1] > max(SPARSE_CELLS if listed else SPARSE_CELLS_UNLISTED, CELLS_PER_POINT * points)


def _regained_grid(points: Records) -> tuple[int, int] | None:
    """Size of the grid by steps and rows that another program has kept; None where they are no grid any more."""
    limits = {"step": MAX_CELLS, "row": MAX_CELLS, "laser": 256}
    grid = (0, 0)
    for block in points:
        if not all(np.isfinite(block[field]).all() for field in (*_REGAINED, *"xyz")):
            return None
        for field, limit in limits.items():
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
    profiles: np.ndarray | None,
    name: str,
    *,
    stations: Stations | None = None,
    stations_of_points: bool = False,
    check: Callable[[np.ndarray], None] = lambda block: None,
) -> PointCloud:
    """The cloud of points that have step and row, on a grid of so many profiles and lines.

    Args:
        grid: Profiles and lines.
        profiles: As in `cloud_of`.
        stations: Of a joined cloud.
        stations_of_points: Whether the points say which profile is of which station, and not yet `stations`.
        check: Looks at each block of points before it is used.

    Raises:
        CloudError: If two points have the same cell, or the list of profiles is another one's.
    """
    per_profile = _Profiles(points.names, grid[0], profiles, name)
    number = None if stations is None else np.array(stations.number, np.int32)
    valid = np.zeros(grid, bool)
    # What no point fills takes no memory: the system gives pages when they are written.
    fields: dict[str, np.ndarray] = {"xyz": np.zeros((*grid, 3), _coordinates(points))}
    fields["rgb"] = np.zeros((*grid, 3), np.uint8)
    for key, (dtype, columns) in _FIELDS.items():
        if key not in SMOOTHED or key in points.names:
            fields[key] = np.zeros((*grid, len(columns)) if len(columns) > 1 else grid, dtype)
    spread = {key: columns for key, (_, columns) in _FIELDS.items() if key in fields} | {"xyz": ("x", "y", "z")}
    for block in points:
        check(block)
        step, row = block["step"].astype(np.int64), block["row"].astype(np.int64)
        valid[step, row] = True
        for key, columns in spread.items():
            field = fields[key] if len(columns) > 1 else fields[key][..., None]
            for k, column in enumerate(columns):
                if column in points.names:
                    field[step, row, k] = block[column]
        if _COLOURS <= points.names:
            fields["rgb"][step, row] = _colours(block)
        if number is not None and stations_of_points:
            number[step] = block["station"]
        per_profile.see(block, step)
    if np.count_nonzero(valid) != len(points):
        raise CloudError(f"{name}: two points have the same step and row.")
    return PointCloud(
        valid=valid,
        absent=_lacks(points.names) or None,
        stations=None if stations is None or number is None else stations._replace(number=number),
        **fields,
        **per_profile.found(),
    )


def _lacks(names: frozenset[str]) -> tuple[str, ...]:
    """Names of the fields that the columns of a file lack, for points on their grid."""
    needed = {field: set(PARTS[field][: 3 if field in ("rgb", "normals") else 1]) for field in MAY_LACK}
    return tuple(field for field in MAY_LACK if field != "grid" and not needed[field] <= names)


class _Profiles:
    """Angle, record and laser of every profile: as listed, or as their points have them."""

    def __init__(self, names: frozenset[str], count: int, profiles: np.ndarray | None, name: str) -> None:
        listed = profiles is not None and {"angle", "record", "laser"} <= set(profiles.dtype.names or ())
        self._listed = profiles if listed else None
        self._found, self._count, self._name = self._unknown(count), count, name
        self._by_points = set() if listed else self._found.keys() & names

    @staticmethod
    def _unknown(count: int) -> dict[str, np.ndarray]:
        return {
            "angle": np.zeros(count),
            "record": np.arange(count, dtype=np.int32),
            "laser": np.zeros(count, np.int32),
        }

    def see(self, block: np.ndarray, step: np.ndarray) -> None:
        """Look at some points; a column with numbers that no profile can have is not used at all."""
        for field in tuple(self._by_points):
            values = block[field]
            if np.isfinite(values).all() and np.abs(values).max() < 1 << 31:
                self._found[field][step] = values
            else:
                self._by_points.remove(field)
                self._found[field] = self._unknown(self._count)[field]

    def found(self) -> dict[str, np.ndarray]:
        """What is known when all points were seen.

        Raises:
            CloudError: If the list is that of another cloud.
        """
        if self._listed is None:
            return self._found
        if len(self._listed) != self._count or not np.isfinite(self._listed["angle"]).all():
            raise CloudError(
                f"{self._name}: found {len(self._listed)} profiles, expected {self._count} with finite angles."
            )
        return {name: self._listed[name].astype(field.dtype) for name, field in self._found.items()}


def _coordinates(points: Records) -> type:
    """Type of the coordinates: a national grid needs the double that it came in."""
    return np.float32 if all(points.dtype[name].itemsize <= 4 for name in "xyz") else np.float64


_COLOURS = {"red", "green", "blue"}


def _unorganised(points: Records, name: str, *, ours: bool, lacks: tuple[str, ...] = ()) -> PointCloud:
    """The points as a single profile; fields that they lack are zero, and listed as `absent`.

    Args:
        ours: Whether this library wrote the file or the one before it.
        lacks: Fields that its header lists as lacking.

    Raises:
        CloudError: If no point is finite.
    """
    names, count = points.names, len(points)
    dtype = _coordinates(points)
    # A part of a normal is another direction.
    normals_whole = {"nx", "ny", "nz"} <= names
    # Without the grid nobody knows which points share their noise: each claims the sigma of its own row.
    own = "sigma_row" if "sigma_row" in names else "sigma_random"
    shared = own == "sigma_random" and set(SMOOTHED) & names
    # Ours have all. With one lost another would be taken for all of the uncertainty.
    sigmas = {"sigma_random", "sigma_systematic"} - set(lacks)
    lost = ours and bool(shared or not sigmas <= names)
    scalars = {"intensity": "intensity"} | (
        {} if lost else {"sigma_random": own, "sigma_systematic": "sigma_systematic"}
    )
    # What no point fills takes no memory: the system gives pages when they are written.
    xyz: np.ndarray = np.zeros((1, count, 3), dtype)
    normals: np.ndarray = np.zeros((1, count, 3), dtype)
    rgb = np.zeros((1, count, 3), np.uint8)
    fields: dict[str, np.ndarray] = {
        field: np.zeros((1, count), dtype) for field in ("intensity", "sigma_random", "sigma_systematic")
    }
    valid = np.zeros((1, count), bool)
    start = 0
    for block in points:
        part = slice(start, start + len(block))
        start += len(block)
        # Values out of range become infinite, and are dropped.
        with np.errstate(over="ignore"):
            places: np.ndarray = np.stack([block[axis].astype(dtype) for axis in "xyz"], -1)
            seen = np.isfinite(places).all(-1)
            valid[0, part] = seen
            xyz[0, part] = np.where(seen[:, None], places, 0)
            if _COLOURS <= names:
                rgb[0, part] = np.where(seen[:, None], _colours(block), 0)
            if normals_whole:
                given: np.ndarray = np.stack([block[axis].astype(dtype) for axis in ("nx", "ny", "nz")], -1)
                lengths = np.sqrt((given * given).sum(-1, keepdims=True))
                usable = seen[:, None] & np.isfinite(lengths) & (lengths > 0)
                normals[0, part] = np.where(usable, given / np.where(usable, lengths, 1), 0)
            for field, column in scalars.items():
                if column in names:
                    values: np.ndarray = block[column].astype(dtype)
                    fields[field][0, part] = np.where(seen & np.isfinite(values), values, 0)
    if not valid.any():
        raise CloudError(f"{name}: holds no finite point.")
    return PointCloud(
        xyz=xyz,
        rgb=rgb,
        normals=normals,
        valid=valid,
        record=np.zeros(1, np.int32),
        laser=np.zeros(1, np.int32),
        angle=np.zeros(1),
        intensity=fields["intensity"],
        sigma_random=fields["sigma_random"],
        sigma_systematic=fields["sigma_systematic"],
        absent=tuple(
            field
            for field in MAY_LACK
            if field == "grid"
            or (field == "rgb" and not _COLOURS <= names)
            or (field == "normals" and not normals_whole)
            or (field in fields and scalars.get(field) not in names)
        ),
    )


def _colours(points: np.ndarray) -> np.ndarray:
    return np.stack([points[name] for name in ("red", "green", "blue")], -1)
