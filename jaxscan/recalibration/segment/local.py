"""The neighbourhood of every cell: normal, scatter around it, curvature."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.recalibration.segment.cells import Cells
from jaxscan.recalibration.segment.windows import Windows


_HALF_M = 0.12
"""Half the size of a neighbourhood [m]."""
_LEAST, _MOST = 2, 25
"""Cells in half a neighbourhood."""
_FULL = 0.85
"""Share of the cells of a neighbourhood that must be seen."""
ROUGH_M = 1e-3
"""Roughness of walls that is always allowed [m]."""
_CURVED = 0.08
"""Curvature from which a surface is not flat [1/m]; a calibration that is wrong bends walls by less than half of it."""


class Surroundings(NamedTuple):
    """The neighbourhood of each cell; zero where not `even`."""

    windows: Windows
    half: tuple[Int[np.ndarray, "rows columns"], Int[np.ndarray, "rows columns"]]
    """Half the size of the windows [cells]."""
    normal: Float[np.ndarray, "rows columns 3"]
    """Unit normal, towards the scanner."""
    sigma: Float[np.ndarray, "rows columns"]
    """Standard deviation of a cell along its normal [m], with the factor."""
    scatter: Float[np.ndarray, "rows columns"]
    """RMS distance from the plane of the neighbourhood [m]."""
    even: Bool[np.ndarray, "rows columns"]
    """Where the neighbourhood is full and flat."""
    factor: float
    """By which the scatter exceeds the promise of the sigmas [1]."""


def surroundings(cells: Cells) -> Surroundings:
    """Normals, scatter and flatness of all neighbourhoods."""
    half = _halves(cells)
    windows = Windows.around(*half)
    valid = cells.valid.astype(np.float64)
    count = windows.sums(valid)
    full = cells.valid & (count >= _FULL * windows.area()) & (count >= 9)
    safe = np.maximum(count, 1.0)[..., None]
    mean = windows.sums(cells.p) / safe
    upper = np.triu_indices(3)
    second = windows.sums(cells.p[..., upper[0]] * cells.p[..., upper[1]]) / safe
    second -= mean[..., upper[0]] * mean[..., upper[1]]
    spread = np.zeros((*count.shape, 3, 3))
    spread[..., upper[0], upper[1]] = spread[..., upper[1], upper[0]] = second
    spread[~full] = np.eye(3)
    values, vectors = np.linalg.eigh(spread)
    normal = vectors[..., 0]
    normal *= -np.sign((normal * cells.p).sum(-1))[..., None]
    scatter = np.sqrt(np.maximum(values[..., 0], 0.0) * count / np.maximum(count - 3.0, 1.0))
    promised = cells.across(normal)
    broad = full & (np.sqrt(values[..., 1]) > 3.0 * scatter)
    factor = _factor(scatter[broad] / np.maximum(promised[broad], 1e-9))
    sigma = factor * promised
    limit = sigma**2 * (1.0 + 4.0 * np.sqrt(2.0 / np.maximum(count, 3.0))) + ROUGH_M**2
    even = broad & (scatter**2 < limit)
    even &= ~_curved(cells, normal, even, half, sigma / np.sqrt(np.maximum(count, 1.0)))
    return Surroundings(windows, half, np.where(even[..., None], normal, 0.0), sigma, scatter, even, factor)


def _halves(cells: Cells) -> tuple[np.ndarray, np.ndarray]:
    """Half the size of each neighbourhood, in rows and columns of cells."""
    halves = []
    for axis in (0, 1):
        apart = np.linalg.norm(np.diff(cells.p, axis=axis), axis=-1)
        both = cells.valid[1:] & cells.valid[:-1] if axis == 0 else cells.valid[:, 1:] & cells.valid[:, :-1]
        away = np.linalg.norm(cells.p, axis=-1)
        start = away[:-1] if axis == 0 else away[:, :-1]
        # Steps in angle; over edges they are larger, so the median counts.
        pitch = np.median(apart[both] / start[both]) if both.any() else 1.0
        half = np.round(_HALF_M / np.maximum(pitch * away, 1e-6))
        halves.append(np.where(cells.valid, np.clip(half, _LEAST, _MOST), _LEAST).astype(int))
    return halves[0], halves[1]


def _factor(ratios: np.ndarray) -> float:
    return float(np.clip(np.median(ratios), 1.0, 10.0)) if len(ratios) else 1.0


def _curved(
    cells: Cells,
    normal: np.ndarray,
    even: np.ndarray,
    half: tuple[np.ndarray, np.ndarray],
    sigma: np.ndarray,
) -> np.ndarray:
    """Where normals turn along the surface, in either direction of the grid."""
    rows, columns = even.shape
    i, j = np.broadcast_arrays(np.arange(rows)[:, None], np.arange(columns)[None, :])
    curved = np.zeros_like(even)
    for axis in (0, 1):
        ahead, behind = (_moved(i, j, even, axis, sign * half[axis]) for sign in (1, -1))
        way = cells.p[ahead] - cells.p[behind]
        length = np.linalg.norm(way, axis=-1)
        safe = np.maximum(length, 1e-6)
        turn = np.abs(((normal[ahead] - normal[behind]) * way).sum(-1)) / safe
        # Slopes of a neighbourhood are known to sigma over its own spread.
        noise = 3.0 * np.sqrt(2.0) * sigma * np.sqrt(3.0) / _HALF_M
        curved |= (length > _HALF_M / 2) & (turn > _CURVED * safe + noise)
    return even & curved


def _moved(
    i: np.ndarray, j: np.ndarray, even: np.ndarray, axis: int, step: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The cells `step` further along an axis; the cells themselves where those are not even."""
    rows, columns = even.shape
    further = np.clip(i + step, 0, rows - 1) if axis == 0 else i, np.clip(j + step, 0, columns - 1) if axis else j
    there = even[further]
    return np.where(there, further[0], i), np.where(there, further[1], j)
