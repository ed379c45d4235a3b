"""The print of boards as a picture of ink and paper, its edges where the drawing has them."""

import cv2
import numpy as np

from jaxscan.geometry import AbstractBoard, Charuco, known_dictionary
from jaxscan.vision.boards import board_texture


# Picture elements along a square, and of a whole board at most.
_PER_SQUARE, _MOST = 160, 16_000_000
_FINER = 4
"""A board that is not made of squares and markers is drawn so many times finer, and averaged."""


def draw_print(board: AbstractBoard) -> np.ndarray:
    """The printed area, `board.outline()`, float32 [rows, columns]: 0 ink, 1 paper; row 0 at y0, column 0 at x0.

    Elements that an edge crosses have the share of paper in them: pictures drawn by OpenCV round every edge of a
    marker to whole elements.
    """
    outline = board.outline()
    squares = np.ptp(outline, axis=0) / board.square
    per_square = int(np.clip(np.sqrt(_MOST / np.prod(squares)), 8, _PER_SQUARE))
    if isinstance(board, Charuco):
        return _draw_charuco(board, per_square)
    fine = board_texture(board, per_square // _FINER * _FINER)
    rows, columns = (size // _FINER * _FINER for size in fine.shape)
    parts = fine[:rows, :columns].reshape(rows // _FINER, _FINER, columns // _FINER, _FINER)
    return np.asarray(parts.mean((1, 3)) / 255.0, np.float32)


def _draw_charuco(board: Charuco, per_square: int) -> np.ndarray:
    y, x = np.mgrid[: board.rows, : board.columns]
    white = ((x + y) % 2).astype(np.float32)
    picture = np.kron(white, np.ones((per_square, per_square), np.float32))
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, known_dictionary(board.dictionary)))
    cells = dictionary.markerSize + 2
    gap = 0.5 * (1.0 - board.marker / board.square) * per_square
    edges = np.linspace(gap, per_square - gap, cells + 1)
    # Share of every element [per_square, cells] that lies in each cell.
    first = np.arange(per_square)[:, None]
    share = np.clip(np.minimum(edges[1:], first + 1) - np.maximum(edges[:-1], first), 0.0, None)
    margin = 1.0 - np.outer(share.sum(1), share.sum(1))
    for number, (row, column) in enumerate(np.argwhere(white > 0)):
        marker = cv2.aruco.generateImageMarker(dictionary, number, cells, borderBits=1) / 255.0
        top, left = row * per_square, column * per_square
        picture[top : top + per_square, left : left + per_square] = share @ marker @ share.T + margin
    return picture
