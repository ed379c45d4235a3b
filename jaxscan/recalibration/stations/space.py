"""The space around a station: cells with surfaces, and cells through which it looked."""

from typing import NamedTuple

import numpy as np

from jaxscan.recalibration.stations.view import View


CELL_M = 0.1
CELLS = 160
"""Cells along the longest side at most; a large hall has larger ones."""
MARGIN = 2
RAYS = 12_000
UNSEEN, FREE, FILLED, AROUND = 0, 1, 2, 3


class Space(NamedTuple):
    """Cells around a station, in its scanner frame."""

    state: np.ndarray
    """`UNSEEN`, `FREE`, `FILLED`, or `AROUND` filled ones; uint8 [x, y, z]."""
    low: np.ndarray
    """Corner of the first cell [3], m."""
    cell: float
    """[m]."""
    some: np.ndarray
    """One point of each filled cell [n, 3]."""

    def at(self, points: np.ndarray) -> np.ndarray:
        """State of the cells of points [..., 3]."""
        index = np.floor((points - self.low) / self.cell).astype(np.int32)
        inside = ((index >= 0) & (index < self.state.shape)).all(-1)
        index = np.where(inside[..., None], index, 0)
        return np.where(inside, self.state[index[..., 0], index[..., 1], index[..., 2]], UNSEEN)


def see_space(view: View) -> Space:
    """The cells that a view fills and looks through.

    A cell is free where at least two rays went through it and no point is in it or beside it.
    """
    low, high = np.percentile(view.points, [0.2, 99.8], axis=0)
    cell = max(CELL_M, float((high - low).max()) / CELLS)
    low = low - MARGIN * cell
    shape = np.ceil((high - low) / cell).astype(int) + MARGIN
    inside = ((view.points > low) & (view.points < low + shape * cell)).all(1)
    points, eyes = view.points[inside], view.eyes[inside]
    index = np.ravel_multi_index(tuple(((points - low) / cell).astype(int).T), shape)
    _, first = np.unique(index, return_index=True)
    filled = np.zeros(shape, bool)
    filled.flat[index] = True
    passed = _passed(points, eyes, low, cell, shape)
    state = np.where(passed >= 2, FREE, UNSEEN).astype(np.uint8)
    around = _grown(filled)
    state[around] = AROUND
    state[filled] = FILLED
    return Space(state, low, cell, points[first])


def _passed(points: np.ndarray, eyes: np.ndarray, low: np.ndarray, cell: float, shape: np.ndarray) -> np.ndarray:
    """How many rays went through each cell; the last tenth of a ray may graze its surface, and does not count."""
    step = max(1, -(-len(points) // RAYS))
    points, eyes = points[::step], eyes[::step]
    ways = points - eyes
    reach = np.linalg.norm(ways, axis=1)
    end = 0.9 * reach - 1.5 * cell
    passed = np.zeros(int(np.prod(shape)), np.int32)
    for far in np.arange(0.0, max(end.max(), 0.0), 0.7 * cell):
        going = end > far
        at = eyes[going] + ways[going] * (far / reach[going])[:, None]
        index = np.floor((at - low) / cell).astype(int)
        index = index[((index >= 0) & (index < shape)).all(1)]
        passed += np.bincount(np.ravel_multi_index(tuple(index.T), shape), minlength=len(passed)).astype(np.int32)
    return passed.reshape(shape)


def _grown(filled: np.ndarray) -> np.ndarray:
    """The cells of a mask and all that touch them."""
    for axis in range(3):
        ahead, behind = np.roll(filled, 1, axis), np.roll(filled, -1, axis)
        filled = filled | ahead | behind
    return filled
