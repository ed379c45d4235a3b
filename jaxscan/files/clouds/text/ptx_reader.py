"""Reading PTX: every block is a station with its grid."""

import os
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.clouds import points as sizes
from jaxscan.files.clouds.about import About, StoredCloud
from jaxscan.files.clouds.grid import MAX_CELLS, Records, cloud_of, on_grid
from jaxscan.files.clouds.points import MAX_STATIONS
from jaxscan.files.clouds.tables import LONGEST_LINE, numbers_of, text_lines
from jaxscan.files.disk import open_regular
from jaxscan.reconstruction import PointCloud, Stations


_COLUMNS = ("x", "y", "z", "intensity", "red", "green", "blue")
_POINT = np.dtype(
    [(axis, "f8") for axis in "xyz"]
    + [("intensity", "f4")]
    + [(name, "u1") for name in ("red", "green", "blue")]
    + [(name, "i4") for name in ("step", "row", "laser")],
)
_POINT_IN_SINGLES = np.dtype([(name, "f4" if name in "xyz" else _POINT[name]) for name in _POINT.names or ()])
_SINGLE_M = 128.0
"""Coordinates up to which a single is good to 8 um."""
_SHORTEST_CELL = 8
"""Bytes of a cell: four numbers."""


class _Block(NamedTuple):
    columns: int
    rows: int
    pose: np.ndarray
    """T_file_block [4, 4]."""
    parts: list[np.ndarray]
    """The points that were seen, structured arrays in the frame of the file; `step` counts columns of the block."""


def read_ptx(path: Path) -> StoredCloud:
    """A cloud on its grid, in the frame of the file; blocks with one pose are one station.

    The lowest cell of a column becomes the last line, and its intensity of 0 to 1 an amplitude of 0 to 255.

    Raises:
        CloudError: If it is damaged or has no points.
    """
    blocks: list[_Block] = []
    with open_regular(path, error=CloudError) as file:
        size, cells = os.fstat(file.fileno()).st_size, 0
        try:
            while line := file.readline(LONGEST_LINE):
                if not line.strip():
                    continue
                block = _read_block(file, line, min(size - file.tell(), _SHORTEST_CELL * (MAX_CELLS - cells)))
                blocks.append(block)
                cells += block.columns * block.rows
        except ValueError as problem:
            raise CloudError(f"{path}: block {len(blocks)}: not a PTX file: {str(problem)[:90]}.") from problem
    if not any(block.parts for block in blocks):
        raise CloudError(f"{path}: holds no points.")
    return StoredCloud(_joined(blocks, str(path)), About(in_metres=True, upright=True))


def _read_block(file: BinaryIO, first: bytes, rest: int) -> _Block:
    counts = [text.split() for text in (first.decode("latin-1"), *text_lines(file, 1))]
    if len(counts) < 2 or any(len(one) != 1 or not one[0].isascii() or not one[0].isdigit() for one in counts):
        raise ValueError("expected the numbers of columns and of rows, a line each")
    columns, rows = (int(one[0][:12]) for one in counts)
    head = [text.split() for text in text_lines(file, 8)]
    if [len(words) for words in head] != [3] * 4 + [4] * 4:
        raise ValueError("expected 4 lines of 3 numbers and 4 of 4 for the pose")
    if columns * rows == 0 or columns * rows * _SHORTEST_CELL > rest + 1:
        raise ValueError(f"announces {columns} x {rows} points, but the file ends before, or holds too many")
    pose = np.array([[float(word) for word in words] for words in head[4:]]).T
    if not np.isfinite(pose).all():
        raise ValueError("the pose holds a number that is not finite")
    start = file.tell()
    width = len(next(text_lines(file, 1), "").split())
    if width not in (4, 7):
        raise ValueError(f"found {width} numbers in a line, expected 4 or 7")
    file.seek(start)
    types = [(name, "f8" if name in "xyz" else "f4") for name in _COLUMNS[:width]]
    kind, parts = np.dtype(types), []
    for begin in range(0, columns * rows, sizes.BLOCK_POINTS):
        count = min(sizes.BLOCK_POINTS, columns * rows - begin)
        cells = numbers_of(text_lines(file, count), kind)
        if len(cells) != count:
            raise ValueError(f"found {begin + len(cells)} points, expected {columns} x {rows}")
        seen = np.flatnonzero(np.any([cells[axis] != 0 for axis in "xyz"], axis=0))
        if len(seen):
            parts.append(_points_of(cells[seen], begin + seen, rows, pose))
    return _Block(columns, rows, pose, parts)


def _joined(blocks: list[_Block], name: str) -> PointCloud:
    poses: list[np.ndarray] = []
    parts: list[np.ndarray] = []
    numbers: list[int] = []
    start = 0
    for block in blocks:
        known = [np.array_equal(block.pose, pose) for pose in poses]
        station = known.index(True) if any(known) else len(poses)
        # Of one place, blocks are those of several lasers.
        laser = sum(number == station for number in numbers)
        poses += [] if any(known) else [block.pose]
        numbers.append(station)
        for part in block.parts:
            part["step"] += start
            part["laser"] = laser
        parts += block.parts
        start += block.columns
    single = max(np.abs(part[axis]).max() for part in parts for axis in "xyz") <= _SINGLE_M
    kind = _POINT_IN_SINGLES if single else _POINT
    points = Records(kind, sum(map(len, parts)), lambda: (part.astype(kind) for part in parts))
    lines = {block.rows for block in blocks}
    if len(lines) > 1 or len(poses) > MAX_STATIONS or max(part["laser"].max() for part in parts) > 255:
        return cloud_of(points, [], name)
    stations = None
    if not (len(poses) == 1 and np.array_equal(poses[0], np.eye(4))):
        number = np.repeat(np.array(numbers, np.int32), [block.columns for block in blocks])
        stations = Stations(number, np.array(poses), np.zeros((len(poses), 6, 6)))
    return on_grid(points, (start, lines.pop()), None, name, stations=stations)


def _points_of(cells: np.ndarray, numbers: np.ndarray, rows: int, pose: np.ndarray) -> np.ndarray:
    """Cells of a block with a point, by their numbers in the block, as points in the frame of the file."""
    points = np.zeros(len(cells), _POINT)
    local = np.stack([cells[axis] for axis in "xyz"], -1)
    moved = local @ pose[:3, :3].T + pose[:3, 3]
    for axis, values in zip("xyz", moved.T, strict=True):
        points[axis] = values
    points["intensity"] = np.nan_to_num(cells["intensity"]) * 255
    for name in ("red", "green", "blue"):
        if name in (cells.dtype.names or ()):
            points[name] = np.clip(np.nan_to_num(cells[name]), 0, 255)
    points["step"] = numbers // rows
    points["row"] = rows - 1 - numbers % rows
    return points
