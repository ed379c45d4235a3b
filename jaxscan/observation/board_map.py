"""Corners found on a board, and the map from pixels to the board that is fitted to them, before any camera is known."""

from typing import NamedTuple

import numpy as np

from jaxscan.geometry import AbstractBoard, apply_homography, direct_homography


# Margin inside the printed area, and distance from the found corners beyond which the map is a guess, in squares.
_EDGE_MARGIN = 0.1
_REACH = 1.2
# Where there are so many corners, a cubic is fitted to the remainder of the homography.
_CUBIC_CORNERS = 30


class FoundCorners(NamedTuple):
    """Corners of one board in one image, in the order of `board.corners()`."""

    q: np.ndarray
    """float64 [corners, 2]: (u, v) [px]; without meaning where not valid."""
    sigma: np.ndarray
    """float64 [corners]: standard deviation of each coordinate [px]; 1 where not valid."""
    valid: np.ndarray
    """bool [corners]."""


class BoardMap(NamedTuple):
    """A homography, and a cubic for the lens."""

    board: AbstractBoard
    seen: np.ndarray
    """The corners found [n, 2], px."""
    places: np.ndarray
    """Their places on the board [n, 2], m."""
    homography: np.ndarray
    """From pixels to the board [3, 3]."""
    cubic: np.ndarray | None
    """Coefficients of the cubic [10, 2], m; None where the corners are few."""

    @staticmethod
    def of(corners: FoundCorners, board: AbstractBoard) -> "BoardMap":
        """The map fitted to the corners of one view."""
        seen, places = corners.q[corners.valid], board.corners()[corners.valid, :2]
        found = BoardMap(board, seen, places, direct_homography(seen, places), None)
        if len(seen) < _CUBIC_CORNERS:
            return found
        left = places - apply_homography(found.homography, seen)
        return found._replace(cubic=np.linalg.lstsq(found._terms(seen), left, rcond=None)[0])

    def to_board(self, q: np.ndarray) -> np.ndarray:
        """Board coordinates [n, 2], m, of pixels [n, 2]."""
        mapped = apply_homography(self.homography, q)
        return mapped if self.cubic is None else mapped + self._terms(q) @ self.cubic

    def by_pixel(self, q: np.ndarray) -> np.ndarray:
        """Derivatives of the board coordinates by the pixels [n, 2 of pixels, 2 of the board], m per px, roughly."""
        here = apply_homography(self.homography, q)
        return np.stack([apply_homography(self.homography, q + step) - here for step in np.eye(2)], 1)

    def error_px(self) -> float:
        """Root mean square error at the corners [px]."""
        error = np.sum(np.square(self.to_board(self.seen) - self.places), axis=1)
        scale = np.abs(np.linalg.det(self.by_pixel(self.seen)))
        return float(np.sqrt(np.mean(error / np.maximum(scale, 1e-24))))

    def is_near(self, xy: np.ndarray) -> np.ndarray:
        """Whether board coordinates [..., 2] lie so near the corners found that the map is good there, bool [...]."""
        reach = _REACH * self.board.square
        return np.all((xy > self.places.min(0) - reach) & (xy < self.places.max(0) + reach), axis=-1)

    def _terms(self, q: np.ndarray) -> np.ndarray:
        centre = self.seen.mean(0)
        size = max(float(np.abs(self.seen - centre).max()), 1e-12)
        # Beyond the corners the cubic diverges; its value at their edge is used there.
        x, y = ((np.clip(q, self.seen.min(0), self.seen.max(0)) - centre) / size).T
        return np.column_stack([x**i * y**j for i in range(4) for j in range(4 - i)])


def is_on_print(xy: np.ndarray, board: AbstractBoard) -> np.ndarray:
    """Whether board coordinates [..., 2], m, lie inside the printed area, bool [...]."""
    outline, margin = board.outline(), _EDGE_MARGIN * board.square
    return np.all((xy > outline.min(0) + margin) & (xy < outline.max(0) - margin), axis=-1)
