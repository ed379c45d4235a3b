"""Grids of circles, as OpenCV and Kalibr print them."""

from typing import Literal

import equinox as eqx
import numpy as np

from jaxscan.geometry.board import AbstractBoard, even_grid


class Circles(AbstractBoard):
    """Black circles in rows. Origin at circle 0.

    In the asymmetric layout every other row is shifted by half the distance of its circles: circle k stands at
    x = (2 column + row % 2) square, y = row * square, and the number of rows is odd, else the board would look the same
    turned by 180 degrees. In the symmetric layout x = column * square, and it does look the same.
    """

    columns: int = eqx.field(static=True)
    """Circles in a row."""
    rows: int = eqx.field(static=True)
    square: float = eqx.field(static=True)
    """Spacing: distance of two rows; of neighbours in a row too, or, asymmetric, half of that [m]."""
    diameter: float = eqx.field(static=True)
    """Diameter of a circle [m]."""
    layout: Literal["asymmetric", "symmetric"] = eqx.field(static=True, default="asymmetric")

    def grid(self) -> tuple[int, int]:
        return self.columns, self.rows

    def places(self) -> np.ndarray:
        column, row = even_grid(self.columns, self.rows).T
        x = column if self.layout == "symmetric" else 2 * column + row % 2
        return np.stack([x, row], -1) * self.square

    def nearest(self) -> float:
        """Distance of a circle's centre to the nearest other one [m]."""
        return self.square * (1.0 if self.layout == "symmetric" else np.sqrt(2.0))

    def describe(self) -> str:
        return f"{self.layout} grid of circles, {self.columns} x {self.rows} circles, {1e3 * self.square:g} mm"
