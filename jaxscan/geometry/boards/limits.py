"""Limits of calibration boards: the dictionaries of markers, and the boards that can be printed and found."""

import difflib

from jaxscan.geometry.board import AbstractBoard, Charuco
from jaxscan.geometry.boards.april_grid import AprilGrid
from jaxscan.geometry.boards.circles import Circles


DICTIONARIES: dict[str, int] = {
    **{f"DICT_{bits}X{bits}_{markers}": markers for bits in (4, 5, 6, 7) for markers in (50, 100, 250, 1000)},
    "DICT_ARUCO_ORIGINAL": 1024,
    **{"DICT_APRILTAG_16h5": 30, "DICT_APRILTAG_25h9": 35, "DICT_APRILTAG_36h10": 2320, "DICT_APRILTAG_36h11": 587},
    **{"DICT_APRILTAG_16H5": 30, "DICT_APRILTAG_25H9": 35, "DICT_APRILTAG_36H10": 2320, "DICT_APRILTAG_36H11": 587},
    **{"DICT_ARUCO_MIP_36h12": 250, "DICT_ARUCO_MIP_36H12": 250},
}
"""Number of markers in each of OpenCV's dictionaries."""
SMALLEST_COUNT = 3
"""Least columns and rows: fewer corners show no plane."""
MOST_CORNERS = 10_000
SMALLEST_MARKER = 0.2
"""Least side of a marker, in sides of a square."""
APRIL_TAGS = "DICT_APRILTAG_36h11"
"""The tags of an AprilGrid."""
CIRCLE_SHARES = (0.15, 0.9)
"""Diameters of circles, in distances of their centres."""
GAP_SHARES = (0.1, 2.0)
"""Distances between tags, in sides of a tag."""
SMALLEST_MM, LARGEST_MM = 0.01, 10_000.0
"""Range of the sides of squares and markers, mm."""


def known_dictionary(name: str) -> str:
    """The name of a dictionary, if there is one of this name.

    Raises:
        ValueError: With the closest known name.
    """
    if name in DICTIONARIES:
        return name
    closest = difflib.get_close_matches(name[:64], DICTIONARIES, n=1, cutoff=0.0)
    raise ValueError(f'found "{name[:60]}", expected a dictionary of OpenCV; the closest known one is "{closest[0]}"')


def check_board(board: AbstractBoard) -> None:
    """Check that a board can be printed and found.

    Raises:
        ValueError: If it has too few or too many corners, or more markers than its dictionary, or no usual size.
    """
    columns, rows = board.grid()
    if columns * rows > MOST_CORNERS:
        raise ValueError(f"columns and rows: found {columns} x {rows} inner corners, expected at most {MOST_CORNERS}")
    lengths_mm, least = {"square_mm": 1000 * board.square}, (SMALLEST_COUNT, SMALLEST_COUNT)
    if isinstance(board, Charuco):
        lengths_mm["marker_mm"] = 1000 * board.marker
        _check_markers(board)
        columns, rows = board.columns, board.rows
    elif isinstance(board, Circles):
        lengths_mm = {"spacing_mm": 1000 * board.square, "diameter_mm": 1000 * board.diameter}
        least = (2, SMALLEST_COUNT)
        if board.layout == "asymmetric" and rows % 2 == 0:
            raise ValueError(
                f"rows: found {rows}, expected an odd number: this grid of circles looks the same turned by 180 degrees"
            )
    elif isinstance(board, AprilGrid):
        lengths_mm, least = {"tag_mm": 1000 * board.tag, "gap_mm": 1000 * board.square}, (2, 2)
        columns, rows = board.columns, board.rows
        if columns * rows > DICTIONARIES[APRIL_TAGS]:
            raise ValueError(f"columns and rows: {columns} x {rows} tags, and there are {DICTIONARIES[APRIL_TAGS]}")
    if columns < least[0] or rows < least[1]:
        needed = f"{least[0]} each" if least[0] == least[1] else f"{least[0]} x {least[1]}"
        raise ValueError(f"columns and rows: found {columns} x {rows}, expected at least {needed}")
    for name, length in lengths_mm.items():
        # Metres and back cost a rounding.
        if not SMALLEST_MM * (1 - 1e-9) <= length <= LARGEST_MM * (1 + 1e-9):
            raise ValueError(f"{name}: found {length:g}, expected {SMALLEST_MM:g} to {LARGEST_MM:g}")
    _check_shares(board)


def _check_markers(board: Charuco) -> None:
    needed, there = board.columns * board.rows // 2, DICTIONARIES[known_dictionary(board.dictionary)]
    if needed > there:
        raise ValueError(
            f"dictionary: {board.columns} x {board.rows} squares need {needed} markers, and {board.dictionary} has "
            f"{there}"
        )
    if board.marker >= board.square:
        raise ValueError(
            f"marker_mm = {1000 * board.marker:g} must be smaller than square_mm = {1000 * board.square:g}"
        )


def _check_shares(board: AbstractBoard) -> None:
    """Check that a camera can tell the parts of a board from one another."""
    if isinstance(board, Charuco) and board.marker < SMALLEST_MARKER * board.square:
        raise ValueError(
            f"marker_mm = {1000 * board.marker:g} must be at least {SMALLEST_MARKER:g} of square_mm = "
            f"{1000 * board.square:g}, or no camera reads it"
        )
    if isinstance(board, Circles):
        low, high = (share * board.nearest() for share in CIRCLE_SHARES)
        if not low <= board.diameter <= high:
            raise ValueError(
                f"diameter_mm: found {1000 * board.diameter:g}, expected {1000 * low:g} to {1000 * high:g} for circles "
                f"with spacing_mm = {1000 * board.square:g}"
            )
    if isinstance(board, AprilGrid) and not GAP_SHARES[0] <= board.square / board.tag <= GAP_SHARES[1]:
        raise ValueError(
            f"gap_mm: found {1000 * board.square:g}, expected {1000 * GAP_SHARES[0] * board.tag:g} to "
            f"{1000 * GAP_SHARES[1] * board.tag:g} for tag_mm = {1000 * board.tag:g}"
        )
