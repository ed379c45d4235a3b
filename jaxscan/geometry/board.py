"""Calibration boards: where the corners are on the board.

The board frame has its origin at a corner, x along the rows of squares, y down the columns, z
into the board, so a board seen upright has the camera's axes. Corner k stands at column
`k % columns`, row `k // columns` of the inner corners, for both kinds.
"""

import abc

import equinox as eqx
import numpy as np


class AbstractBoard(eqx.Module):
    """A flat printed target with point features."""

    square: eqx.AbstractVar[float]

    @abc.abstractmethod
    def grid(self) -> tuple[int, int]:
        """Columns and rows of inner corners."""

    @abc.abstractmethod
    def first_corner(self) -> tuple[float, float]:
        """Board coordinates (x, y) of corner 0 [m]."""

    def corners(self) -> np.ndarray:
        """All corners, float64 [columns * rows, 3], metres, board frame."""
        columns, rows = self.grid()
        x, y = np.meshgrid(np.arange(columns), np.arange(rows))
        flat = np.stack([x.ravel(), y.ravel()], -1) * self.square + np.array(self.first_corner())
        return np.column_stack([flat, np.zeros(len(flat))])

    def outline(self) -> np.ndarray:
        """Corners of the printed area, float64 [4, 2], metres: x0 y0, x1 y0, x1 y1, x0 y1."""
        columns, rows = self.grid()
        x0, y0 = np.array(self.first_corner()) - self.square
        x1, y1 = x0 + (columns + 1) * self.square, y0 + (rows + 1) * self.square
        return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


class Chessboard(AbstractBoard):
    """A plain chessboard; `columns` and `rows` count inner corners. Origin at corner 0.

    A symmetric board (both counts even or both odd) looks the same turned by 180 degrees.
    """

    columns: int = eqx.field(static=True)
    rows: int = eqx.field(static=True)
    square: float = eqx.field(static=True)
    """Side of a square [m]."""

    def grid(self) -> tuple[int, int]:
        return self.columns, self.rows

    def first_corner(self) -> tuple[float, float]:
        return 0.0, 0.0


class Charuco(AbstractBoard):
    """A chessboard with ArUco markers in its white squares; `columns` and `rows` count squares.

    Origin at the corner of the printed area beside marker 0, as OpenCV has it.
    """

    columns: int = eqx.field(static=True)
    rows: int = eqx.field(static=True)
    square: float = eqx.field(static=True)
    """Side of a square [m]."""
    marker: float = eqx.field(static=True)
    """Side of a marker [m]."""
    dictionary: str = eqx.field(static=True, default="DICT_5X5_250")

    def grid(self) -> tuple[int, int]:
        return self.columns - 1, self.rows - 1

    def first_corner(self) -> tuple[float, float]:
        return self.square, self.square
