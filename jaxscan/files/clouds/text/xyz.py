"""XYZ: a line of numbers for each point."""

import itertools
import os
from pathlib import Path

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.clouds.about import About, StoredCloud
from jaxscan.files.clouds.grid import cloud_of
from jaxscan.files.clouds.points import blocks, plain_names
from jaxscan.files.clouds.tables import LONGEST_LINE, numbers_of, text_lines
from jaxscan.files.disk import Part, open_regular
from jaxscan.reconstruction import PointCloud


# A micrometre is far below any scanner's noise, and near the resolution of float32.
_LINE = "%.6f %.6f %.6f %d %d %d\n"
_WORDS = {"r": "red", "g": "green", "b": "blue"}
_TITLE_LINES = 10
_BLOCK_LINES = 1 << 18


def write_xyz(cloud: PointCloud, path: Part, about: About) -> None:
    """Write `x y z r g b` of the valid points, a line each; metres."""
    with open(path, "w", encoding="ascii", newline="\n") as file:
        for points in blocks(cloud):
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
        dtype = np.dtype([(f"column{k}", "f8") for k in range(len(words))])
        try:
            # A number takes a digit and a separator.
            parts = []
            lines = (" ".join(_words(text)) for text in text_lines(file, size))
            while block := list(itertools.islice(lines, _BLOCK_LINES)):
                if any(block):
                    parts.append(numbers_of(iter(block), dtype))
            table = np.concatenate(parts)
        except ValueError as problem:
            raise CloudError(f"{path}: not a table of numbers: {str(problem)[:60]}.") from problem
    return StoredCloud(cloud_of(_named(table, title, path), [], str(path)), About())


def _words(line: str) -> list[str]:
    return line.replace(",", " ").replace(";", " ").lstrip("/# ").split()


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _named(table: np.ndarray, title: list[str], path: Path) -> np.ndarray:
    columns = [table[name] for name in table.dtype.names or ()]
    if len(columns) < 3:
        raise CloudError(f"{path}: found {len(columns)} numbers a line, expected x, y and z at least.")
    names = plain_names([_WORDS.get(word.lower(), word.lower()) for word in title])
    if len(title) != len(columns) or len(set(names)) < len(names) or not {"x", "y", "z"} <= set(names):
        names = ["x", "y", "z"]
        following = np.stack(columns[3:6], -1) if len(columns) >= 6 else np.full((1, 3), np.nan)
        if (following >= 0).all() and (following <= 255).all() and (following == np.floor(following)).all():
            names += ["red", "green", "blue"]
        elif (np.abs(np.sqrt((following**2).sum(-1)) - 1) < 0.01).all():
            names += ["nx", "ny", "nz"]
    types = [(name, "u1" if name in ("red", "green", "blue") else "f8") for name in names]
    points = np.empty(len(table), types)
    for (name, kind), column in zip(types, columns, strict=False):
        points[name] = np.clip(np.nan_to_num(column), 0, 255) if kind == "u1" else column
    return points
