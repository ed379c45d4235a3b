"""The drawn print has its edges where the board's geometry has them."""

import cv2
import numpy as np
import pytest

from jaxscan.geometry import AprilGrid, BoardPicture, Charuco, Chessboard
from jaxscan.vision import draw_print


BOARDS = [
    AprilGrid(6, 6, 0.0165, 0.055),
    AprilGrid(4, 3, 0.0123, 0.0371),
    Charuco(7, 5, 0.066, 0.0487, "DICT_4X4_50"),
    Chessboard(8, 5, 0.03),
    Charuco(6, 4, 0.066, 0.0487, "DICT_4X4_50", "legacy"),
]


def ink_between(picture, start, end, samples=20_000):
    """Length of ink on the way from one point of the board to another [m]."""
    t = (np.arange(samples) + 0.5) / samples
    way = np.array(start) + t[:, None] * (np.array(end) - np.array(start))
    paper = picture.at(*np.ascontiguousarray(way.T, np.float32))
    return float(np.mean(1.0 - paper)) * float(np.linalg.norm(np.subtract(end, start)))


@pytest.mark.parametrize("board", BOARDS[:2], ids=["6x6", "4x3"])
def test_tags_end_at_the_corners_of_the_board(board):
    picture = BoardPicture.of(board, draw_print(board))
    corners = board.corners()[:, :2].reshape(2 * board.rows, 2 * board.columns, 2)
    reach, border = 0.4 * board.square, 0.1 * board.tag
    for row, column in np.ndindex(2 * board.rows, 2 * board.columns):
        corner = corners[row, column]
        inwards = np.array([1 - 2 * (column % 2), 1 - 2 * (row % 2)])
        for axis in (0, 1):
            # Across the side of the tag, in the black border that it has, from white paper.
            beside, across = 0.5 * border * inwards, reach * inwards
            beside[axis], across[1 - axis] = 0.0, 0.0
            ink = ink_between(picture, corner + beside - across, corner + beside + across)
            assert ink == pytest.approx(reach, abs=1e-5)


def test_tags_are_those_of_the_dictionary():
    board = BOARDS[1]
    picture = BoardPicture.of(board, draw_print(board))
    tags = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    places = board.places().reshape(2 * board.rows, 2 * board.columns, -1)[..., :2]
    middles = (np.arange(10) + 0.5) / 10 * board.tag
    for row, column in np.ndindex(board.rows, board.columns):
        number = (board.rows - 1 - row) * board.columns + column
        low = places[2 * row, 2 * column]
        x, y = np.meshgrid(low[0] + middles, low[1] + middles)
        seen = picture.at(x.astype(np.float32), y.astype(np.float32))
        np.testing.assert_allclose(seen, cv2.aruco.generateImageMarker(tags, number, 10, borderBits=2) / 255.0)


@pytest.mark.parametrize("board", BOARDS[2:], ids=["charuco", "chessboard", "legacy"])
def test_squares_meet_at_the_corners_of_the_board(board):
    picture = BoardPicture.of(board, draw_print(board))
    # Shorter than the way to a marker; beside the corner on both sides the colours are exchanged.
    reach = 0.1 * board.square
    for corner in board.corners()[:, :2]:
        for axis in (0, 1):
            way, beside = np.zeros(2), np.zeros(2)
            way[axis], beside[1 - axis] = reach, 0.5 * reach
            for side in (-1, 1):
                start, end = corner + side * beside - way, corner + side * beside + way
                assert ink_between(picture, start, end) == pytest.approx(reach, abs=1e-5)
                first, last = picture.at(*np.stack([start, end], 1).astype(np.float32))
                assert abs(first - last) == 1.0


def test_markers_have_their_size():
    board = BOARDS[2]
    picture = BoardPicture.of(board, draw_print(board))
    low = board.outline().min(0)
    gap = 0.5 * (board.square - board.marker)
    # The second square of the first row is white, with a marker whose border is a sixth of it wide.
    cell = board.marker / 6
    y = low[1] + 0.5 * board.square
    for start, inwards in ((low[0] + board.square + gap, 1), (low[0] + 2 * board.square - gap, -1)):
        reach = inwards * 0.9 * min(gap, cell)
        assert ink_between(picture, (start - reach, y), (start + reach, y)) == pytest.approx(abs(reach), abs=1e-5)
