"""Corners of a board at predicted places."""

import numpy as np

from jaxscan.geometry import AbstractBoard, Circles
from jaxscan.observation.corner_fit import fit_corners
from jaxscan.observation.corners import FoundCorners, clear_of_markers, is_enough, window_share
from jaxscan.observation.prediction import PredictedCorners


# Smallest projected square [px] whose corners are looked for.
_SMALLEST_PX = 8.0


def redetect_corners(
    image: np.ndarray,
    board: AbstractBoard,
    predicted: PredictedCorners,
    *,
    reach: float,
    first: FoundCorners | None = None,
) -> FoundCorners | None:
    """Fit every corner that should be visible, starting from its prediction.

    Args:
        image: uint8 [rows, columns].
        board: The board in it.
        predicted: Its predicted corners in this view.
        reach: A corner found farther than this from its prediction is rejected [px].
        first: Corners of the first look. They are kept where the fit fails: the solve decides
            about corners that disagree with the prediction.

    Returns:
        The corners, or None where too few are found.

    Source: Duisterhof et al., TartanCalib (2022).
    """
    if isinstance(board, Circles):
        # Centres of circles are measured from the ink alone, so a prediction would change nothing.
        return first
    count = len(predicted.q)
    look = np.flatnonzero(predicted.visible & (predicted.size >= _SMALLEST_PX))
    start, size = predicted.q[look], predicted.size[look]
    fit = fit_corners(
        image,
        start,
        predicted.edges[look],
        window_share(board) * size,
        clear=clear_of_markers(board, size),
        bend=predicted.bend[look],
    )
    near = fit.valid & (np.hypot(*(fit.q - start).T) <= reach)
    q, sigma, valid = np.zeros((count, 2)), np.ones(count), np.zeros(count, bool)
    if first is not None:
        q, sigma, valid = first.q.copy(), first.sigma.copy(), first.valid.copy()
    found = look[near]
    q[found], sigma[found], valid[found] = fit.q[near], fit.sigma[near], True
    return FoundCorners(q, sigma, valid) if is_enough(board, valid) else None
