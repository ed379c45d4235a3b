"""Tables of numbers as text, as several formats hold them."""

from collections.abc import Iterator
from typing import BinaryIO

import numpy as np


LONGEST_LINE = 1 << 16


def text_lines(file: BinaryIO, count: int) -> Iterator[str]:
    """The next lines of a file, fewer where it ends; a longer one than `LONGEST_LINE` counts as several."""
    for _ in range(count):
        line = file.readline(LONGEST_LINE)
        if not line:
            return
        yield line.decode("latin-1")


def numbers_of(lines: Iterator[str], dtype: np.dtype) -> np.ndarray:
    """Lines of numbers as records [n]; whole numbers are cut to what their fields hold.

    Raises:
        ValueError: If a line is no row of as many numbers as there are fields.
    """
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
