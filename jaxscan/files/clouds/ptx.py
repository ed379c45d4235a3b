"""PTX: text that keeps the grid, with the pose of every station."""

import os
from typing import BinaryIO, NamedTuple

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.clouds import points as sizes
from jaxscan.files.clouds.columns import COLOURS, Reach, Reading, as_bytes, range_of
from jaxscan.files.clouds.header import METRE, About, StoredCloud
from jaxscan.files.clouds.points import (
    LONGEST_LINE,
    MAX_CELLS,
    MAX_STATIONS,
    Records,
    cloud_of,
    numbers_of,
    on_grid,
    text_lines,
)
from jaxscan.files.disk import Part
from jaxscan.reconstruction import PointCloud, Stations, of_station


_COLUMNS = ("x", "y", "z", "intensity", "red", "green", "blue")
_POINT = np.dtype(
    [(axis, "f8") for axis in "xyz"]
    + [("intensity", "f4")]
    + [(name, "u1") for name in COLOURS]
    + [(name, "i4") for name in ("step", "row", "laser")],
)
_SINGLE_M = 128.0
"""Coordinates up to which a single is good to 8 um."""
_ROUNDED, _EXACT = 1e-3, 1e-9
"""How far the axes of a pose may differ from unit length: if written with few digits, and if with all."""
_NO_INTENSITY = 127.5
_SHORTEST_CELL = 8
"""Bytes of a cell: four numbers."""


class _Block(NamedTuple):
    columns: int
    rows: int
    pose: np.ndarray
    """T_file_block [4, 4]."""
    parts: list[np.ndarray]
    """The points that were seen, structured arrays in the frame of the file; `step` counts columns of the block."""
    reach: Reach | None
    """The range of its colours; None where it has none."""


def read_ptx(file: BinaryIO, reading: Reading) -> StoredCloud:
    """A cloud on its grid, in the frame of the file; blocks with one pose are one station.

    The lowest cell of a column becomes the last line, and its intensity of 0 to 1 an amplitude of 0 to 255.
    """
    usual = 255.0 if reading.brightest is None else reading.brightest
    blocks = _read_blocks(file, usual)
    reaches = [block.reach for block in blocks if block.reach is not None]
    reach = Reach(max((one.most for one in reaches), default=0.0), all(one.whole for one in reaches))
    # The text may also hold floats and 16-bit numbers, though scanners do not write them.
    found = range_of(np.dtype("f8"), reach, reading)
    if found.brightest != usual and not (reach.whole and reach.most <= 1):
        file.seek(0)
        blocks = _read_blocks(file, found.brightest)
    if not any(block.parts for block in blocks):
        raise CloudError("holds no points.")
    # Scanners that do not measure intensity write 0.5.
    bright = any((part["intensity"] != _NO_INTENSITY).any() for block in blocks for part in block.parts)
    left = (() if bright else ("intensity",)) + (() if reaches and found.brightest else COLOURS)
    columns = f"{', '.join(name for name in _COLUMNS if name not in left)} by the format"
    words = (columns, found.words) if reaches else (columns,)
    return StoredCloud(_joined(blocks, left), About(metres=METRE, unit_by="the format", upright=True), words)


def _read_blocks(file: BinaryIO, brightest: float) -> list[_Block]:
    size, cells = os.fstat(file.fileno()).st_size, 0
    blocks: list[_Block] = []
    while line := file.readline(LONGEST_LINE):
        if line.strip():
            rest = min(size - file.tell(), _SHORTEST_CELL * (MAX_CELLS - cells))
            try:
                blocks.append(_read_block(file, line, rest, brightest))
            except ValueError as problem:
                raise ValueError(f"block {len(blocks)}: {problem}") from problem
            cells += blocks[-1].columns * blocks[-1].rows
    return blocks


def _read_block(file: BinaryIO, first: bytes, rest: int, brightest: float) -> _Block:
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
    pose = _rigid(pose)
    start = file.tell()
    width = len(next(text_lines(file, 1), "").split())
    if width not in (4, 7):
        raise ValueError(f"found {width} numbers in a line, expected 4 or 7")
    file.seek(start)
    types = [(name, "f8" if name in "xyz" else "f4") for name in _COLUMNS[:width]]
    kind, parts, reach = np.dtype(types), [], None
    for begin in range(0, columns * rows, sizes.BLOCK_POINTS):
        count = min(sizes.BLOCK_POINTS, columns * rows - begin)
        cells = numbers_of(text_lines(file, count), kind)
        if len(cells) != count:
            raise ValueError(f"found {begin + len(cells)} points, expected {columns} x {rows}")
        seen = np.flatnonzero(np.any([cells[axis] != 0 for axis in "xyz"], axis=0))
        if len(seen):
            if width == 7:
                reach = (reach or Reach()).with_more(np.stack([cells[name][seen] for name in COLOURS]))
            parts.append(_points_of(cells[seen], begin + seen, rows, pose, brightest))
    return _Block(columns, rows, pose, parts, reach)


