"""Boards: corner order, outline, and the same grid for both kinds."""

import numpy as np

from jaxscan.geometry import Charuco, Chessboard


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
