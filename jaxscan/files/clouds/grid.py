"""Clouds from the columns of a file: on their grid, or as a single row of points."""

from collections.abc import Sequence

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.clouds.about import JOINED_FORMAT, version_of
from jaxscan.files.clouds.points import POINT
from jaxscan.files.clouds.stations import read_stations
from jaxscan.reconstruction import SMOOTHED, PointCloud, Stations


MAX_CELLS = 1 << 28
"""Largest accepted grid, 13 GB: 18 000 steps of two lasers on 7000 lines."""
SPARSE_CELLS = 1 << 24
"""Largest grid however few its points, 0.7 GB, where the file lists the profiles: 8000 steps on 2000 lines."""
SPARSE_CELLS_UNLISTED = 1 << 22
"""The same where it does not list them."""
CELLS_PER_POINT = 256
"""Of a larger grid with fewer points, the points are read alone."""

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


def cloud_of(points: np.ndarray, lines: Sequence[str], name: str, *, profiles: np.ndarray | None = None) -> PointCloud:
    """The cloud of a file.

    On the grid where the file is ours and whole, or where another program has kept the numbers of steps and rows;
    else the points as a single profile.

    Args:
        points: Structured array [n] with the fields of `POINT`, of smoothed points and of stations, as far as there.
        lines: Text of the header; `about.header_lines` writes it.
        name: Name of the file, for messages.
        profiles: Structured array [profiles] with angle, record and laser, where the file lists the profiles.

    Raises:
        CloudError: If grid, profiles, poses of stations, or numbers of points cannot be.
    """
    version = version_of(lines, name)
    names = set(points.dtype.names or ())
    if not {"x", "y", "z"} <= names:
        raise CloudError(f"{name}: the points have no x, y and z.")
    # Another program may have kept the header but dropped columns.
    smoothed = len(names & set(SMOOTHED)) in (0, len(SMOOTHED))
    wanted = _NEEDED | ({"station"} if version == JOINED_FORMAT else set())
    if version and smoothed and names >= wanted:
        return _organised(points, lines, profiles, name, joined=version == JOINED_FORMAT)
    if not version and smoothed and names >= set(_REGAINED) and (grid := _regained_grid(points)):
        return on_grid(points, grid, None, name)
    # Of ours, a column is lost; of others, these columns make them ours.
    return _unorganised(points, name, ours=bool(version) or bool(names & set(SMOOTHED)))


