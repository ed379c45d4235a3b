"""XYZ: a line of numbers for each point."""

import itertools
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.clouds.about import About, StoredCloud
from jaxscan.files.clouds.grid import USED, Records, cloud_of
from jaxscan.files.clouds.points import blocks, plain_names
from jaxscan.files.clouds.tables import LONGEST_LINE, numbers_of, text_lines
from jaxscan.files.disk import open_regular
from jaxscan.reconstruction import PointCloud


# A micrometre is far below any scanner's noise, and near the resolution of float32.
_LINE = "%.6f %.6f %.6f %d %d %d\n"
_WORDS = {"r": "red", "g": "green", "b": "blue"}
_TITLE_LINES = 10
_BLOCK_LINES = 1 << 15
"""Lines at a time: as words and numbers of Python each takes ten times the memory."""
_COLOURS, _NORMALS = ("red", "green", "blue"), ("nx", "ny", "nz")


def write_xyz(cloud: PointCloud, path: Path, about: About) -> None:
    """Write `x y z r g b` of the valid points, a line each; metres."""
    with open(path, "w", encoding="ascii", newline="\n") as file:
        for points in blocks(cloud, _BLOCK_LINES):
            rows = zip(points.xyz.tolist(), points.rgb.tolist(), strict=True)
            file.writelines(_LINE % (*position, *colour) for position, colour in rows)


def read_xyz(path: Path) -> StoredCloud:
    """The points of a table of numbers, as a single profile.

    Columns are those of the line of names where there is one; else x, y, z, and three whole numbers of 0 to 255 that
    follow are a colour, three others a normal. More columns are not used.

    Raises:
        CloudError: If it is no table of numbers, or has no points.
    """
    with open_regular(path, error=CloudError) as file:
        size = os.fstat(file.fileno()).st_size
        title: list[str] = []
        for _ in range(_TITLE_LINES):
            at = file.tell()
            line = file.readline(LONGEST_LINE).decode("latin-1")
            words = _words(line)
            # A number alone is that of the points, as CloudCompare writes it.
            if len(words) > 1 and _is_number(words[0]):
                file.seek(at)
                break
            title = words if words and "x" in (word.lower() for word in words) else title
        else:
            raise CloudError(f"{path}: not a table of numbers: the first {_TITLE_LINES} lines hold none.")
        try:
            points = _points_of(_tables(file, len(words), size), len(words), title, path)
        except ValueError as problem:
            raise CloudError(f"{path}: not a table of numbers: {str(problem)[:60]}.") from problem
    return StoredCloud(cloud_of(points, [], str(path)), About())


def _tables(file: BinaryIO, width: int, most: int) -> Iterator[np.ndarray]:
    """The numbers of the lines that follow, float64 [n, width], some lines at a time."""
    dtype = np.dtype([(f"column{k}", "f8") for k in range(width)])
    # A number takes a digit and a separator.
    lines = (" ".join(_words(text)) for text in text_lines(file, most))
    while block := list(itertools.islice(lines, _BLOCK_LINES)):
        if any(block):
            yield numbers_of(iter(block), dtype).view("f8").reshape(-1, width)


def _points_of(tables: Iterable[np.ndarray], width: int, title: list[str], path: Path) -> Records:
    """The points; of the numbers only those are kept that a cloud uses, and colours as bytes."""
    if width < 3:
        raise CloudError(f"{path}: found {width} numbers a line, expected x, y and z at least.")
    names = plain_names([_WORDS.get(word.lower(), word.lower()) for word in title])
    if len(title) == width and len(set(names)) == width and {"x", "y", "z"} <= set(names):
        used = {name: k for k, name in enumerate(names) if name in USED}
        kinds = np.dtype([(name, "u1" if name in _COLOURS else "f8") for name in used])
        titled = [_records(table.T[list(used.values())], kinds) for table in tables]
        return Records(kinds, sum(map(len, titled)), lambda: iter(titled))
    places: list[np.ndarray] = []
    following: list[np.ndarray] = []
    # Only all points together tell what three more numbers are.
    colours = normals = width >= 6
    for table in tables:
        places.append(table[:, :3].copy())
        more = table[:, 3:6]
        whole = bool(more.size and ((more >= 0) & (more <= 255) & (more == np.floor(more))).all())
        colours &= whole
        normals &= bool((np.abs(np.sqrt((more**2).sum(-1)) - 1) < 0.01).all())
        if colours or normals:
            following.append(more.astype(np.uint8) if whole else more.copy())
        else:
            following.clear()
    more_names = _COLOURS if colours else _NORMALS if normals else ()
    kinds = np.dtype([(axis, "f8") for axis in "xyz"] + [(name, "u1" if colours else "f8") for name in more_names])

    def read() -> Iterator[np.ndarray]:
        for number, xyz in enumerate(places):
            yield _records([*xyz.T, *(following[number].T if more_names else ())], kinds)

    return Records(kinds, sum(map(len, places)), read)


def _records(columns: Iterable[np.ndarray], kinds: np.dtype) -> np.ndarray:
    """Columns as records; colours are cut to what bytes hold."""
    values = list(columns)
    points = np.empty(len(values[0]), kinds)
    for name, column in zip(kinds.names or (), values, strict=True):
        points[name] = np.clip(np.nan_to_num(column), 0, 255) if kinds[name] == np.uint8 else column
    return points


def _words(line: str) -> list[str]:
    return line.replace(",", " ").replace(";", " ").lstrip("/# ").split()


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
