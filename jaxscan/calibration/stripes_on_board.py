"""Which points of an extracted stripe lie on the board, and can be trusted there."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from jaxscan.calibration.ink import ink_shift
from jaxscan.calibration.observations import StripeViews
from jaxscan.geometry import AbstractBoard


# A stripe closer to the edge of the printed area than this share of a square is left out, and so
# is one farther than this from any corner that was found: there the map to the board is a guess.
_EDGE_MARGIN = 0.1
_REACH = 1.2
# Where the print moves the centre of a stripe by more than this [px], it is lost.
_MAX_INK_SHIFT = 0.35
# Blur of the lens and the pixels [px] where nothing is known of it.
_BLUR_PX = 0.8
_MIN_POINTS = 8


class BoardStripe(NamedTuple):
    """Stripe points of one laser on one board view, padded with entries that are not valid."""

    q: np.ndarray
    """float64 [points, 2]: (u, v) [px]."""
    sigma: np.ndarray
    """float64 [points]: standard deviation across the stripe [px]."""
    valid: np.ndarray
    """bool [points]."""


def select_board_stripes(
    u: np.ndarray,
    sigma: np.ndarray,
    valid: np.ndarray,
    *,
    corners: np.ndarray,
    corners_valid: np.ndarray,
    board: AbstractBoard,
    off: np.ndarray | None = None,
    width: np.ndarray | float = 1.5,
    stripe_axis: Literal["rows", "columns"] = "rows",
    board_xy: np.ndarray | None = None,
    points: int = 512,
) -> BoardStripe:
    """Keep the stripe points that lie on the board, and put right what its print does to them.

    A point is on the board where its pose puts it inside the printed area; as long as that is not
    known, a map fitted to the corners (homography, and what the lens adds to it as a cubic).
    Brighter paper draws the stripe's centre towards it. Where there is a laser-off image the
    shift is predicted and taken off, with what the prediction errs added to `sigma`; points that
    it would move by more than 0.35 px are dropped.

    Args:
        u: Stripe centre per line [lines], px across the line.
        sigma: Standard deviation of `u` [lines], px.
        valid: [lines].
        corners: Corners found on the same board pose [corners, 2], px.
        corners_valid: [corners].
        board: The board they belong to.
        off: Laser-off image [rows, columns], grey, or None.
        width: Standard deviation of the stripe's profile, one or [lines], px.
        stripe_axis: "rows" where a line is an image row, "columns" where it is a column.
        board_xy: Where the board's pose puts every point [lines, 2], m; None: by the corners.
        points: Number of points to return; longer stripes are thinned evenly.

    Returns:
        The points; none is valid where fewer than 8 remain.
    """
    lines = np.arange(len(u), dtype=np.float64)
    centre = np.where(valid, np.asarray(u, np.float64), 0.0)
    q = np.column_stack([centre, lines] if stripe_axis == "rows" else [lines, centre])
    keep = np.asarray(valid, bool) & np.isfinite(centre)
    if board_xy is None:
        keep &= _on_board(q, np.asarray(corners, np.float64), np.asarray(corners_valid, bool), board)
    else:
        outline, margin = board.outline(), _EDGE_MARGIN * board.square
        keep &= ((board_xy > outline.min(0) + margin) & (board_xy < outline.max(0) - margin)).all(-1)
    spread = np.asarray(sigma, np.float64).copy()
    if off is not None and keep.any():
        image = np.asarray(off) if stripe_axis == "rows" else np.asarray(off).T
        on_board = np.flatnonzero(keep)
        widths = np.broadcast_to(np.asarray(width, np.float64), centre.shape)[on_board]
        ink = ink_shift(image, on_board, centre[on_board], widths, _BLUR_PX)
        centre[on_board] -= ink.correction
        spread[on_board] = np.hypot(spread[on_board], ink.sigma)
        keep[on_board] &= np.abs(ink.predicted) <= _MAX_INK_SHIFT
        q = np.column_stack([centre, lines] if stripe_axis == "rows" else [lines, centre])
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


def stack_stripes(stripes: Sequence[tuple[BoardStripe, int, int]], points: int = 512) -> StripeViews:
    """All stripes of a capture, given as (stripe, row of `BoardViews`, laser); empty ones are left out."""
    kept = [(stripe, view, laser) for stripe, view, laser in stripes if stripe.valid.any()]
    return StripeViews(
        q=np.stack([s.q for s, _, _ in kept]) if kept else np.zeros((0, points, 2)),
        sigma=np.stack([s.sigma for s, _, _ in kept]) if kept else np.zeros((0, points)),
        valid=np.stack([s.valid for s, _, _ in kept]) if kept else np.zeros((0, points), bool),
        view=np.array([view for _, view, _ in kept], np.int32),
        laser=np.array([laser for _, _, laser in kept], np.int32),
    )


def _on_board(q: np.ndarray, corners: np.ndarray, valid: np.ndarray, board: AbstractBoard) -> np.ndarray:
    xy = _board_map(corners[valid], board.corners()[valid, :2], q) / board.square
    outline = board.outline() / board.square
    found = board.corners()[valid, :2] / board.square
    low = np.maximum(outline.min(0) + _EDGE_MARGIN, found.min(0) - _REACH)
    high = np.minimum(outline.max(0) - _EDGE_MARGIN, found.max(0) + _REACH)
    return np.all((xy > low) & (xy < high), axis=1)


def _board_map(corners: np.ndarray, xy: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Board coordinates of pixels, interpolated between corners."""
    centre, size = corners.mean(0), max(float(np.abs(corners - corners.mean(0)).max()), 1e-12)
    a, b = (corners - centre) / size, (q - centre) / size
    scale = max(float(np.abs(xy - xy.mean(0)).max()), 1e-12)
    target = (xy - xy.mean(0)) / scale
    x, one = np.column_stack([a, np.ones(len(a))]), np.zeros((len(a), 3))
    system = np.concatenate(
        [np.hstack([x, one, -target[:, :1] * x]), np.hstack([one, x, -target[:, 1:] * x])],
    )
    homography = np.linalg.svd(system, full_matrices=False)[2][-1].reshape(3, 3)
    mapped_corners, mapped = _apply(homography, a), _apply(homography, b)
    terms = 10 if len(a) >= 30 else 0
    if terms:
        # Beyond the corners the cubic runs away; what the lens adds at the edge is kept there.
        inside = np.clip(b, a.min(0), a.max(0))
        fit = np.linalg.lstsq(_cubic(a), target - mapped_corners, rcond=None)[0]
        mapped = mapped + _cubic(inside) @ fit
    return mapped * scale + xy.mean(0)


def _apply(homography: np.ndarray, points: np.ndarray) -> np.ndarray:
    image = np.column_stack([points, np.ones(len(points))]) @ homography.T
    weight = np.where(np.abs(image[:, 2:]) < 1e-12, 1e-12, image[:, 2:])
    return image[:, :2] / weight


def _cubic(points: np.ndarray) -> np.ndarray:
    x, y = points[:, 0], points[:, 1]
    return np.column_stack([x**i * y**j for i in range(4) for j in range(4 - i)])
