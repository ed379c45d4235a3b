"""The board that images show in place of the expected one is named, or nothing is said."""

import functools

import cv2
import numpy as np
import pytest

from jaxscan.geometry import AprilGrid, Charuco, Chessboard
from jaxscan.vision import board_texture, find_corners, name_other_board

from .test_boards import pose, seen


CHESS = Chessboard(8, 5, 0.03)
CHARUCO = Charuco(8, 6, 0.03, 0.022)
OLD = Charuco(8, 6, 0.03, 0.022, layout="legacy")
GRID = AprilGrid(4, 4, 0.01, 0.03)


@functools.cache
def picture(board):
    """The board in perspective; a grid of tags is drawn straight."""
    if not isinstance(board, AprilGrid):
        return seen(board, pose())
    fine = np.pad(board_texture(board, 40), 100, constant_values=255)
    small = cv2.resize(fine, None, fx=0.6, fy=0.6, interpolation=cv2.INTER_AREA)
    return (20 + 0.7 * small).astype(np.uint8)


OTHERS = {
    "kind": (CHESS, Charuco(12, 9, 0.02, 0.015, "DICT_5X5_250"), "a chessboard with 8 x 5 inner corners"),
    "count": (CHESS, Chessboard(9, 6, 0.03), "a chessboard with 8 x 5 inner corners"),
    "markers": (CHARUCO, Chessboard(9, 6, 0.03), "a ChArUco board (markers 0 to 23 of DICT_5X5)"),
    "columns": (CHARUCO, Charuco(9, 6, 0.03, 0.022), "a ChArUco board with 8 columns of squares"),
    "larger": (CHARUCO, Charuco(12, 9, 0.02, 0.015), "a ChArUco board with 8 columns of squares"),
    "rows": (CHARUCO, Charuco(8, 4, 0.03, 0.022), "a larger board, with markers 0 to 23 (expected up to 15)"),
    "dictionary": (
        CHARUCO,
        Charuco(8, 6, 0.03, 0.022, "DICT_4X4_50"),
        "a board with markers of DICT_5X5, not of DICT_4X4_50",
    ),
    "legacy": (
        OLD,
        CHARUCO,
        'a ChArUco board in the layout before OpenCV 4.6 (layout = "legacy", or that word behind import --board)',
    ),
    "not legacy": (
        CHARUCO,
        OLD,
        'a ChArUco board in the layout since OpenCV 4.6 (layout = "standard", or that word behind import --board)',
    ),
    "legacy columns": (OLD, Charuco(9, 6, 0.03, 0.022), "a ChArUco board with 8 columns of squares"),
    "tags": (CHARUCO, AprilGrid(6, 4, 0.01, 0.03), "a board with markers 0 to 23 of DICT_5X5"),
    "tag columns": (GRID, AprilGrid(6, 6, 0.01, 0.03), "an AprilGrid with 4 columns of tags"),
    "more tags": (GRID, AprilGrid(3, 3, 0.01, 0.03), "a board with markers 0 to 15 of DICT_APRILTAG_36h11"),
    "tags for markers": (GRID, CHARUCO, "a board with markers of DICT_APRILTAG_36h11, not of DICT_5X5_250"),
    "tags for squares": (GRID, CHESS, "an AprilGrid (markers 0 to 15 of DICT_APRILTAG_36h11)"),
}
FAST = ("kind", "dictionary", "tag columns")
"""One of each kind of board; a search among all boards takes seconds."""


@pytest.mark.parametrize(
    ("shown", "expected", "words"),
    [pytest.param(*case, id=name, marks=() if name in FAST else pytest.mark.more) for name, case in OTHERS.items()],
)
def test_the_other_board_is_named(shown, expected, words):
    assert name_other_board(picture(shown), expected) == words


@pytest.mark.more
@pytest.mark.parametrize("board", [CHESS, CHARUCO, OLD, GRID], ids=["chessboard", "charuco", "legacy", "tags"])
def test_of_the_expected_board_nothing_is_said(board):
    assert name_other_board(picture(board), board) is None


def test_corners_of_both_layouts_have_the_same_numbers():
    whole, old = find_corners(picture(CHARUCO), CHARUCO), find_corners(picture(OLD), OLD)
    assert whole.valid.all() and old.valid.all()
    np.testing.assert_allclose(old.q, whole.q, atol=0.1)
    assert find_corners(picture(OLD), CHARUCO) is None


def test_a_part_of_the_expected_board_is_no_smaller_board():
    shown = picture(CHARUCO)
    height = shown.shape[0]
    for hidden in (slice(height // 2, height), slice(0, height // 2)):
        part = shown.copy()
        part[hidden] = 90
        assert name_other_board(part, CHARUCO) is None


def test_without_a_board_nothing_is_said():
    noise = np.random.default_rng(0).integers(0, 256, (240, 320)).astype(np.uint8)
    for image in (np.full((240, 320), 90, np.uint8), cv2.GaussianBlur(noise, (0, 0), 6.0)):
        assert name_other_board(image, CHARUCO) is None


@pytest.mark.parametrize(
    ("shown", "expected", "first"), [(CHARUCO, Charuco(8, 7, 0.03, 0.022), 0), (GRID, AprilGrid(4, 6, 0.01, 0.03), 32)]
)
def test_a_board_with_fewer_rows_is_found_as_a_part(shown, expected, first):
    """So nothing needs a name: its corners have their right numbers."""
    whole, part = find_corners(picture(shown), shown), find_corners(picture(shown), expected)
    count = len(whole.q)
    assert whole.valid.all() and part.valid.sum() == count
    np.testing.assert_allclose(part.q[first : first + count], whole.q, atol=0.05)
    assert name_other_board(picture(shown), expected) is None
