"""The asymmetric grid of circles, as OpenCV and Kalibr print it."""

import equinox as eqx
import numpy as np

from jaxscan.geometry.board import AbstractBoard, even_grid


class Circles(AbstractBoard):
    """Black circles in rows, every other row shifted by half the distance of its circles. Origin at circle 0.

    Circle k stands at x = (2 column + row % 2) square, y = row * square. The number of rows is odd: else the board
    looks the same turned by 180 degrees.
    """

    columns: int = eqx.field(static=True)
    """Circles in a row."""
    rows: int = eqx.field(static=True)
    square: float = eqx.field(static=True)
    """Spacing: distance of two rows, and half the distance of neighbours in a row [m]."""
    diameter: float = eqx.field(static=True)
    """Diameter of a circle [m]."""

    def grid(self) -> tuple[int, int]:
        return self.columns, self.rows

    def places(self) -> np.ndarray:
        column, row = even_grid(self.columns, self.rows).T
        return np.stack([2 * column + row % 2, row], -1) * self.square

    def describe(self) -> str:
        return f"asymmetric grid of circles, {self.columns} x {self.rows} circles, {1e3 * self.square:g} mm"
