"""Corners of a board whose place is nearly known: found where they should be, or not at all."""

import numpy as np

from jaxscan.geometry import AbstractBoard
from jaxscan.vision.boards import WINDOW_SHARE, FoundCorners, clear_of_markers, is_enough
from jaxscan.vision.refine import refine_corners


# A square must be projected at least this large [px] for its corners to be looked for again.
_SMALLEST_PX = 8.0


def redetect_corners(
    image: np.ndarray,
    board: AbstractBoard,
    expected: np.ndarray,
    edges: np.ndarray,
    size: np.ndarray,
    visible: np.ndarray,
    *,
    reach: float,
    first: FoundCorners | None = None,
) -> FoundCorners | None:
    """Refine every corner that should be visible, beginning where it should be.

    Args:
        image: uint8 [rows, columns].
        board: What is seen.
        expected: Where the corners should be [corners, 2], px.
        edges: Unit vectors along the two edges at every corner [corners, 2, 2].
        size: Shorter side of a projected square [corners], px.
        visible: Which of them are in the image [corners].
        reach: A corner found farther than this from where it should be is not believed [px].
        first: What was found without knowing where to look. It stands where nothing better is
            found: a corner that disagrees with the expectation is for the solve to judge.

    Returns:
        The corners, or None where too few are found.

    Source: Duisterhof et al., TartanCalib (2022).
    """
    count = len(expected)
    look = np.flatnonzero(visible & (size >= _SMALLEST_PX))
    fit = refine_corners(
        image, expected[look], edges[look], WINDOW_SHARE * size[look], clear=clear_of_markers(board, size[look])
    )
    near = fit.valid & (np.hypot(*(fit.q - expected[look]).T) <= reach)
    q, sigma, valid = np.zeros((count, 2)), np.ones(count), np.zeros(count, bool)
    if first is not None:
        q, sigma, valid = first.q.copy(), first.sigma.copy(), first.valid.copy()
    found = look[near]
    q[found], sigma[found], valid[found] = fit.q[near], fit.sigma[near], True
    return FoundCorners(q, sigma, valid) if is_enough(board, valid) else None