def _rigid(pose: np.ndarray) -> np.ndarray:
    """A pose [4, 4] that is written with few digits, with a rotation that is one."""
    u, scales, v = np.linalg.svd(pose[:3, :3])
    if np.abs(scales - 1.0).max() > _ROUNDED or np.linalg.det(u @ v) < 0 or np.abs(pose[3] - [0, 0, 0, 1]).max() > 0:
        scales = scales if np.linalg.det(pose[:3, :3]) >= 0 else -scales
        found = ", ".join(f"{scale:.4g}" for scale in scales)
        raise ValueError(f"the pose is no rigid motion: its axes are scaled by {found}, expected 1, 1, 1")
    # A rotation of double precision stays as it is, to the bit.
    exact = np.abs(scales - 1.0).max() < _EXACT
    return pose if exact else np.block([[u @ v, pose[:3, 3:]], [np.eye(4)[3:]]])


def _joined(blocks: list[_Block], left: tuple[str, ...]) -> PointCloud:
    poses: list[np.ndarray] = []
    parts: list[np.ndarray] = []
    numbers: list[int] = []
    start = 0
    for block in blocks:
        known = [np.array_equal(block.pose, pose) for pose in poses]
        station = known.index(True) if any(known) else len(poses)
        # Blocks with the same pose are those of several lasers.
        laser = sum(number == station for number in numbers)
        poses += [] if any(known) else [block.pose]
        numbers.append(station)
        for part in block.parts:
            part["step"] += start
            part["laser"] = laser
        parts += block.parts
        start += block.columns
    single = max(np.abs(part[axis]).max() for part in parts for axis in "xyz") <= _SINGLE_M
    names = [name for name in _POINT.names or () if name not in left]
    kind = np.dtype([(name, "f4" if single and name in "xyz" else _POINT[name]) for name in names])
    points = Records(kind, sum(map(len, parts)), lambda: (part[names].astype(kind) for part in parts))
    lines = {block.rows for block in blocks}
    if len(lines) > 1 or len(poses) > MAX_STATIONS or max(part["laser"].max() for part in parts) > 255:
        return cloud_of(points, [])
    stations = None
    if not (len(poses) == 1 and np.array_equal(poses[0], np.eye(4))):
        number = np.repeat(np.array(numbers, np.int32), [block.columns for block in blocks])
        stations = Stations(number, np.array(poses), np.zeros((len(poses), 6, 6)))
    return on_grid(points, (start, lines.pop()), stations=stations)


def _points_of(cells: np.ndarray, numbers: np.ndarray, rows: int, pose: np.ndarray, brightest: float) -> np.ndarray:
    """Cells of a block with a point, by their numbers in the block, as points in the frame of the file."""
    points = np.zeros(len(cells), _POINT)
    local = np.stack([cells[axis] for axis in "xyz"], -1)
    moved = local @ pose[:3, :3].T + pose[:3, 3]
    for axis, values in zip("xyz", moved.T, strict=True):
        points[axis] = values
    points["intensity"] = np.nan_to_num(cells["intensity"]) * 255
    for name in ("red", "green", "blue"):
        if name in (cells.dtype.names or ()):
            points[name] = as_bytes(cells[name], brightest)
    points["step"] = numbers // rows
    points["row"] = rows - 1 - numbers % rows
    return points


# A micrometre is far below any scanner's noise, and near the resolution of float32.
_LINE, _COLOUR = "%.6f %.6f %.6f %.6f", " %d %d %d"
_HOLE = "0 0 0 0.500000"
_UNKNOWN = 0.5
"""Intensity of points that have none, as other scanners write it: the format has no line without."""
_SAMPLES = 200_000
_AT_ONCE = 1 << 15


