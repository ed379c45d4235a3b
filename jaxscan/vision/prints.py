"""The print of boards as a picture of ink and paper, its edges where the drawing has them."""

import cv2
import numpy as np

from jaxscan.geometry import AbstractBoard, AprilGrid, Charuco, known_dictionary
from jaxscan.vision.boards import board_texture


# Picture elements along a square, and of a whole board at most.
_PER_SQUARE, _MOST = 160, 16_000_000
_FINER = 4
"""A board that is not made of squares and markers is drawn so many times finer, and averaged."""
_APRIL_BORDER = 2
"""Cells of the black border of a tag on either side, as Kalibr prints it."""


def draw_print(board: AbstractBoard) -> np.ndarray:
    """The printed area, `board.outline()`, float32 [rows, columns]: 0 ink, 1 paper; row 0 at y0, column 0 at x0.

    Elements that an edge crosses have the share of paper in them: pictures drawn by OpenCV round every edge of a
    marker to whole elements.
    """
    squares = np.ptp(board.outline(), axis=0) / board.square
    per_square = int(np.clip(np.sqrt(_MOST / np.prod(squares)), 8, _PER_SQUARE))
    if isinstance(board, Charuco):
        return _draw_charuco(board, per_square)
    if isinstance(board, AprilGrid):
        return _draw_april_grid(board, max(per_square // _FINER, 2))
    fine = board_texture(board, per_square // _FINER * _FINER)
    rows, columns = (size // _FINER * _FINER for size in fine.shape)
    parts = fine[:rows, :columns].reshape(rows // _FINER, _FINER, columns // _FINER, _FINER)
    return np.asarray(parts.mean((1, 3)) / 255.0, np.float32)


def _draw_charuco(board: Charuco, per_square: int) -> np.ndarray:
    white = board.white()
    picture = np.kron(white, np.ones((per_square, per_square))).astype(np.float32)
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, known_dictionary(board.dictionary)))
    cells = dictionary.markerSize + 2
    gap = 0.5 * (1.0 - board.marker / board.square) * per_square
    share = _shares(np.linspace(gap, per_square - gap, cells + 1), per_square)
    margin = 1.0 - np.outer(share.sum(1), share.sum(1))
    for number, (row, column) in enumerate(np.argwhere(white)):
        marker = cv2.aruco.generateImageMarker(dictionary, number, cells, borderBits=1) / 255.0
        top, left = row * per_square, column * per_square
        picture[top : top + per_square, left : left + per_square] = share @ marker @ share.T + margin
    return picture


def _draw_april_grid(board: AprilGrid, per_square: int) -> np.ndarray:
    """Small squares and tags are cells of one grid, of two sizes."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    cells = dictionary.markerSize + 2 * _APRIL_BORDER
    paper = np.ones((board.rows * (cells + 1) + 1, board.columns * (cells + 1) + 1))
    paper[:: cells + 1, :: cells + 1] = 0.0
    for number, (row, column) in enumerate(np.ndindex(board.rows, board.columns)):
        # Numbers begin with the row at the bottom.
        top, left = (board.rows - 1 - row) * (cells + 1) + 1, column * (cells + 1) + 1
        tag = cv2.aruco.generateImageMarker(dictionary, number, cells, borderBits=_APRIL_BORDER) / 255.0
        paper[top : top + cells, left : left + cells] = tag
    shares = []
    for tags in (board.rows, board.columns):
        sizes = np.array(([board.square] + [board.tag / cells] * cells) * tags + [board.square])
        edges = np.concatenate([[0.0], np.cumsum(sizes)])
        elements = round(edges[-1] / board.square * per_square)
        shares.append(_shares(edges * (elements / edges[-1]), elements))
    return np.asarray(shares[0] @ paper @ shares[1].T, np.float32)


def _shares(edges: np.ndarray, elements: int) -> np.ndarray:
    """Share of every picture element that lies in each cell [elements, cells]; `edges` [cells + 1], elements."""
    first = np.arange(elements)[:, None]
    return np.clip(np.minimum(edges[1:], first + 1) - np.maximum(edges[:-1], first), 0.0, None)
