"""The ink of boards as exact shapes, for printing."""

from typing import NamedTuple

import cv2
import numpy as np

from jaxscan.geometry import AbstractBoard, AprilGrid, Charuco, Chessboard, Circles, known_dictionary


_APRIL_BORDER = 2
"""Cells of the black border of a tag on either side, as Kalibr prints it."""


class Ink(NamedTuple):
    """Black shapes on white paper, in board coordinates [m]."""

    rectangles: np.ndarray
    """x0, y0, x1, y1, float64 [rectangles, 4]; none covers another."""
    circles: np.ndarray
    """x and y of the centre, radius, float64 [circles, 3]."""


def board_ink(board: AbstractBoard) -> Ink:
    """The shapes of a board, within `board.outline()`.

    Raises:
        ValueError: If nobody knows how such a board is printed.
    """
    circles = np.zeros((0, 3))
    if isinstance(board, Circles):
        places = board.places()
        circles = np.column_stack([places, np.full(len(places), board.diameter / 2)])
        parts = [np.zeros((0, 4))]
    elif isinstance(board, AprilGrid):
        parts = _tags(board)
    elif isinstance(board, Charuco):
        parts = [_squares(~board.white()) * board.square, *_markers(board)]
    elif isinstance(board, Chessboard):
        black = (np.add.outer(np.arange(board.rows + 1), np.arange(board.columns + 1)) + 1) % 2 == 1
        parts = [(_squares(black) - 1.0) * board.square]
    else:
        raise ValueError(f"No print of a board of type {type(board).__name__}.")
    return Ink(np.concatenate(parts), circles)


def _squares(black: np.ndarray) -> np.ndarray:
    """The black squares of a chessboard, bool [rows, columns], in sides of a square."""
    row, column = np.nonzero(black)
    return np.stack([column, row, column + 1, row + 1], -1).astype(np.float64)


def _markers(board: Charuco) -> list[np.ndarray]:
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, known_dictionary(board.dictionary)))
    white = np.argwhere(board.white())
    gap = (board.square - board.marker) / 2
    return [
        _marker(dictionary, number, 1) * board.marker
        + np.tile([column * board.square + gap, row * board.square + gap], 2)
        for number, (row, column) in enumerate(white)
    ]


def _tags(board: AprilGrid) -> list[np.ndarray]:
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    corners = board.places().reshape(2 * board.rows, 2 * board.columns, 2)
    parts = []
    for number, (row, column) in enumerate(np.ndindex(board.rows, board.columns)):
        # Numbers begin with the row at the bottom.
        place = corners[2 * (board.rows - 1 - row), 2 * column]
        parts.append(_marker(dictionary, number, _APRIL_BORDER) * board.tag + np.tile(place, 2))
    row, column = (np.ravel(index) for index in np.indices((board.rows + 1, board.columns + 1)))
    low = np.stack([column, row], -1) * (board.tag + board.square) - board.square
    return [*parts, np.concatenate([low, low + board.square], -1)]


def _marker(dictionary: "cv2.aruco.Dictionary", number: int, border: int) -> np.ndarray:
    """Runs of black cells along the rows of a marker, in sides of the marker [runs, 4]."""
    cells = dictionary.markerSize + 2 * border
    black = cv2.aruco.generateImageMarker(dictionary, number, cells, borderBits=border) == 0
    change = np.diff(np.pad(black, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    (row, start), (_, end) = np.nonzero(change > 0), np.nonzero(change < 0)
    return np.stack([start, row, end, row + 1], -1) / cells
