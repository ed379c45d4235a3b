"""Board corners in images, by OpenCV."""

import cv2
import numpy as np

from jaxscan.geometry import AbstractBoard, AprilGrid, Charuco, Chessboard, Circles
from jaxscan.observation import FoundCorners
from jaxscan.vision.april_grid import find_april_grid
from jaxscan.vision.circles import find_circles
from jaxscan.vision.corners import (
    SMALL_SQUARE_PX,
    fit_found_corners,
    is_enough,
    marker_gap,
    square_sizes,
)
from jaxscan.vision.frames import to_bytes
from jaxscan.vision.ink import opencv_charuco


# Noise of corners of a sharp, well exposed chessboard, and of a ChArUco board [px], that `fit_corners` did not refine;
# it estimates its own.
_CHESSBOARD_PX, _CHARUCO_PX = 0.035, 0.06
_MIN_CORNERS = 6
_LARGEST_PX = 1280
"""Longest side of an image in which a chessboard is looked for at first."""
_UNEVEN = 0.25
"""Neighbouring sides of squares differ by less than this share: perspective and lenses change it slowly."""
_SMALLEST_PX = 16
"""Smallest side of an image that can show a board; of smaller ones OpenCV's detectors raise errors."""


def find_corners(image: np.ndarray, board: AbstractBoard) -> FoundCorners | None:
    """Find the corners of a board in one grey image, to a hundredth of a pixel where it is sharp.

    A chessboard or a grid of circles must be wholly visible; for a ChArUco board or an AprilGrid a
    part suffices. The orientation of a plain chessboard is ambiguous. The returned order is
    right-handed as seen. In a plain chessboard, if one of `columns` and `rows` is even and the
    other odd, the square beside corner 0 is black. Otherwise the
    board's x axis points right rather than left in the image, so such a board must not be turned
    by more than 90 degrees in its plane between views of one placement.

    Args:
        image: uint8 [rows, columns], or float32 in DN of 8 bits where the camera gives more: the board is looked for in
            bytes that are stretched over its range, and its corners are measured in the image itself.
        board: The board to look for.

    Returns:
        The corners, refined by `fit_corners`, or by `cornerSubPix` where its model does not fit, circles by the weight
        of their ink; None where the board is not found, or fewer than 6 corners that are not on one line.

    Raises:
        ValueError: If the image is neither uint8 nor float32 [rows, columns].
    """
    if image.ndim != 2 or image.dtype not in (np.uint8, np.float32):
        raise ValueError(
            f"`image` must be uint8 or float32 [rows, columns], got {image.dtype} with shape {image.shape}."
        )
    if min(image.shape) < _SMALLEST_PX:
        return None
    image = np.ascontiguousarray(image)
    shown = to_bytes(image)
    if isinstance(board, Circles):
        return find_circles(image, shown, board)
    if isinstance(board, Charuco):
        found = _find_charuco(image, shown, board)
    elif isinstance(board, AprilGrid):
        found = find_april_grid(image, shown, board)
    elif isinstance(board, Chessboard):
        found = _find_chessboard(image, shown, board)
    else:
        raise ValueError(f"No corner detector for a board of type {type(board).__name__}.")
    return None if found is None else fit_found_corners(image, found, board)


def _find_chessboard(image: np.ndarray, shown: np.ndarray, board: Chessboard) -> FoundCorners | None:
    """Corners by OpenCV's first detector, or by the sector-based one where the first finds no even grid."""
    q = _find_squares(shown, board)
    if q is None:
        q = _find_sectors(shown, board)
    if q is None:
        flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
        found, corners = cv2.findChessboardCorners(shown, board.grid(), flags=flags)
        q = _points(corners) if found else None
    if q is None or len(q) != board.columns * board.rows:
        return None
    # The sector based detector finds the most boards, but its corners are biased by some hundredths of a pixel per
    # view; the gradient-based refinement is not biased. A window that reaches the neighbouring corners would move the
    # corner towards them.
    everywhere = np.ones(len(q), bool)
    smallest = square_sizes(q, everywhere, board).min()
    q = _canonical_order(image, _refine(image, q, int(np.clip(np.floor(smallest / 3), 2, 11))), board)
    return _with_sigma(q, everywhere, board, _CHESSBOARD_PX)


