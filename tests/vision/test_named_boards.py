"""The board that images show in place of the expected one is named, or nothing is said."""

import cv2
import numpy as np
import pytest

from jaxscan.geometry import AprilGrid, Charuco, Chessboard
from jaxscan.vision import name_other_board

from .test_boards import pose, seen


CHESS = Chessboard(8, 5, 0.03)
CHARUCO = Charuco(8, 6, 0.03, 0.022)
SHOWN = {"chessboard": CHESS, "ChArUco board": CHARUCO}


@pytest.mark.parametrize(
    ("shown", "expected", "words"),
    [
        (CHESS, Charuco(12, 9, 0.02, 0.015, "DICT_5X5_250"), "a chessboard with 8 x 5 inner corners"),
        (CHESS, Chessboard(9, 6, 0.03), "a chessboard with 8 x 5 inner corners"),
        (CHARUCO, Chessboard(9, 6, 0.03), "a ChArUco board (markers 0 to 23 of DICT_5X5)"),
        (CHARUCO, Charuco(9, 6, 0.03, 0.022), "a ChArUco board with 8 columns of squares"),
        (CHARUCO, Charuco(12, 9, 0.02, 0.015), "a ChArUco board with 8 columns of squares"),
        (CHARUCO, Charuco(8, 4, 0.03, 0.022), "a larger board, with markers 0 to 23 (expected up to 15)"),
        (
            CHARUCO,
            Charuco(8, 6, 0.03, 0.022, "DICT_4X4_50"),
            "a board with markers of DICT_5X5, not of DICT_4X4_50",
        ),
        (CHARUCO, AprilGrid(6, 4, 0.01, 0.03), "a board with markers 0 to 23 of DICT_5X5"),
    ],
    ids=["kind", "count", "markers", "columns", "larger", "rows", "dictionary", "tags"],
)
def test_the_other_board_is_named(shown, expected, words):
    assert name_other_board(seen(shown, pose()), expected) == words


@pytest.mark.parametrize("board", [CHESS, CHARUCO], ids=["chessboard", "charuco"])
def test_of_the_expected_board_nothing_is_said(board):
    assert name_other_board(seen(board, pose()), board) is None


def test_without_a_board_nothing_is_said():
    noise = np.random.default_rng(0).integers(0, 256, (240, 320)).astype(np.uint8)
    for image in (np.full((240, 320), 90, np.uint8), cv2.GaussianBlur(noise, (0, 0), 6.0)):
        assert name_other_board(image, CHARUCO) is None
