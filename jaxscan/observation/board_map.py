"""The map from pixels to a board, fitted to the corners found on it: good before any camera is known."""

import numpy as np

from jaxscan.geometry import AbstractBoard, apply_homography, direct_homography
from jaxscan.observation.corners import FoundCorners


# Margin inside the printed area, and largest distance from the found corners, both in squares: farther
# away the map to the board is a guess.
_EDGE_MARGIN = 0.1
_REACH = 1.2
# A cubic is fitted to what the homography leaves where there are so many corners.
_CUBIC_CORNERS = 30


def map_to_board(corners: FoundCorners, board: AbstractBoard, q: np.ndarray) -> np.ndarray:
    """Board coordinates [n, 2], m, of pixels [n, 2]: a homography, and a cubic for the lens."""
    seen, xy = corners.q[corners.valid], board.corners()[corners.valid, :2]
    homography = direct_homography(seen, xy)
    mapped = apply_homography(homography, q)
    if len(seen) < _CUBIC_CORNERS:
        return mapped
    centre, size = seen.mean(0), max(float(np.abs(seen - seen.mean(0)).max()), 1e-12)
    a, b = (seen - centre) / size, (q - centre) / size
    fit = np.linalg.lstsq(_cubic(a), xy - apply_homography(homography, seen), rcond=None)[0]
    # Beyond the corners the cubic diverges; its value at their edge is used there.
    return mapped + _cubic(np.clip(b, a.min(0), a.max(0))) @ fit


def on_print(xy: np.ndarray, corners: FoundCorners, board: AbstractBoard, *, near_corners: bool) -> np.ndarray:
    """Whether board coordinates [..., 2] lie inside the printed area, bool [...]; on request only near the corners."""
    outline = board.outline()
    low, high = outline.min(0) + _EDGE_MARGIN * board.square, outline.max(0) - _EDGE_MARGIN * board.square
    if near_corners:
        found = board.corners()[corners.valid, :2]
        low = np.maximum(low, found.min(0) - _REACH * board.square)
        high = np.minimum(high, found.max(0) + _REACH * board.square)
    return np.all((xy > low) & (xy < high), axis=-1)


def to_pixels(corners: FoundCorners, board: AbstractBoard, q: np.ndarray) -> np.ndarray:
    """Derivative of the board coordinates by the pixel [n, 2 of pixel, 2 of board], m per px, without the lens."""
    homography = direct_homography(corners.q[corners.valid], board.corners()[corners.valid, :2])
    here = apply_homography(homography, q)
    return np.stack([apply_homography(homography, q + step) - here for step in np.eye(2)], 1)


def map_error_px(corners: FoundCorners, board: AbstractBoard) -> float:
    """Root mean square error of the map at the corners [px]."""
    seen, xy = corners.q[corners.valid], board.corners()[corners.valid, :2]
    error = np.linalg.norm(map_to_board(corners, board, seen) - xy, axis=1)
    size = np.sqrt(np.abs(np.linalg.det(to_pixels(corners, board, seen))))
    return float(np.sqrt(np.mean(np.square(error / np.maximum(size, 1e-12)))))


def _cubic(points: np.ndarray) -> np.ndarray:
    x, y = points[:, 0], points[:, 1]
    return np.column_stack([x**i * y**j for i in range(4) for j in range(4 - i)])
