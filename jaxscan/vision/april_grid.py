"""Corners of the tags of an AprilGrid: tags by OpenCV, numbered corners by their places."""

import functools

import cv2
import numpy as np

from jaxscan.geometry import AprilGrid, apply_homography, direct_homography
from jaxscan.observation import FoundCorners
from jaxscan.vision.corners import is_enough, square_sizes


_DICTIONARY = "DICT_APRILTAG_36h11"
_FEWEST_ROWS = 2
# Noise of corners that are not fitted [px]; without small squares the blur pulls them into the tag.
_SIGMA_PX = 0.2
# Half side of the window in which they are refined, and how far they may move, in sides of a small square.
_WINDOW_SHARE, _MOST_MOVED = 0.5, 0.6
# The last window, in widths of a tag's black border, and the cells of a tag within it.
_CLEAR_SHARE, _CELLS = 0.8, 6
# A tag is accepted within this share of its side from where the others predict it.
_NEAR = 0.25


def find_april_grid(image: np.ndarray, shown: np.ndarray, board: AprilGrid) -> FoundCorners | None:
    """Find the tags of the board that are visible, each with its four corners.

    Returns:
        The corners to some tenths of a pixel; None where no tags in two rows are found.
    """
    best: FoundCorners | None = None
    for border in (2, 1):
        for thinned in (0, 3, 5):
            # The small squares touch the tags at their corners, and less ink parts them.
            seen = shown if thinned == 0 else cv2.dilate(shown, np.ones((thinned, thinned), np.uint8))
            corners, ids, _ = _detector(border).detectMarkers(seen)
            found = None if ids is None else _numbered(board, np.ravel(ids), np.reshape(corners, (-1, 4, 2)))
            if found is not None and (best is None or found.valid.sum() > best.valid.sum()):
                best = found
        if best is not None:
            return _refined(image, best, board, border)
    return None


def _dictionary() -> "cv2.aruco.Dictionary":
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, _DICTIONARY))


@functools.cache
def _detector(border: int) -> "cv2.aruco.ArucoDetector":
    settings = cv2.aruco.DetectorParameters()
    settings.markerBorderBits = border
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    return cv2.aruco.ArucoDetector(_dictionary(), settings)


def _numbered(board: AprilGrid, ids: np.ndarray, tags: np.ndarray) -> FoundCorners | None:
    """The corners of tags in the board's order."""
    known = ids < board.columns * board.rows
    ids, tags = ids[known], tags[known].astype(np.float64)
    best: tuple[float, np.ndarray, np.ndarray] | None = None
    for rows in (board.rows - 1 - ids // board.columns, ids // board.columns):
        if len(np.unique(rows)) < _FEWEST_ROWS:
            return None
        for turn in range(4):
            index, q = _corner_numbers(board, rows, ids % board.columns), np.roll(tags, turn, axis=1)
            error, kept = _misfit(board.places(), index, q)
            if best is None or error < best[0]:
                best = error, index[kept].ravel(), q[kept].reshape(-1, 2)
    if best is None or best[0] > _NEAR:
        return None
    count = 4 * board.columns * board.rows
    q, valid = np.zeros((count, 2)), np.zeros(count, bool)
    q[best[1]], valid[best[1]] = best[2], True
    return FoundCorners(q, np.where(valid, _SIGMA_PX, 1.0), valid) if is_enough(board, valid) else None


def _refined(image: np.ndarray, found: FoundCorners, board: AprilGrid, border: int) -> FoundCorners | None:
    """The corners moved to where tag and small square touch, without those that are not there."""
    q, valid = found.q.copy(), found.valid.copy()
    sizes = square_sizes(q, valid, board)[valid]
    clear = min(1.0, border / (_CELLS + 2 * border) * board.tag / board.square)
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-4)
    for share in (_WINDOW_SHARE, _CLEAR_SHARE * clear):
        half = int(np.clip(np.floor(share * sizes.min()), 2, 11))
        start = np.ascontiguousarray(q[valid], np.float32).reshape(-1, 1, 2)
        moved = cv2.cornerSubPix(image, start, (half, half), (-1, -1), criteria)
        q[valid] = np.asarray(moved, np.float64).reshape(-1, 2)
    far = np.hypot(*(q - found.q)[valid].T) > _MOST_MOVED * sizes
    valid[np.flatnonzero(valid)[far]] = False
    if not is_enough(board, valid):
        return None
    return FoundCorners(np.where(valid[:, None], q, 0.0), np.where(valid, _SIGMA_PX, 1.0), valid)


def _corner_numbers(board: AprilGrid, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Numbers of the corners of tags, clockwise from the top left one [tags, 4]."""
    width = 2 * board.columns
    first = 2 * rows * width + 2 * columns
    return np.stack([first, first + 1, first + width + 1, first + width], -1)


def _misfit(places: np.ndarray, index: np.ndarray, q: np.ndarray) -> tuple[float, np.ndarray]:
    """Median distance of the tags from where a plane has them, in sides of a tag, and which are near [tags]."""
    kept = np.ones(len(q), bool)
    for _ in range(2):
        homography = direct_homography(places[index[kept].ravel()], q[kept].reshape(-1, 2))
        off = np.linalg.norm(apply_homography(homography, places[index.ravel()]).reshape(q.shape) - q, axis=-1).max(1)
        off = off / np.maximum(np.linalg.norm(q - np.roll(q, 1, axis=1), axis=-1).mean(1), 1e-9)
        kept = off <= max(_NEAR, 2.0 * float(np.median(off)))
    return float(np.median(off)), kept & (off <= _NEAR)
