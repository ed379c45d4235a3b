"""Sums over windows of a grid whose size differs from cell to cell."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


class Windows(NamedTuple):
    """A window around every cell, cut off at the ends of the grid."""

    top: Int[np.ndarray, "rows columns"]
    bottom: Int[np.ndarray, "rows columns"]
    left: Int[np.ndarray, "rows columns"]
    right: Int[np.ndarray, "rows columns"]

    @staticmethod
    def around(half_rows: np.ndarray, half_columns: np.ndarray) -> "Windows":
        """Windows of 2 half + 1 cells in either direction."""
        rows, columns = half_rows.shape
        i, j = np.arange(rows)[:, None], np.arange(columns)[None, :]
        return Windows(
            np.maximum(i - half_rows, 0),
            np.minimum(i + half_rows + 1, rows),
            np.maximum(j - half_columns, 0),
            np.minimum(j + half_columns + 1, columns),
        )

    def sums(self, field: Float[np.ndarray, "rows columns *more"]) -> Float[np.ndarray, "rows columns *more"]:
        """Sums of a field over each window."""
        s = np.zeros((field.shape[0] + 1, field.shape[1] + 1, *field.shape[2:]))
        s[1:, 1:] = field.cumsum(0, dtype=np.float64).cumsum(1)
        top, bottom, left, right = self
        return s[bottom, right] - s[top, right] - s[bottom, left] + s[top, left]

    def area(self) -> Int[np.ndarray, "rows columns"]:
        """Cells of each window."""
        return (self.bottom - self.top) * (self.right - self.left)