def write_ptx(cloud: PointCloud, path: Part, about: About) -> None:
    """Write the whole grid, a block per station and laser: `x y z intensity r g b`, holes as zeros.

    Without colours it is `x y z intensity`; without intensity that is 0.5.

    Columns are profiles. As in files of other scanners a column runs upwards, and columns follow one another to the
    right as seen from the scanner: programs take the side of a surface from that. Points are in the scanner frame of
    the station, whose pose heads the block.
    """
    poses = np.eye(4)[None] if cloud.stations is None else np.asarray(cloud.stations.pose, np.float64)
    # The format's intensity is between 0 and 1; an amplitude may exceed the range of a pixel.
    brightest = max(255.0, float(np.max(cloud.intensity, where=np.asarray(cloud.valid), initial=0)))
    with open(path, "w", encoding="ascii", newline="\n") as file:
        for number, pose in enumerate(poses):
            station = of_station(cloud, number)
            for laser in np.unique(np.asarray(station.laser)):
                profiles = np.flatnonzero(np.asarray(station.laser) == laser)
                file.write(f"{len(profiles)}\n{station.valid.shape[1]}\n" + _pose_text(pose))
                down, left = _directions(station, profiles)
                for profile in profiles[::-1] if left else profiles:
                    for part in _parts(station.valid.shape[1], reverse=down):
                        file.writelines(_column(station, int(profile), part, brightest)[:: -1 if down else 1])


def _pose_text(pose: np.ndarray) -> str:
    """Place and axes of the scanner, and the motion for rows of coordinates: the transpose of T_room_scanner."""
    rows = (pose[:3, 3], *pose[:3, :3].T, *pose.T)
    return "".join(" ".join(f"{value:.17g}" for value in row) + "\n" for row in rows)


def _directions(cloud: PointCloud, profiles: np.ndarray) -> tuple[bool, bool]:
    """Whether lines run downwards along most of the profiles, and most profiles follow one another to the left."""
    stride = max(1, cloud.valid[:1].size * len(profiles) // _SAMPLES)
    chosen = profiles[: -1 if len(profiles) > 1 else None : stride]
    following = profiles[1:][::stride] if len(profiles) > 1 else chosen
    # Where the points do not tell, lines run downwards, as in most images.
    rises, right = 0.0, 0.0
    for first, second in zip(chosen, following, strict=True):
        for part in _parts(cloud.valid.shape[1] - 1):
            start, stop = part.start, part.stop
            p, q = (np.asarray(cloud.xyz[one, start : stop + 1], np.float64) for one in (first, second))
            seen, seen_next = (np.asarray(cloud.valid[one, start : stop + 1]) for one in (first, second))
            along = p[1:] - p[:-1]
            both = seen[1:] & seen[:-1]
            rises += np.sign(along[..., 2][both]).sum()
            triple = both & seen_next[:-1]
            # To the right, then along the line, is a right-handed turn about the way back to the scanner if it rises.
            turn = np.cross((q - p)[:-1][triple], along[triple])
            right -= np.sign(np.einsum("ij,ij->i", turn, p[:-1][triple])).sum()
    down = bool(rises <= 0)
    return down, bool((-right if down else right) < 0)


def _parts(lines: int, *, reverse: bool = False) -> list[slice]:
    """Lines that are read together: as words and numbers of Python each takes ten times the memory."""
    parts = [slice(start, min(start + _AT_ONCE, lines)) for start in range(0, lines, _AT_ONCE)]
    return parts[::-1] if reverse else parts


def _column(cloud: PointCloud, profile: int, part: slice, brightest: float) -> list[str]:
    """Lines of a profile, from the first to the last of them."""
    seen_of, places, levels, colours = (
        np.asarray(field[profile, part]) for field in (cloud.valid, cloud.xyz, cloud.intensity, cloud.rgb)
    )
    levels = np.full(levels.shape, _UNKNOWN) if "intensity" in cloud.lacks else np.clip(levels / brightest, 0.0, 1.0)
    rows = zip(*(field.tolist() for field in (seen_of, places, levels, colours)), strict=True)
    if "rgb" in cloud.lacks:
        line, hole = f"{_LINE}\n", f"{_HOLE}\n"
        return [line % (*xyz, level) if seen else hole for seen, xyz, level, _ in rows]
    line, hole = f"{_LINE}{_COLOUR}\n", f"{_HOLE} 0 0 0\n"
    return [line % (*xyz, level, *rgb) if seen else hole for seen, xyz, level, rgb in rows]
