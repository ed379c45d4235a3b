"""Boards as people write them on the command line."""

import pytest

from jaxscan.errors import OptionError
from jaxscan.files.importing import parse_board


@pytest.mark.parametrize(
    ("text", "board"),
    [
        ("chessboard 11x6 13mm", {"type": "chessboard", "columns": 11, "rows": 6, "square_mm": 13.0}),
        (
            "ChArUco 12x9 3 cm 22 mm",
            {"type": "charuco", "columns": 12, "square_mm": 30.0, "marker_mm": 22.0},
        ),
        ("charuco 5x4 0.03m 20mm DICT_4X4_50", {"square_mm": 30.0, "dictionary": "DICT_4X4_50"}),
        ("charuco 6x8 35mm 24mm DICT_4X4_250 legacy", {"dictionary": "DICT_4X4_250", "layout": "legacy"}),
        ("charuco 6x8 35mm 24mm Legacy", {"dictionary": "DICT_5X5_250", "layout": "legacy"}),
        ("circles 4x11 20mm 16mm", {"type": "circles", "rows": 11, "spacing_mm": 20.0, "layout": "asymmetric"}),
        ("circles 7x7 37.5mm 22mm symmetric", {"diameter_mm": 22.0, "layout": "symmetric"}),
        ("aprilgrid 6×6 24mm 7.2mm", {"type": "aprilgrid", "tag_mm": 24.0, "gap_mm": 7.2}),
    ],
)
def test_boards_as_people_write_them(text, board):
    found = parse_board(text).model_dump()
    assert {key: found[key] for key in board} == board


@pytest.mark.parametrize(
    "text", ["", "chess", "chessboard 11x6", "chessboard 11x6 13", "disc 3x3 1mm", "circles 4x11 20mm"]
)
def test_boards_that_are_not_understood(text):
    with pytest.raises(OptionError, match='expected "chessboard 11x6 13mm"'):
        parse_board(text)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("circles 4x10 20mm 16mm", "expected an odd number"),
        ("circles 4x11 20mm 40mm", "diameter_mm: found 40"),
        ("aprilgrid 6x6 24mm 1mm", "gap_mm"),
        ("aprilgrid 30x30 24mm 7mm", "tags, and there are 587"),
        ("circles 4x11 20mm 16mm round", "layout"),
    ],
)
def test_boards_that_cannot_be(text, says):
    with pytest.raises(OptionError, match=says):
        parse_board(text)