def _organised(
    points: np.ndarray, lines: Sequence[str], profiles: np.ndarray | None, name: str, *, joined: bool
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
    step, row = points["step"], points["row"]
    if step.min() < 0 or step.max() >= grid[0] or row.min() < 0 or row.max() >= grid[1]:
        raise CloudError(f"{name}: a point lies outside the grid of {grid[0]} x {grid[1]}.")
    # "sigma" follows from the others and is not used.
    for field in points.dtype.names or ():
        if field in _NEEDED | _LATER | set(SMOOTHED) and field != "sigma" and not np.isfinite(points[field]).all():
            raise CloudError(f"{name}: {field} of a point is not finite.")
    if _is_sparse(grid, len(points), listed=profiles is not None and len(profiles) == grid[0]):
        # A few points ask for gigabytes.
        return _unorganised(points, name, ours=True)
    number = np.zeros(grid[0], np.int32)
    if joined:
        number[step] = points["station"]
        # Profiles without a point have their station in this list alone.
        if profiles is not None and len(profiles) == grid[0] and "station" in (profiles.dtype.names or ()):
            number = profiles["station"].astype(np.int32)
    return on_grid(points, grid, profiles, name, stations=read_stations(lines, number, name) if joined else None)


def _is_sparse(grid: tuple[int, int], points: int, *, listed: bool) -> bool:
    return grid[0] * grid[1] > max(SPARSE_CELLS if listed else SPARSE_CELLS_UNLISTED, CELLS_PER_POINT * points)


def _regained_grid(points: np.ndarray) -> tuple[int, int] | None:
    """Size of the grid by steps and rows that another program has kept; None where they are no grid any more."""
    for field in (*_REGAINED, *"xyz"):
        if not np.isfinite(points[field]).all():
            return None
    limits = {"step": MAX_CELLS, "row": MAX_CELLS, "laser": 256}
    for field, limit in limits.items():
        values = points[field]
        if values.min() < 0 or values.max() >= limit or (values != np.floor(values)).any():
            return None
    step, row = points["step"].astype(np.int64), points["row"].astype(np.int64)
    grid = int(step.max()) + 1, int(row.max()) + 1
    if grid[0] * grid[1] > MAX_CELLS or _is_sparse(grid, len(points), listed=False):
        return None
    return grid if len(np.unique(step * grid[1] + row)) == len(points) else None


def on_grid(
    points: np.ndarray,
    grid: tuple[int, int],
    profiles: np.ndarray | None,
    name: str,
    *,
    stations: Stations | None = None,
) -> PointCloud:
    """The cloud of points that have step and row, on a grid of so many profiles and lines.

    Raises:
        CloudError: If two points have the same cell, or the list of profiles is another one's.
    """
    names = set(points.dtype.names or ())
    step, row = points["step"].astype(np.int64), points["row"].astype(np.int64)
    valid = np.zeros(grid, bool)
    valid[step, row] = True
    if np.count_nonzero(valid) != len(points):
        raise CloudError(f"{name}: two points have the same step and row.")

    def spread(dtype: type, columns: Sequence[str]) -> np.ndarray:
        field: np.ndarray = np.zeros((*grid, len(columns)), dtype)
        for k, column in enumerate(columns):
            if column in names:
                field[step, row, k] = points[column]
        return field if len(columns) > 1 else field[..., 0]

    rgb: np.ndarray = np.zeros((*grid, 3), np.uint8)
    rgb[step, row] = _colours(points)
    fields = {key: spread(*one) for key, one in _FIELDS.items() if key not in SMOOTHED or key in names}
    return PointCloud(
        xyz=spread(_coordinates(points), "xyz"),
        rgb=rgb,
        valid=valid,
        stations=stations,
        **fields,
        **_profiles(points, grid[0], profiles, name),
    )


def _profiles(points: np.ndarray, count: int, profiles: np.ndarray | None, name: str) -> dict[str, np.ndarray]:
    """Angle, record and laser of every profile: as listed, or as their points have them."""
    if profiles is not None and {"angle", "record", "laser"} <= set(profiles.dtype.names or ()):
        if len(profiles) != count or not np.isfinite(profiles["angle"]).all():
            raise CloudError(f"{name}: found {len(profiles)} profiles, expected {count} with finite angles.")
        return {
            "angle": profiles["angle"].astype(np.float64),
            "record": profiles["record"].astype(np.int32),
            "laser": profiles["laser"].astype(np.int32),
        }
    found: dict[str, np.ndarray] = {
        "angle": np.zeros(count),
        "record": np.arange(count, dtype=np.int32),
        "laser": np.zeros(count, np.int32),
    }
    step = points["step"].astype(np.int64)
    for field in found.keys() & set(points.dtype.names or ()):
        values = points[field]
        if np.isfinite(values).all() and np.abs(values).max() < 1 << 31:
            found[field][step] = values
    return found


def _coordinates(points: np.ndarray) -> type:
    """Type of the coordinates: a national grid needs the double that it came in."""
    return np.float32 if all(points.dtype[name].itemsize <= 4 for name in "xyz") else np.float64


def _unorganised(points: np.ndarray, name: str, *, ours: bool) -> PointCloud:
    """The points as a single profile; values that they lack are zero.

    Raises:
        CloudError: If no point is finite.
    """
    names = set(points.dtype.names or ())
    dtype = _coordinates(points)

    def column(field: str) -> np.ndarray:
        if field not in names:
            return np.zeros(len(points), dtype)
        # Values out of range become infinite, and are dropped below.
        with np.errstate(over="ignore"):
            return points[field].astype(dtype)

    xyz = np.stack([column(axis) for axis in "xyz"], -1)
    valid = np.isfinite(xyz).all(-1)
    if not valid.any():
        raise CloudError(f"{name}: holds no finite point.")
    normals = np.stack([column(axis) for axis in ("nx", "ny", "nz")], -1)
    # A part of a normal is another direction.
    whole = {"nx", "ny", "nz"} <= names
    with np.errstate(over="ignore"):
        lengths = np.sqrt((normals * normals).sum(-1, keepdims=True))
    usable = valid[:, None] & np.isfinite(lengths) & (lengths > 0) & whole
    # Without the grid nobody knows which points share their noise: each claims the sigma of its own row.
    own = "sigma_row" if "sigma_row" in names else "sigma_random"
    scalars = [column(field) for field in ("intensity", own, "sigma_systematic")]
    intensity, sigma_random, sigma_systematic = (np.where(valid & np.isfinite(one), one, 0) for one in scalars)
    shared = own == "sigma_random" and set(SMOOTHED) & names
    if ours and (shared or not {"sigma_random", "sigma_systematic"} <= names):
        # Ours have all. With one lost another would be taken for all of the uncertainty.
        sigma_random, sigma_systematic = np.zeros_like(sigma_random), np.zeros_like(sigma_systematic)
    return PointCloud(
        xyz=np.where(valid[:, None], xyz, 0)[None],
        rgb=np.where(valid[:, None], _colours(points), 0).astype(np.uint8)[None],
        intensity=intensity[None],
        normals=np.where(usable, normals / np.where(usable, lengths, 1), 0)[None],
        sigma_random=sigma_random[None],
        sigma_systematic=sigma_systematic[None],
        valid=valid[None],
        record=np.zeros(1, np.int32),
        laser=np.zeros(1, np.int32),
        angle=np.zeros(1),
    )


def _colours(points: np.ndarray) -> np.ndarray:
    if not {"red", "green", "blue"} <= set(points.dtype.names or ()):
        return np.zeros((len(points), 3), np.uint8)
    colours = np.stack([points[name] for name in ("red", "green", "blue")], -1)
    if colours.dtype == np.uint8:
        return colours
    if colours.dtype.kind == "f":
        return (np.clip(np.nan_to_num(colours), 0, 1) * 255 + 0.5).astype(np.uint8)
    return (colours >> 8 if colours.dtype.itemsize == 2 else np.clip(colours, 0, 255)).astype(np.uint8)