def _find_squares(image: np.ndarray, board: Chessboard) -> np.ndarray | None:
    """Corners by OpenCV's first detector, in a seventh of the time of the sector based one."""
    scale = min(1.0, _LARGEST_PX / max(image.shape))
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1.0 else image
    found, corners = cv2.findChessboardCorners(small, board.grid(), flags=cv2.CALIB_CB_ADAPTIVE_THRESH)
    if not found:
        return None
    q = _points(corners)
    grid = q.reshape(board.rows, board.columns, 2)
    for axis in (0, 1):
        side = np.diff(grid, axis=axis)
        length = np.linalg.norm(side, axis=-1)
        short = np.minimum(*(np.delete(length, end, axis=axis) for end in (0, -1)))
        if (np.linalg.norm(np.diff(side, axis=axis), axis=-1) > _UNEVEN * short).any():
            return None
    # Pixel centres of the copy lie between those of the image.
    return (q + 0.5) / scale - 0.5


def _find_sectors(image: np.ndarray, board: Chessboard) -> np.ndarray | None:
    """Corners by the sector based detector; the exhaustive search runs only where the quick one fails."""
    for effort in (0, cv2.CALIB_CB_EXHAUSTIVE, cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_NORMALIZE_IMAGE):
        found, corners = cv2.findChessboardCornersSB(image, board.grid(), flags=effort)
        if found:
            return _points(corners)
    return None


def _canonical_order(image: np.ndarray, q: np.ndarray, board: Chessboard) -> np.ndarray:
    grid = q.reshape(board.rows, board.columns, 2)
    along = (grid[:, -1] - grid[:, 0]).mean(0)
    down = (grid[-1] - grid[0]).mean(0)
    if along[0] * down[1] - along[1] * down[0] < 0:
        grid, along = grid[:, ::-1], -along
    turns = [0, 2] if board.columns != board.rows else [0, 1, 2, 3]
    candidates = [np.rot90(grid, k) for k in turns]
    if (board.columns + board.rows) % 2:
        # The square right below corner 0 has the colour of the outer top left one: black.
        candidates.sort(key=lambda g: _even_brightness(image, g))
    else:
        candidates.sort(key=lambda g: -float((g[:, -1] - g[:, 0]).mean(0)[0]))
    return np.ascontiguousarray(candidates[0]).reshape(-1, 2)


def _even_brightness(image: np.ndarray, grid: np.ndarray) -> float:
    """Mean level of the inner squares with i + j even minus the mean of the others, at their centres."""
    centre = (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]) / 4
    columns = np.clip(np.rint(centre[..., 0]).astype(int), 0, image.shape[1] - 1)
    rows = np.clip(np.rint(centre[..., 1]).astype(int), 0, image.shape[0] - 1)
    level = image[rows, columns].astype(float)
    even = np.add.outer(np.arange(level.shape[0]), np.arange(level.shape[1])) % 2 == 0
    return float(level[even].mean() - level[~even].mean())


def _find_charuco(image: np.ndarray, shown: np.ndarray, board: Charuco) -> FoundCorners | None:
    corners, ids, _, _ = cv2.aruco.CharucoDetector(opencv_charuco(board)).detectBoard(shown)
    if ids is None or len(np.ravel(ids)) < _MIN_CORNERS:
        return None
    count = len(board.corners())
    q, valid = np.zeros((count, 2)), np.zeros(count, bool)
    index = np.ravel(ids)
    q[index], valid[index] = _points(corners), True
    if not is_enough(board, valid):
        return None
    sizes = square_sizes(q, valid, board)
    # The markers begin (1 - marker / square) / 2 of a square away. A window that reaches them spoils
    # the corner; without refinement the error is some tenths of a pixel.
    half = int(np.clip(np.floor(min(0.25, 1.3 * marker_gap(board)) * sizes[valid].min()), 2, 11))
    refined = _refine(image, q[valid], half)
    moved = np.hypot(*(refined - q[valid]).T)
    q[valid] = refined
    # A corner that moved farther was fitted to something else.
    valid[np.flatnonzero(valid)[moved > 0.25 * sizes[valid]]] = False
    if not is_enough(board, valid):
        return None
    return _with_sigma(np.where(valid[:, None], q, 0.0), valid, board, _CHARUCO_PX)


def _points(corners: np.ndarray) -> np.ndarray:
    # OpenCV 4 gives [n, 1, 2], OpenCV 5 [n, 2].
    return np.asarray(corners, np.float64).reshape(-1, 2)


def _refine(image: np.ndarray, q: np.ndarray, half: int) -> np.ndarray:
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-4)
    start = np.ascontiguousarray(q, np.float32).reshape(-1, 1, 2)
    return _points(cv2.cornerSubPix(image, start, (half, half), (-1, -1), criteria))


def _with_sigma(q: np.ndarray, valid: np.ndarray, board: AbstractBoard, sigma_px: float) -> FoundCorners:
    sigma = sigma_px * np.hypot(1.0, SMALL_SQUARE_PX / square_sizes(q, valid, board))
    return FoundCorners(q, np.where(valid, sigma, 1.0), valid)
