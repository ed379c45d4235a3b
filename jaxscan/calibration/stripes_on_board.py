"""Which stripe points of a board image say where the laser sheet is.

A point counts where it lies on the printed board and where the print under it is even: an edge
under the stripe reflects one side of it more than the other and moves its centre by far more than
its noise.
"""

from typing import NamedTuple

import numpy as np

from jaxscan.geometry import AbstractBoard


class BoardStripe(NamedTuple):
    """Stripe points on one board."""

    q: np.ndarray
    """Centres (u, v) [points, 2], px."""
    sigma: np.ndarray
    """Standard deviation across the stripe [points], px."""


MARGIN_SQUARES = 0.2
"""How far inside the printed outline a point must lie: what a homography, which knows no lens
distortion, may be wrong by at the rim of the board."""
REACH_WIDTHS = 3.0
"""The print must be even as far from the centre as the stripe reaches, in its widths ..."""
REACH_PX = 1.5
"""... and the pixels that blur into it."""
UNEVEN = 0.12
"""Largest accepted range of the print's brightness there, relative to its mean. A gradient g per
pixel moves the centre of a stripe of width w by g w^2, so this is below 0.02 px for any w."""
NOISE_RANGE = 4.0
"""Standard deviations of the noise by which the range may be larger."""


def select_board_stripe(
    u: np.ndarray,
    sigma: np.ndarray,
    width: np.ndarray,
    valid: np.ndarray,
    *,
    corners: np.ndarray,
    corners_valid: np.ndarray,
    board: AbstractBoard,
    off: np.ndarray | None,
    columns: bool = False,
) -> BoardStripe:
    """The usable points of one stripe in one image.

    Args:
        u: Stripe centres of one profile [lines], px.
        sigma: Their standard deviations [lines], px.
        width: Widths of the stripe [lines], px.
        valid: Which of them there are [lines].
        corners: Board corners found in the image [corners, 2], px.
        corners_valid: Which of them were found [corners].
        board: The board.
        off: Grey laser-off image, uint8 [rows, columns]; without one the print cannot be judged
            and every point on the board counts.
        columns: Lines are image columns, `u` counts rows.

    Returns:
        The points, in the order of their lines; perhaps none.
    """
    line = np.flatnonzero(valid)
    across = np.asarray(u, np.float64)[line]
    q = np.column_stack([line, across] if columns else [across, line]).astype(np.float64)
    keep = _on_board(q, board, np.asarray(corners)[corners_valid], board.corners()[corners_valid])
    if off is not None:
        keep &= _even(off.T if columns else off, line, across, np.asarray(width, np.float64)[line])
    return BoardStripe(q[keep], np.asarray(sigma, np.float64)[line][keep])


def _on_board(q: np.ndarray, board: AbstractBoard, corners: np.ndarray, on_board: np.ndarray) -> np.ndarray:
    to_board = _homography(corners, on_board[:, :2])
    mapped = np.column_stack([q, np.ones(len(q))]) @ to_board.T
    in_front = mapped[:, 2] * np.sign(np.median((np.column_stack([corners, np.ones(len(corners))]) @ to_board.T)[:, 2]))
    safe = np.where(in_front > 1e-12, mapped[:, 2], 1.0)
    p = mapped[:, :2] / safe[:, None]
    outline, margin = board.outline(), MARGIN_SQUARES * board.square
    inside = np.all((p > outline.min(0) + margin) & (p < outline.max(0) - margin), axis=1)
    return inside & (in_front > 1e-12)


def _homography(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """The 3 x 3 map of [n, 2] onto [n, 2] points, by the normalised linear method."""

    def normaliser(points: np.ndarray) -> np.ndarray:
        centre, scale = points.mean(0), np.sqrt(2) / max(float(points.std(0).mean()), 1e-12)
        return np.array([[scale, 0, -scale * centre[0]], [0, scale, -scale * centre[1]], [0, 0, 1]])

    S, T = normaliser(source), normaliser(target)
    a = np.column_stack([source, np.ones(len(source))]) @ S.T
    b = np.column_stack([target, np.ones(len(target))]) @ T.T
    zero = np.zeros_like(a)
    rows = np.concatenate([np.hstack([a, zero, -b[:, :1] * a]), np.hstack([zero, a, -b[:, 1:2] * a])])
    h = np.linalg.svd(rows, full_matrices=False)[2][-1].reshape(3, 3)
    return np.linalg.solve(T, h @ S)


def _even(off: np.ndarray, line: np.ndarray, across: np.ndarray, width: np.ndarray) -> np.ndarray:
    """Whether the print is even under the stripe at each point."""
    # Three lines together: the print is even along the stripe too, and the noise is less.
    padded = np.pad(off, ((1, 1), (0, 0)), mode="edge").astype(np.float32)
    smooth = (padded[:-2] + padded[1:-1] + padded[2:]) / 3
    noise = _noise(off) / np.sqrt(3.0)
    reach = REACH_WIDTHS * width + REACH_PX
    most = int(np.ceil(reach.max(initial=1.0)))
    step = np.arange(-most, most + 1)
    at = np.rint(across).astype(int)[:, None] + step
    inside = (at >= 0) & (at < off.shape[1])
    # Neighbouring lines as well: the edge of a square slants into the stripe.
    lowest, highest, total = (np.full(len(line), start) for start in (np.inf, -np.inf, 0.0))
    for beside in (-2, 0, 2):
        values = smooth[np.clip(line + beside, 0, len(off) - 1)[:, None], np.clip(at, 0, off.shape[1] - 1)]
        counts = inside & (np.abs(at - across[:, None]) <= reach[:, None])
        lowest = np.minimum(lowest, np.min(np.where(counts, values, np.inf), axis=1))
        highest = np.maximum(highest, np.max(np.where(counts, values, -np.inf), axis=1))
        total = total + np.mean(values, axis=1, where=counts)
    return inside.all(axis=1) & (highest - lowest <= UNEVEN * total / 3 + NOISE_RANGE * noise)


def _noise(image: np.ndarray) -> float:
    """Standard deviation of the pixel noise, from second differences, which see no gradient."""
    values = image.astype(np.float32)
    second = values[:, 2:] - 2 * values[:, 1:-1] + values[:, :-2]
    # The median forgets the edges; 1.4826 makes it a standard deviation, sqrt(6) is the filter's
    # gain, and a sensor that resolves no noise still rounds.
    return max(1.4826 * float(np.median(np.abs(second))) / np.sqrt(6.0), 1 / np.sqrt(12.0))
