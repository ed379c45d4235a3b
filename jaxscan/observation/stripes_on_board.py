"""Selection of the stripe points that lie on the board."""

from typing import NamedTuple

import numpy as np

from jaxscan.geometry import AbstractBoard, StripeAxis, apply_homography, direct_homography, stripe_pixel
from jaxscan.observation.corners import FoundCorners
from jaxscan.observation.ink import ink_shift
from jaxscan.stripes import Stripes


# Margin inside the printed area, and largest distance from the found corners, both in squares: farther
# away the map to the board is a guess.
_EDGE_MARGIN = 0.1
_REACH = 1.2
# Points with a larger shift by the print [px] are dropped.
_MAX_INK_SHIFT = 0.35
# Assumed blur of lens and pixels [px].
_BLUR_PX = 0.8
_MIN_POINTS = 8


class FoundStripe(NamedTuple):
    """The stripe of one laser in one image, one entry per line."""

    u: np.ndarray
    """Centre across the line [lines], px."""
    sigma: np.ndarray
    """Standard deviation of `u` [lines], px."""
    width: np.ndarray
    """Standard deviation of the stripe's profile [lines], px."""
    valid: np.ndarray
    """bool [lines]."""
    stripe_axis: StripeAxis = "rows"
    """Whether a line is an image row or an image column."""

    @staticmethod
    def of(stripes: Stripes, profile: int, stripe_axis: StripeAxis) -> "FoundStripe":
        """One profile of many."""
        u, sigma, width, valid = (
            np.asarray(field)[profile] for field in (stripes.u, stripes.sigma, stripes.width, stripes.valid)
        )
        return FoundStripe(u, sigma, width, valid, stripe_axis)

    def pixels(self) -> np.ndarray:
        """float64 [lines, 2]: (u, v) [px]; at 0 of its line where not valid."""
        lines = np.arange(len(self.u), dtype=np.float64)
        centre = np.where(self.valid, self.u, 0.0).astype(np.float64)
        return np.asarray(stripe_pixel(centre, lines, self.stripe_axis))


class BoardStripe(NamedTuple):
    """Stripe points of one laser on one board view, padded with entries that are not valid."""

    q: np.ndarray
    """float64 [points, 2]: (u, v) [px]."""
    sigma: np.ndarray
    """float64 [points]: standard deviation across the stripe [px]."""
    valid: np.ndarray
    """bool [points]."""


def select_board_stripe(
    stripe: FoundStripe,
    corners: FoundCorners,
    board: AbstractBoard,
    *,
    off: np.ndarray | None = None,
    board_xy: np.ndarray | None = None,
    points: int = 512,
) -> BoardStripe:
    """Keep the stripe points that lie on the board, and correct the shift by its print.

    A point is on the board if its board coordinates lie inside the printed area. They come from
    the pose, or before it is known from a map fitted to the corners (homography, and a cubic for
    the lens). Brighter paper shifts the stripe's centre towards it. With a laser-off image the
    shift is predicted and subtracted, and the error of the prediction is added to `sigma`; points
    with a shift of more than 0.35 px are dropped.

    Args:
        stripe: The stripe in one image.
        corners: Corners found on the same board pose.
        board: The board they belong to.
        off: Laser-off image [rows, columns], grey, or None.
        board_xy: Board coordinates of every point from the pose [lines, 2], m; None: by the corners.
        points: Number of points to return; longer stripes are thinned evenly.

    Returns:
        The points; none is valid where fewer than 8 remain.
    """
    q, spread = stripe.pixels(), stripe.sigma.astype(np.float64)
    centre, lines = q.T if stripe.stripe_axis == "rows" else q[:, ::-1].T
    keep = stripe.valid & np.isfinite(centre)
    if board_xy is None:
        keep &= _on_board(q, corners, board)
    else:
        outline, margin = board.outline(), _EDGE_MARGIN * board.square
        keep &= ((board_xy > outline.min(0) + margin) & (board_xy < outline.max(0) - margin)).all(-1)
    if off is not None and keep.any():
        on_board = np.flatnonzero(keep)
        image = off if stripe.stripe_axis == "rows" else off.T
        ink = ink_shift(image, on_board, centre[on_board], stripe.width[on_board].astype(np.float64), _BLUR_PX)
        centre[on_board] -= ink.correction
        spread[on_board] = np.hypot(spread[on_board], ink.sigma)
        keep[on_board] &= np.abs(ink.predicted) <= _MAX_INK_SHIFT
    result = BoardStripe(np.zeros((points, 2)), np.ones(points), np.zeros(points, bool))
    chosen = np.flatnonzero(keep)
    if len(chosen) < _MIN_POINTS:
        return result
    # `sigma` is measured along the line; across a slanted stripe the same error is shorter.
    slope = np.polyfit(lines[chosen] - lines[chosen].mean(), centre[chosen], 1)[0]
    if len(chosen) > points:
        chosen = chosen[np.linspace(0, len(chosen) - 1, points).round().astype(int)]
    result.q[: len(chosen)] = q[chosen]
    result.sigma[: len(chosen)] = spread[chosen] / np.hypot(1.0, slope)
    result.valid[: len(chosen)] = True
    return result


def _on_board(q: np.ndarray, corners: FoundCorners, board: AbstractBoard) -> np.ndarray:
    found = board.corners()[corners.valid, :2]
    xy, outline = _board_map(corners.q[corners.valid], found, q), board.outline()
    low = np.maximum(outline.min(0) + _EDGE_MARGIN * board.square, found.min(0) - _REACH * board.square)
    high = np.minimum(outline.max(0) - _EDGE_MARGIN * board.square, found.max(0) + _REACH * board.square)
    return np.all((xy > low) & (xy < high), axis=1)


def _board_map(corners: np.ndarray, xy: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Board coordinates of pixels, interpolated between corners."""
    homography = direct_homography(corners, xy)
    mapped = apply_homography(homography, q)
    if len(corners) < 30:
        return mapped
    centre, size = corners.mean(0), max(float(np.abs(corners - corners.mean(0)).max()), 1e-12)
    a, b = (corners - centre) / size, (q - centre) / size
    fit = np.linalg.lstsq(_cubic(a), xy - apply_homography(homography, corners), rcond=None)[0]
    # Beyond the corners the cubic diverges; its value at their edge is used there.
    return mapped + _cubic(np.clip(b, a.min(0), a.max(0))) @ fit


def _cubic(points: np.ndarray) -> np.ndarray:
    x, y = points[:, 0], points[:, 1]
    return np.column_stack([x**i * y**j for i in range(4) for j in range(4 - i)])
