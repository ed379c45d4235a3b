"""The grid of AprilTags, as Kalibr prints it."""

import equinox as eqx
import numpy as np

from jaxscan.geometry.board import AbstractBoard, even_grid


class AprilGrid(AbstractBoard):
    """AprilTags (36h11) in rows, with small black squares between their corners. Origin at the top left tag's corner.

    The four corners of every tag are the board's corners: 2 `columns` by 2 `rows` of them. Tag numbers run along the
    rows from 0, from the bottom left tag upwards as Kalibr prints them, or from the top left one downwards.
    """

    columns: int = eqx.field(static=True)
    """Tags in a row."""
    rows: int = eqx.field(static=True)
    square: float = eqx.field(static=True)
    """Side of the small squares, which is the gap between neighbouring tags [m]; Kalibr's `tagSpacing` is square / tag.
    """
    tag: float = eqx.field(static=True)
    """Side of a tag [m]."""

    def grid(self) -> tuple[int, int]:
        return 2 * self.columns, 2 * self.rows

    def places(self) -> np.ndarray:
        number = even_grid(*self.grid())
        return np.floor(number / 2) * (self.tag + self.square) + number % 2 * self.tag

    def describe(self) -> str:
        return f"AprilGrid, {self.columns} x {self.rows} tags, {1e3 * self.tag:g} mm, {1e3 * self.square:g} mm apart"
