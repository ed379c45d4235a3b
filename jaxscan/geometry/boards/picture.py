"""The print of a board, looked up at places on it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscan.geometry.board import AbstractBoard


class BoardPicture(NamedTuple):
    """The printed area as a grid of small elements."""

    paper: Float[np.ndarray, "rows columns"]
    """Share of paper, float32: 0 ink, 1 paper."""
    low: np.ndarray
    """Least x and y of the printed area [2], m."""
    high: np.ndarray
    """Greatest x and y [2], m."""

    @staticmethod
    def of(board: AbstractBoard, paper: Float[np.ndarray, "rows columns"]) -> "BoardPicture":
        """The picture of a board's `outline()`, row 0 at y0, column 0 at x0."""
        outline = board.outline()
        return BoardPicture(np.ascontiguousarray(paper, np.float32), outline.min(0), outline.max(0))

    def at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Share of paper at board coordinates [m], linear between elements; beyond the print that of its rim."""
        rows, columns = self.paper.shape
        across = _element(x, self.low[0], self.high[0], columns)
        down = _element(y, self.low[1], self.high[1], rows)
        j, i = across.astype(np.int32), down.astype(np.int32)
        across -= j
        down -= i
        flat, place = self.paper.ravel(), i * np.int32(columns) + j
        upper, lower = flat[place], flat[place + np.int32(columns)]
        upper += across * (flat[place + 1] - upper)
        lower += across * (flat[place + np.int32(columns + 1)] - lower)
        upper += down * (lower - upper)
        return upper

    def holds(self, xy: np.ndarray) -> np.ndarray:
        """Whether board coordinates [..., 2], m, are on the printed area, bool [...]."""
        return np.all((xy >= self.low) & (xy <= self.high), axis=-1)


def _element(x: np.ndarray, low: float, high: float, count: int) -> np.ndarray:
    """Coordinate in elements, within the picture, float32."""
    scale = count / (high - low)
    return np.clip((x - np.float32(low)) * np.float32(scale) - np.float32(0.5), 0.0, np.float32(count - 1.001))
