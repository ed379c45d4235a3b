"""Boards: corner order, outline, and the same grid for both kinds."""

import numpy as np
import pytest

from jaxscan.geometry import Charuco, Chessboard, check_board


def test_corners_run_along_columns_first():
    corners = Chessboard(4, 3, 0.02).corners()
    assert corners.shape == (12, 3)
    np.testing.assert_allclose(corners[1], [0.02, 0, 0])
    np.testing.assert_allclose(corners[4], [0, 0.02, 0])


def test_charuco_counts_squares():
    board = Charuco(5, 4, 0.03, 0.02)
    assert board.grid() == (4, 3)
    np.testing.assert_allclose(board.corners()[0], [0.03, 0.03, 0])
    np.testing.assert_allclose(board.outline(), [[0, 0], [0.15, 0], [0.15, 0.12], [0, 0.12]], atol=1e-15)


def test_outline_of_a_chessboard_is_one_square_outside():
    np.testing.assert_allclose(Chessboard(4, 3, 0.02).outline()[[0, 2]], [[-0.02, -0.02], [0.08, 0.06]], atol=1e-15)


@pytest.mark.parametrize(
    ("board", "message"),
    [
        (Chessboard(2, 9, 0.03), "found 2 x 9, expected at least 3 each"),
        (Chessboard(9, 2, 0.03), "found 9 x 2, expected at least 3 each"),
        (Chessboard(1000, 1000, 0.03), "found 1000 x 1000 inner corners, expected at most 10000"),
        (Chessboard(9, 7, 1e305), "square_mm: found 1e\\+308, expected 0.01 to 10000"),
        (Chessboard(9, 7, 1e-320), "square_mm: found"),
        (Charuco(2, 9, 0.03, 0.02), "found 2 x 9, expected at least 3 each"),
        (Charuco(30, 30, 0.03, 0.02), "30 x 30 squares need 450 markers, and DICT_5X5_250 has 250"),
        (Charuco(1000, 1000, 0.03, 0.02), "found 999 x 999 inner corners, expected at most 10000"),
        (Charuco(9, 7, 0.03, 0.03), "marker_mm = 30 must be smaller than square_mm = 30"),
        (Charuco(9, 7, 0.03, 1e-9), "marker_mm: found 1e-06"),
        (Charuco(9, 7, 0.03, 0.005), "marker_mm = 5 must be at least 0.2 of square_mm = 30"),
        (Charuco(9, 7, 0.03, 0.02, "DICT_FOO"), 'found "DICT_FOO", expected a dictionary of OpenCV; the closest'),
        (Charuco(9, 7, 0.03, 0.02, "DICT_5x5_250"), 'closest known one is "DICT_5X5_250"'),
    ],
)
def test_boards_that_cannot_be_found_are_refused(board, message):
    with pytest.raises(ValueError, match=message):
        check_board(board)


@pytest.mark.parametrize("board", [Chessboard(3, 3, 1e-5), Charuco(3, 3, 10.0, 9.0), Charuco(22, 22, 0.03, 0.02)])
def test_boards_at_the_limits_are_taken(board):
    check_board(board)
