"""The ink of boards: as exact shapes, for printing, and drawn as pictures."""

import functools
from typing import NamedTuple

import cv2
import numpy as np

from jaxscan.geometry import AbstractBoard, AprilGrid, Charuco, Chessboard, Circles, known_dictionary


_APRIL_BORDER = 2
"""Cells of the black border of a tag on either side, as Kalibr prints it."""
# Picture elements along a square, and of a whole board at most; a board without ChArUco's markers needs fewer.
_PER_SQUARE, _MOST, _FEWER = 160, 16_000_000, 4
_SUBSAMPLES = 4
"""Points along either side of a picture element at which a circle is sampled."""


class Ink(NamedTuple):
    """Black shapes on white paper, in board coordinates [m]."""

    rectangles: np.ndarray
    """x0, y0, x1, y1, float64 [rectangles, 4]; none covers another."""
    circles: np.ndarray
    """x and y of the centre, radius, float64 [circles, 3]."""


def board_ink(board: AbstractBoard) -> Ink:
    """The shapes of a board, within `board.outline()`.

    Raises:
        ValueError: If no print of such a board is known.
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


def draw_print(board: AbstractBoard) -> np.ndarray:
    """The printed area, `board.outline()`, float32 [rows, columns]: 0 ink, 1 paper; row 0 at y0, column 0 at x0.

    Elements that an edge crosses have the share of paper in them: pictures drawn by OpenCV round every edge of a
    marker to whole elements.
    """
    squares = np.ptp(board.outline(), axis=0) / board.square
    per_square = int(np.clip(np.sqrt(_MOST / np.prod(squares)), 8, _PER_SQUARE))
    return _drawn(board, per_square if isinstance(board, Charuco) else max(per_square // _FEWER, 2))


def board_texture(board: AbstractBoard, pixels_per_square: int) -> np.ndarray:
    """Picture of the printed area, `board.outline()`, uint8: row 0 at y0, column 0 at x0.

    Args:
        board: A chessboard is drawn with its top left square black.
        pixels_per_square: Side of a square [px]; for boards with markers large enough to draw them.
    """
    if isinstance(board, Charuco):
        size = (board.columns * pixels_per_square, board.rows * pixels_per_square)
        return np.asarray(opencv_charuco(board).generateImage(size, marginSize=0, borderBits=1), np.uint8)
    return np.rint(255.0 * _drawn(board, pixels_per_square)).astype(np.uint8)


def _drawn(board: AbstractBoard, per_square: int) -> np.ndarray:
    ink, (low, _, high, _) = board_ink(board), board.outline()
    columns, rows = np.rint((high - low) / board.square * per_square).astype(int)
    scale = np.array([columns, rows]) / (high - low)
    paper = np.ones((rows, columns), np.float32)
    for x0, y0, x1, y1 in ((ink.rectangles.reshape(-1, 2, 2) - low) * scale).reshape(-1, 4).tolist():
        (across, by_column), (down, by_row) = _shares(x0, x1), _shares(y0, y1)
        paper[down, across] -= np.outer(by_row, by_column)
    step = (np.arange(_SUBSAMPLES) + 0.5) / _SUBSAMPLES
    for x, y, radius in ink.circles:
        (u, v), reach = (np.array([x, y]) - low) * scale, radius * scale[0]
        left, top, side = int(u - reach), int(v - reach), int(2 * reach) + 3
        points = (np.arange(side)[:, None] + step).ravel()
        inside = np.hypot(points + left - u, points[:, None] + top - v) <= reach
        share = inside.reshape(side, _SUBSAMPLES, side, _SUBSAMPLES).mean((1, 3))
        part = paper[top : top + side, left : left + side]
        part -= share[: part.shape[0], : part.shape[1]]
    return np.clip(paper, 0.0, 1.0)


def _shares(start: float, end: float) -> tuple[slice, np.ndarray]:
    """The elements that an interval covers, and the share of each that it does."""
    # A distance of 1e-6 from a whole number is rounding.
    start, end = (round(at) if abs(at - round(at)) < 1e-6 else at for at in (start, end))
    first, last = int(np.floor(start)), int(np.ceil(end))
    each = np.arange(first, last)
    return slice(first, last), np.minimum(end, each + 1) - np.maximum(start, each)


@functools.lru_cache(maxsize=8)
def opencv_charuco(board: Charuco) -> "cv2.aruco.CharucoBoard":
    """OpenCV's board; a large one takes a tenth of a second."""
    markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, known_dictionary(board.dictionary)))
    same = cv2.aruco.CharucoBoard((board.columns, board.rows), board.square, board.marker, markers)
    same.setLegacyPattern(board.layout == "legacy")
    return same


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
