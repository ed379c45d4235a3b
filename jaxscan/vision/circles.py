"""Centres of the circles of a grid: found by OpenCV, then measured by the weight of their ink."""

from typing import NamedTuple

import cv2
import numpy as np

from jaxscan.geometry import Circles, apply_homography, direct_homography
from jaxscan.observation import FoundCorners


_SMALLEST_AREA_PX = 12.0
# Largest departure from a plane that is seen through a lens, in distances of circles.
_MISFIT = 0.1
# Reach of the blur beyond a circle's edge [px].
_BLUR_PX = 2.5
# Rounds of the alternation between window and centre.
_ROUNDS = 4
# Least darkness of ink against the paper round it, and least share of the expected area that it has to cover.
_MIN_DARKNESS, _MIN_COVER = 0.15, 0.5
_FEWEST_PAPER = 12
# A centre may move by this share of a circle's radius.
_MAX_MOVE = 0.5
# Errors: of the model [px], and of the correction, as a share of it.
_FLOOR_PX, _CORRECTION_SHARE = 0.01, 0.1
# Fewest centres that fix a cubic beside the homography.
_CUBIC_FROM = 30


def find_circles(image: np.ndarray, shown: np.ndarray, board: Circles) -> FoundCorners | None:
    r"""Find all circles of the board, and where their centres are seen.

    The centre of a circle's picture is not the picture of its centre: it is the mean of the map $f$ from board to
    image over the circle, weighted by the area,

    $$\bar q = \frac{\int f(x)\,|\det f'(x)|\,dx}{\int |\det f'(x)|\,dx} \ne f(x_0).$$

    The map (homography and a cubic for the lens) is fitted to the centres, and the difference is taken off.

    Args:
        image: uint8 or float32 [rows, columns], in which ink is weighed.
        shown: The same in bytes, in which circles are found (`to_bytes`).
        board: The grid, which must be wholly visible; its circles are dark on white paper, or white on black.

    Returns:
        The centres, or None where the grid is not found. The x axis of a symmetric grid points right in the image.

    Source: Heikkilä, Geometric camera calibration using circular control points (2000), for the difference.
    """
    level, q = image.astype(np.float64), _find(shown, board)
    if q is None:
        # White circles are dark ones in the negative.
        level, q = level.max() - level, _find(255 - shown, board)
    if q is None:
        return None
    places, radius = board.places(), board.diameter / 2
    seen = _Map.fit(places, q)
    sigma, valid = np.ones(len(q)), np.ones(len(q), bool)
    centre = q.copy()
    for k, place in enumerate(places):
        slope = seen.slope(place[None])[0]
        reach = 0.5 * board.nearest()
        centre[k], sigma[k], valid[k] = _weigh(level, q[k], slope, radius, reach)
    if not valid.all():
        # As with chessboards, the whole grid must be visible.
        return None
    # Subtracted twice, because the map is first fitted to centres that still contain the difference.
    true, shift = centre, np.zeros_like(centre)
    for _ in range(2):
        seen = _Map.fit(places, true)
        shift = _centroids(seen, places, radius) - seen(places)
        true = centre - shift
    return FoundCorners(true, np.hypot(sigma, _CORRECTION_SHARE * np.hypot(*shift.T)), valid)


def _find(image: np.ndarray, board: Circles) -> np.ndarray | None:
    """Rough centres in the board's order."""
    settings = cv2.SimpleBlobDetector.Params()
    settings.minArea = _SMALLEST_AREA_PX
    settings.maxArea = max(4 * _SMALLEST_AREA_PX, image.size / (board.columns * board.rows))
    settings.minDistBetweenBlobs = 3.0
    blobs = cv2.SimpleBlobDetector.create(settings)
    for extra in (0, cv2.CALIB_CB_CLUSTERING):
        kind = cv2.CALIB_CB_SYMMETRIC_GRID if board.layout == "symmetric" else cv2.CALIB_CB_ASYMMETRIC_GRID
        flags = kind | extra
        found, centres = cv2.findCirclesGrid(image, board.grid(), flags=flags, blobDetector=blobs)
        if found:
            return _ordered(np.asarray(centres, np.float64).reshape(-1, 2), board)
    return None


def _ordered(q: np.ndarray, board: Circles) -> np.ndarray | None:
    """The centres in the board's order, or None where no order fits a plane seen from its front."""
    columns, rows = board.grid()
    grid, places = q.reshape(rows, columns, 2), board.places()
    orders = [grid, grid[::-1], grid[:, ::-1], grid[::-1, ::-1]]
    if columns == rows:
        orders += [turned.transpose(1, 0, 2) for turned in orders]
    fitting = []
    for turned in orders:
        flat = np.ascontiguousarray(turned).reshape(-1, 2)
        along, down = (turned[:, -1] - turned[:, 0]).mean(0), (turned[-1] - turned[0]).mean(0)
        error = np.sqrt(np.mean((apply_homography(direct_homography(places, flat), places) - flat) ** 2))
        if along[0] * down[1] - along[1] * down[0] > 0 and error < _MISFIT * np.hypot(*along) / columns:
            fitting.append((-float(along[0]), flat))
    return min(fitting, key=lambda one: one[0])[1] if fitting else None


