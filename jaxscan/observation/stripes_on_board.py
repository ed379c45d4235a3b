"""Selection of the stripe points that lie on the board."""

from typing import NamedTuple

import numpy as np

from jaxscan.geometry import AbstractBoard, StripeAxis, stripe_pixel
from jaxscan.observation.board_map import BoardMap, FoundCorners, is_on_print
from jaxscan.observation.ink import ink_shift


# Points with a larger shift by the print [px] are dropped.
_MAX_INK_SHIFT = 0.35
# Assumed blur of lens and pixels [px].
_BLUR_PX = 0.8
_MIN_POINTS = 8
# Shifts by the print [px] from which an edge is weak, and strong.
_WEAK_PX, _STRONG_PX = 0.02, 0.1
MOST_POINTS = 512
"""Points that are kept of one stripe."""
EVEN, WEAK, STRONG = 0, 1, 2
"""Contrast classes of stripe points: even print, a weak and a strong edge under the stripe. Their errors differ."""
_BY_SHIFT = 3


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
    contrast: np.ndarray | None = None
    """Contrast class of every line, int8 [lines], where it was fitted through the print; None where it was not."""

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
    contrast: np.ndarray
    """int8 [points]: contrast class, see `CONTRAST_CLASSES`."""


def select_board_stripe(
    stripe: FoundStripe,
    corners: FoundCorners,
    board: AbstractBoard,
    *,
    off: np.ndarray | None = None,
    board_xy: np.ndarray | None = None,
    points: int = MOST_POINTS,
) -> BoardStripe:
    """Keep the stripe points that lie on the board, and correct the shift by its print.

    A point is on the board if its board coordinates lie inside the printed area. They come from
    the pose, or before it is known from a map fitted to the corners (homography, and a cubic for
    the lens). Brighter paper shifts the stripe's centre towards it. With a laser-off image the
    shift is predicted and subtracted, and the error of the prediction is added to `sigma`; points
    with a shift of more than 0.35 px are dropped.

    Args:
        corners: Corners found on the same board pose.
        off: Laser-off image [rows, columns], grey, or None: also where the print is accounted for.
        board_xy: Board coordinates of every point from the pose [lines, 2], m; None: by the corners.
        points: Number of points to return; longer stripes are thinned evenly.

    Returns:
        The points; none is valid where fewer than 8 remain.
    """
    not_fitted = np.full(len(stripe.u), _BY_SHIFT + EVEN, np.int8)
    contrast = not_fitted if stripe.contrast is None else stripe.contrast
    q, spread = stripe.pixels(), stripe.sigma.astype(np.float64)
    centre, lines = q.T if stripe.stripe_axis == "rows" else q[:, ::-1].T
    keep = stripe.valid & np.isfinite(centre)
    if board_xy is None:
        view = BoardMap.of(corners, board)
        board_xy = view.to_board(q)
        keep &= view.is_near(board_xy)
    keep &= is_on_print(board_xy, board)
    if off is not None and keep.any():
        on_board = np.flatnonzero(keep)
        image = off if stripe.stripe_axis == "rows" else off.T
        ink = ink_shift(image, on_board, centre[on_board], stripe.width[on_board].astype(np.float64), _BLUR_PX)
        centre[on_board] -= ink.correction
        spread[on_board] = np.hypot(spread[on_board], ink.sigma)
        keep[on_board] &= np.abs(ink.predicted) <= _MAX_INK_SHIFT
        contrast = not_fitted
        contrast[on_board] += np.digitize(np.abs(ink.predicted), (_WEAK_PX, _STRONG_PX)).astype(np.int8)
    result = BoardStripe(np.zeros((points, 2)), np.ones(points), np.zeros(points, bool), np.zeros(points, np.int8))
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
    result.contrast[: len(chosen)] = contrast[chosen]
    return result
