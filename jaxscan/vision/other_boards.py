"""Boards that images show in place of the expected one: looked for only where that one was not found."""

import functools
from collections.abc import Callable

import cv2
import numpy as np

from jaxscan.geometry import AbstractBoard, AprilGrid, Charuco, Chessboard, direct_homography
from jaxscan.vision.frames import to_bytes


# Each holds the smaller ones of its kind. The larger a marker's code, the more rarely something else is taken for it:
# those of 4 x 4 cells, which chance shows, come last.
_FAMILIES = ("DICT_7X7_1000", "DICT_6X6_1000", "DICT_5X5_1000", "DICT_ARUCO_ORIGINAL", "DICT_4X4_1000")
_APRIL_TAGS = "DICT_APRILTAG_36h11"
_FEWEST_MARKERS = 6
"""Fewer may be chance: many textures resemble markers of the smallest dictionaries."""
_MOST_COLUMNS = 40
_FITS = 0.15
"""Error of markers on a board with the right number of columns, in squares, at most."""
_FEWEST_CORNERS = 4
"""Columns and rows of corners from which a chessboard is accepted: fewer are found on many boards."""
_LARGEST_PX = 800


def name_other_board(image: np.ndarray, board: AbstractBoard) -> str | None:
    """The board that an image shows, in words; None where it shows none, or may show the expected one."""
    image = to_bytes(image)
    scale = min(1.0, _LARGEST_PX / max(image.shape))
    shown = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1.0 else image
    for name in (_APRIL_TAGS, *_FAMILIES):
        ids, centres = _markers(shown, name)
        if len(ids) >= _FEWEST_MARKERS:
            return _name_marked(name, ids, centres, board)
    return _name_chessboard(shown, board)


def _name_marked(name: str, ids: np.ndarray, centres: np.ndarray, board: AbstractBoard) -> str | None:
    kind, numbers = name.removesuffix("_1000"), f"markers {min(ids)} to {max(ids)}"
    if isinstance(board, AprilGrid):
        if name != _APRIL_TAGS or max(ids) >= board.columns * board.rows:
            return f"a board with {numbers} of {kind}"
        found, _ = _columns(ids, centres, _tags)
        return f"an AprilGrid with {found} columns of tags" if found not in (None, board.columns) else None
    if not isinstance(board, Charuco):
        shown = "an AprilGrid" if name == _APRIL_TAGS else "a ChArUco board"
        return f"{shown} ({numbers} of {kind})"
    if not board.dictionary.upper().startswith(kind.upper()):
        return f"a board with markers of {kind}, not of {board.dictionary}"
    layouts = {"standard": _white_squares(True), "legacy": _white_squares(False)}
    if board.rows % 2:
        # Both are the same board.
        layouts = {board.layout: layouts["standard"]}
    fits = {layout: _columns(ids, centres, places) for layout, places in layouts.items()}
    layout, (columns, _) = min(fits.items(), key=lambda fit: fit[1][1])
    if columns is not None and columns != board.columns:
        return f"a ChArUco board with {columns} columns of squares"
    if columns is not None and layout != board.layout:
        when = "before OpenCV 4.6" if layout == "legacy" else "since OpenCV 4.6"
        return f'a ChArUco board in the layout {when} (layout = "{layout}", or that word behind import --board)'
    count = board.columns * board.rows // 2
    # A board with fewer rows counts as a part of the expected one, and is found as that.
    return f"a larger board, with {numbers} (expected up to {count - 1})" if max(ids) >= count else None


def _markers(image: np.ndarray, dictionary: str) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the markers in an image [n], and their centres [n, 2], px."""
    corners, ids, _ = _detector(dictionary).detectMarkers(image)
    if ids is None:
        return np.zeros(0, int), np.zeros((0, 2))
    ids, first = np.unique(np.ravel(ids), return_index=True)
    return ids, np.reshape(corners, (-1, 4, 2))[first].mean(1).astype(np.float64)


@functools.cache
def _detector(dictionary: str) -> "cv2.aruco.ArucoDetector":
    settings = cv2.aruco.DetectorParameters()
    # As Kalibr prints them.
    settings.markerBorderBits = 2 if dictionary == _APRIL_TAGS else 1
    return cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary)), settings)


def _columns(
    ids: np.ndarray, centres: np.ndarray, places_of: Callable[[int, int], np.ndarray]
) -> tuple[int | None, float]:
    """Columns of the board on which markers with these numbers stand at these pixels, None for none; and their error
    in squares."""
    best: tuple[float, int | None] = np.inf, None
    for columns in range(2, _MOST_COLUMNS + 1):
        places = places_of(columns, int(ids.max()) + 1)[ids]
        if min(np.ptp(places, axis=0)) < 1:
            continue
        to_board = direct_homography(centres, places)
        mapped = np.column_stack([centres, np.ones(len(centres))]) @ to_board.T
        error = np.hypot(*(mapped[:, :2] / mapped[:, 2:] - places).T)
        size = float(np.sqrt(np.median(error**2)))
        if size < min(_FITS, best[0]):
            best = size, columns
    return best[1], best[0]


def _white_squares(black_first: bool) -> Callable[[int, int], np.ndarray]:
    """Column and row of the squares of the first markers, numbered along the rows [count, 2]."""

    def places(columns: int, count: int) -> np.ndarray:
        y, x = np.mgrid[: 2 * count // (columns - 1) + 2, :columns]
        white = (x + y) % 2 == black_first
        return np.stack([x[white], y[white]], -1)[:count].astype(np.float64)

    return places


def _tags(columns: int, count: int) -> np.ndarray:
    """Column and row of the first tags of an AprilGrid [count, 2]."""
    number = np.arange(count)
    return np.stack([number % columns, number // columns], -1).astype(np.float64)


def _name_chessboard(image: np.ndarray, board: AbstractBoard) -> str | None:
    found, _, meta = cv2.findChessboardCornersSBWithMeta(image, (3, 3), cv2.CALIB_CB_LARGER)
    if not found or min(meta.shape) < _FEWEST_CORNERS:
        return None
    rows, columns = meta.shape
    if isinstance(board, Chessboard) and {columns, rows} == {board.columns, board.rows}:
        return None
    return f"a chessboard with {max(columns, rows)} x {min(columns, rows)} inner corners"