def _weigh(
    level: np.ndarray, start: np.ndarray, slope: np.ndarray, radius: float, reach: float
) -> tuple[np.ndarray, float, bool]:
    """Centre of the ink's weight, its standard deviation [px], and whether this is a circle."""
    inverse = np.linalg.inv(slope)
    scale = np.sqrt(abs(np.linalg.det(slope)))
    window, paper_from = min(radius + _BLUR_PX / scale, reach), min(radius + _BLUR_PX / scale, 0.9 * reach)
    half = int(np.ceil(reach * np.linalg.norm(slope, 2))) + 1
    centre, noise = start.copy(), 1.0
    for _ in range(_ROUNDS):
        first = np.rint(centre).astype(int)
        box = [slice(max(0, at - half), at + half + 1) for at in first]
        cut = level[box[1], box[0]]
        if cut.size == 0:
            return start, 1.0, False
        v, u = np.mgrid[0 : cut.shape[0], 0 : cut.shape[1]] + np.array([box[1].start, box[0].start])[:, None, None]
        offset = np.stack([u - centre[0], v - centre[1]], -1)
        distance = np.linalg.norm(offset @ inverse.T, axis=-1)
        ring = (distance > paper_from) & (distance <= reach)
        if ring.sum() < _FEWEST_PAPER:
            return start, 1.0, False
        basis = np.stack([np.ones_like(distance), offset[..., 0], offset[..., 1]], -1)
        fit, *_ = np.linalg.lstsq(basis[ring], cut[ring], rcond=None)
        paper = np.maximum(basis @ fit, 1.0)
        noise = max(float(np.std(cut[ring] - paper[ring])), 0.3)
        inside = distance <= window
        # Light that is uneven dims ink and paper alike.
        ink = np.where(inside, 1.0 - cut / paper, 0.0)
        total = float(ink.sum())
        area = np.pi * (radius * scale) ** 2
        if total < _MIN_DARKNESS * _MIN_COVER * area:
            return start, 1.0, False
        centre = centre + (ink[..., None] * offset).sum((0, 1)) / total
        if np.hypot(*(centre - start)) > max(_MAX_MOVE * radius * scale, 1.0):
            return start, 1.0, False
    spread = np.sqrt(((offset**2).sum(-1) / 2 * inside * (noise / paper) ** 2).sum()) / total
    return centre, float(np.hypot(spread, _FLOOR_PX)), True


class _Map(NamedTuple):
    """A map from the board [m] to the image [px]: a homography, and with enough centres a cubic for the lens."""

    homography: np.ndarray
    middle: np.ndarray
    size: float
    cubic: np.ndarray | None

    @staticmethod
    def fit(places: np.ndarray, q: np.ndarray) -> "_Map":
        homography = direct_homography(places, q)
        middle, size = places.mean(0), float(np.abs(places - places.mean(0)).max())
        bare = _Map(homography, middle, size, None)
        if len(places) < _CUBIC_FROM:
            return bare
        rest = np.linalg.lstsq(_powers((places - middle) / size), q - bare(places), rcond=None)[0]
        return bare._replace(cubic=rest)

    def __call__(self, places: np.ndarray) -> np.ndarray:
        q = apply_homography(self.homography, places)
        return q if self.cubic is None else q + _powers((places - self.middle) / self.size) @ self.cubic

    def slope(self, places: np.ndarray) -> np.ndarray:
        """Derivatives of (u, v) by (x, y) [n, 2 (u, v), 2 (x, y)]."""
        step = 1e-4 * self.size
        columns = [(self(places + move) - self(places - move)) / (2 * step) for move in step * np.eye(2)]
        return np.stack(columns, -1)


def _powers(xy: np.ndarray) -> np.ndarray:
    x, y = xy.T
    return np.column_stack([x**i * y**j for i in range(4) for j in range(4 - i)])


def _centroids(seen: _Map, places: np.ndarray, radius: float) -> np.ndarray:
    """Centres of the pictures of circles [n, 2], px: means over rings of equal area."""
    rings, turns = 6, 16
    r = radius * np.sqrt((np.arange(rings) + 0.5) / rings)
    angle = 2 * np.pi * np.arange(turns) / turns
    disc = np.stack([np.outer(r, np.cos(angle)).ravel(), np.outer(r, np.sin(angle)).ravel()], -1)
    points = (places[:, None] + disc).reshape(-1, 2)
    area = np.abs(np.linalg.det(seen.slope(points))).reshape(len(places), -1, 1)
    q = seen(points).reshape(len(places), -1, 2)
    return np.asarray((q * area).sum(1) / area.sum(1))
