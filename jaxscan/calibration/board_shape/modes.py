"""The modes of a board's shape: smooth ones first, then those that free every corner."""

import numpy as np
from jaxtyping import Float

from jaxscan.calibration.solve.problem import BoardModes
from jaxscan.geometry import bend_functions


PRINT_DEGREE = 3
"""Highest degree of the polynomials by which a print may be out of place."""
# Root mean square size [m] that a mode is expected to have: heights of degree 2, prints of degree 1,
# both less by a factor per degree, and single corners.
_HEIGHT, _PRINT, _FALL, _CORNER = 4e-4, 1e-4, 0.6, 5e-5
# Part of a function that is left beside the functions before it, below which it is one of them.
_DEPENDENT = 1e-6
_HEIGHTS, _PRINTS = 23, 16
# The number of modes is rounded up to this, so that boards of about the same size share a compilation.
_STEP = 48


def smooth_modes(board: np.ndarray, frame: np.ndarray, padded: int) -> BoardModes:
    """Heights and prints that are polynomials.

    Heights hold no plane and no bow along x or y, prints no motion of the plane and no scale: those
    are unknowns of their own. Over the corners all are orthogonal.

    Args:
        board: Corners of the flat board [corners, 3], m.
        frame: Its `corner_frame`.
        padded: Corners that the solve has, with padding.
    """
    place = (board[:, :2] - frame[:2]) / frame[2:]
    functions = np.stack(bend_functions(place), axis=-1)
    degree = _degrees(functions.shape[1])
    order = sorted(range(len(degree)), key=lambda i: (degree[i] > 1 and not _is_bow(degree, i), degree[i]))
    taken, combined = _orthogonal(functions[:, order])
    heights = [i for i in range(len(taken)) if degree[order[taken[i]]] > 1 and not _is_bow(degree, order[taken[i]])]
    size = np.array([_HEIGHT * _FALL ** (degree[order[taken[i]]] - 2) for i in heights])
    coefficients = np.zeros((_HEIGHTS, functions.shape[1]))
    coefficients[: len(heights), order] = (combined[:, heights] * size).T
    corner = np.zeros((padded, 3, _HEIGHTS + _PRINTS))
    corner[: len(board), 2, :_HEIGHTS] = functions @ coefficients.T
    prints = _prints(board, functions[:, degree <= PRINT_DEGREE], degree)
    corner[: len(board), :2, _HEIGHTS : _HEIGHTS + prints.shape[-1]] = prints
    return BoardModes(corner, coefficients)


def bent_modes(smooth: BoardModes) -> BoardModes:
    """The smooth modes that are heights; the others move nothing, so that the solve has the same size."""
    corner = smooth.corner.copy()
    corner[..., len(smooth.height) :] = 0.0
    return BoardModes(corner, smooth.height)


def corner_modes(smooth: BoardModes, board: np.ndarray, frame: np.ndarray) -> BoardModes:
    """The smooth modes, and with them every place and height that the corners of a board can have.

    The remainder beside the smooth modes belongs to single corners: between corners it is 0.
    """
    count, padded = len(board), len(smooth.corner)
    own = smooth.corner[:count]
    place = (board[:, :2] - frame[:2]) / frame[2:]
    plane = np.stack(bend_functions(place), axis=-1)[:, [0, 1, 2, 3, 5]]
    height = _complement(np.concatenate([plane, own[:, 2, :_HEIGHTS]], axis=1))
    shifts = np.concatenate([_motions(board), own[:, :2].reshape(2 * count, -1)], axis=1)
    shift = _complement(shifts).reshape(count, 2, -1)
    free = height.shape[1] + shift.shape[2]
    extra = np.zeros((padded, 3, -(-free // _STEP) * _STEP))
    extra[:count, 2, : height.shape[1]] = _CORNER * height
    extra[:count, :2, height.shape[1] : free] = _CORNER * shift
    return BoardModes(np.concatenate([smooth.corner, extra], axis=-1), smooth.height)


def _degrees(count: int) -> np.ndarray:
    """Total degree of each of `bend_functions`."""
    return np.array([degree for degree in range(count) for _ in range(degree + 1)][:count])


def _is_bow(degree: np.ndarray, index: int) -> bool:
    """Whether a function is a square of x alone or of y alone."""
    return bool(degree[index] == 2) and index != 4


def _prints(board: np.ndarray, functions: np.ndarray, degree: np.ndarray) -> Float[np.ndarray, "corners 2 prints"]:
    zero = np.zeros_like(functions)
    pairs = np.stack([np.stack([functions, zero], 1), np.stack([zero, functions], 1)], axis=-1)
    fields = pairs.reshape(2 * len(board), -1)
    motions = _motions(board)
    taken, combined = _orthogonal(np.concatenate([motions, fields], axis=1))
    kept = [i for i, column in enumerate(taken) if column >= motions.shape[1]]
    of = np.repeat(degree[: functions.shape[1]], 2)
    size = np.array([_PRINT * _FALL ** (of[taken[i] - motions.shape[1]] - 1) for i in kept])
    unit = np.concatenate([motions, fields], axis=1) @ combined[:, kept]
    return (unit * size).reshape(len(board), 2, -1)


def _motions(board: np.ndarray) -> Float[np.ndarray, "rows 4"]:
    """Shifts of the corners in the plane by two motions, a turn, and a change of scale; x and y of each corner."""
    x, y = (board[:, :2] - board[:, :2].mean(0)).T
    one, zero = np.ones_like(x), np.zeros_like(x)
    pairs = ((one, zero), (zero, one), (-y, x), (x, y))
    return np.stack([np.stack(pair, -1).ravel() for pair in pairs], axis=-1)


def _orthogonal(columns: Float[np.ndarray, "rows n"]) -> tuple[list[int], Float[np.ndarray, "n m"]]:
    """Of the columns, in order, those that are not combinations of others before, made orthogonal.

    Returns:
        Their indices, and the combinations of columns that are orthogonal, of root mean square 1.
    """
    size = np.linalg.norm(columns, axis=0)
    taken: list[int] = []
    units, combined = np.zeros((len(columns), 0)), np.zeros((columns.shape[1], 0))
    for index in range(columns.shape[1]):
        rest, how = columns[:, index] / size[index], np.eye(columns.shape[1])[index] / size[index]
        for _ in range(2):
            parts = units.T @ rest
            rest, how = rest - units @ parts, how - combined @ parts
        left = float(np.linalg.norm(rest))
        if left > _DEPENDENT:
            taken.append(index)
            units = np.column_stack([units, rest / left])
            combined = np.column_stack([combined, how / left])
    return taken, combined * np.sqrt(len(columns))


def _complement(columns: Float[np.ndarray, "rows n"]) -> Float[np.ndarray, "rows m"]:
    """An orthonormal basis of all that is orthogonal to some columns, of which some may be 0."""
    size = np.linalg.norm(columns, axis=0)
    unit = columns[:, size > 0] / size[size > 0]
    vectors, values, _ = np.linalg.svd(unit, full_matrices=True)
    return vectors[:, int(np.count_nonzero(values > _DEPENDENT)) :]
