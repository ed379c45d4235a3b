"""Corners of one board in one image: fitted where they were found or are predicted, their edges and their squares."""

import numpy as np

from jaxscan.geometry import AbstractBoard, AprilGrid, Charuco, Circles, fixes_plane
from jaxscan.observation import FoundCorners, PredictedCorners
from jaxscan.vision.corner_fit import fit_corners


SMALL_SQUARE_PX = 12.0
"""Smaller projected squares [px] have fewer edge pixels than a corner needs."""
_WINDOW_SHARE, _SMALL_SHARE = 0.3, 0.5
"""Half side of a window, in squares: such a window stays clear of the next corner; of an AprilGrid, whose small squares
are far from the next ones, in small squares."""
# Side of the smallest squares between tags whose corners are fitted [px].
_LEAST_SMALL_PX = 9.0
# Reach of the blur of a marker's edge [px].
_MARKER_BLUR_PX = 1.5
# Smallest projected square [px] whose corners are looked for.
_SMALLEST_PX = 8.0


def fit_found_corners(image: np.ndarray, found: FoundCorners, board: AbstractBoard) -> FoundCorners:
    """Corners refined by `fit_corners` where its model fits; the others unchanged."""
    edges, known = edge_directions(found.q, found.valid, board)
    sizes = square_sizes(found.q, found.valid, board)
    if isinstance(board, AprilGrid):
        # The least window would reach beyond smaller ones.
        known = known & (sizes >= _LEAST_SMALL_PX)
    use = np.flatnonzero(found.valid & known)
    sizes = sizes[use]
    half = window_share(board) * sizes
    fit = fit_corners(image, found.q[use], edges[use], half, clear=clear_of_markers(board, sizes))
    q, sigma = found.q.copy(), found.sigma.copy()
    q[use[fit.valid]], sigma[use[fit.valid]] = fit.q[fit.valid], fit.sigma[fit.valid]
    return FoundCorners(q, sigma, found.valid)


def refit_corners(
    image: np.ndarray,
    board: AbstractBoard,
    predicted: PredictedCorners,
    reach: float,
    first: FoundCorners | None = None,
) -> FoundCorners | None:
    """Fit every corner that should be visible, starting from its prediction.

    Args:
        image: uint8 or float32 [rows, columns].
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


def window_share(board: AbstractBoard) -> float:
    """Half the side of the window in which a corner is fitted, in squares."""
    return _SMALL_SHARE if isinstance(board, AprilGrid) else _WINDOW_SHARE


def clear_of_markers(board: AbstractBoard, sizes: np.ndarray) -> np.ndarray | None:
    """Distance from both edges [px] within which no marker lies, for squares of `sizes` [px]; None without markers."""
    return np.maximum(marker_gap(board) * sizes - _MARKER_BLUR_PX, 2.0) if isinstance(board, Charuco) else None


def marker_gap(board: Charuco) -> float:
    """Distance of the markers from the edges of their squares, in squares."""
    return 0.5 * (1.0 - board.marker / board.square)


def edge_directions(q: np.ndarray, valid: np.ndarray, board: AbstractBoard) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors [corners, 2 (along x, along y), 2] of the edges at every corner, by its neighbours.

    Returns:
        edges: Edges of the squares; zero where they are not known.
        known: bool [corners]: there is a neighbour along either edge.
    """
    columns, rows = board.grid()
    grid, seen = q.reshape(rows, columns, 2), valid.reshape(rows, columns)
    edges = np.zeros((rows, columns, 2, 2))
    for k, axis in enumerate((1, 0)):
        before, after = _neighbours(axis)
        step = np.where((seen[before] & seen[after])[..., None], grid[after] - grid[before], 0.0)
        edges[(*before, k)] += step
        edges[(*after, k)] += step
    length = np.linalg.norm(edges, axis=-1, keepdims=True)
    edges = edges / np.where(length > 0, length, 1.0)
    return edges.reshape(-1, 2, 2), ((length > 0).all((2, 3)) & seen).ravel()


def square_sizes(q: np.ndarray, valid: np.ndarray, board: AbstractBoard) -> np.ndarray:
    """Shortest side of the projected squares at every corner [px], [corners]."""
    columns, rows = board.grid()
    grid, seen = q.reshape(rows, columns, 2), valid.reshape(rows, columns)
    size = np.full((rows, columns), np.inf)
    for axis in (0, 1):
        a, b = _neighbours(axis)
        side = np.where(seen[a] & seen[b], np.linalg.norm(grid[a] - grid[b], axis=-1), np.inf)
        size[a], size[b] = np.minimum(size[a], side), np.minimum(size[b], side)
    known = np.isfinite(size)
    size[~known] = size[known].min() if known.any() else SMALL_SQUARE_PX
    return size.ravel()


def _neighbours(axis: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Slices of all corners that have a next one along an axis of the grid, and of those next ones."""
    whole, first, second = slice(None), slice(None, -1), slice(1, None)
    return ((first, whole), (second, whole)) if axis == 0 else ((whole, first), (whole, second))


def is_enough(board: AbstractBoard, valid: np.ndarray) -> bool:
    """Whether the valid corners suffice for a pose; `valid` is [corners]."""
    return fixes_plane(board.corners()[valid, :2])
