"""The grid [profile, line] of a sweep as a surface: planes about its cells, and which cells are one surface."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int


class Windows(NamedTuple):
    """A window around every cell, cut off at the ends of the grid."""

    top: Int[np.ndarray, "rows columns"]
    bottom: Int[np.ndarray, "rows columns"]
    left: Int[np.ndarray, "rows columns"]
    right: Int[np.ndarray, "rows columns"]

    @staticmethod
    def around(half_rows: Int[np.ndarray, "rows columns"], half_columns: Int[np.ndarray, "rows columns"]) -> "Windows":
        """Windows of 2 half + 1 cells in either direction."""
        rows, columns = half_rows.shape
        i, j = np.arange(rows)[:, None], np.arange(columns)[None, :]
        return Windows(
            np.maximum(i - half_rows, 0),
            np.minimum(i + half_rows + 1, rows),
            np.maximum(j - half_columns, 0),
            np.minimum(j + half_columns + 1, columns),
        )

    def sums(self, field: np.ndarray) -> Float[np.ndarray, "rows columns *more"]:
        """Sums of a field [rows, columns, ...] over each window."""
        s = np.zeros((field.shape[0] + 1, field.shape[1] + 1, *field.shape[2:]))
        s[1:, 1:] = field.cumsum(0, dtype=np.float64).cumsum(1)
        top, bottom, left, right = self
        return s[bottom, right] - s[top, right] - s[bottom, left] + s[top, left]

    def area(self) -> Int[np.ndarray, "rows columns"]:
        """Cells of each window."""
        return (self.bottom - self.top) * (self.right - self.left)


class WindowPlanes(NamedTuple):
    """The plane of least squares through the points of each window."""

    points: Float[np.ndarray, "rows columns"]
    normal: Float[np.ndarray, "rows columns 3"]
    """Unit normal, towards the origin; 0 in cells without a point."""
    variance: Float[np.ndarray, "rows columns 3"]
    """Mean square distance of the points from their mean along the normal and along two axes of the plane, the least
    first [m^2]."""


def window_planes(
    p: Float[np.ndarray, "rows columns 3"], valid: Bool[np.ndarray, "rows columns"], windows: Windows
) -> WindowPlanes:
    """Planes through the valid points of all windows, by their moments."""
    p = np.where(valid[..., None], p, 0.0)
    count = windows.sums(valid.astype(np.float64))
    safe = np.maximum(count, 1.0)[..., None]
    mean, (a, b) = windows.sums(p) / safe, np.triu_indices(3)
    second = windows.sums(p[..., a] * p[..., b]) / safe - mean[..., a] * mean[..., b]
    spread = np.zeros((*count.shape, 3, 3))
    spread[..., a, b] = spread[..., b, a] = second
    variance, axes = np.linalg.eigh(spread)
    normal = axes[..., 0]
    normal = normal * -np.sign((normal * p).sum(-1))[..., None]
    return WindowPlanes(count, normal, np.maximum(variance, 0.0))


def smooth_parts(
    p: Float[np.ndarray, "rows columns 3"],
    normal: Float[np.ndarray, "rows columns 3"],
    even: Bool[np.ndarray, "rows columns"],
    slack: Float[np.ndarray, "rows columns"],
    cosine: float,
) -> Int[np.ndarray, "rows columns"]:
    """Number of the smooth part of the grid that each cell belongs to; -1 where not even.

    Normals of neighbours are at least as near as `cosine` says, and they lie off each other's planes by the sum of
    their slacks at most [m].
    """
    # Imported here, so that nobody who does not recalibrate loads SciPy.
    from scipy.sparse import coo_matrix  # type: ignore[import-untyped]
    from scipy.sparse.csgraph import connected_components  # type: ignore[import-untyped]

    index, pairs = np.arange(even.size).reshape(even.shape), []
    for here, there in ((np.s_[:-1], np.s_[1:]), (np.s_[:, :-1], np.s_[:, 1:])):
        way = p[there] - p[here]
        off = np.maximum(np.abs((normal[here] * way).sum(-1)), np.abs((normal[there] * way).sum(-1)))
        alike = (normal[here] * normal[there]).sum(-1) > cosine
        link = even[here] & even[there] & alike & (off < slack[here] + slack[there])
        pairs.append(np.stack([index[here][link], index[there][link]]))
    first, second = np.concatenate(pairs, axis=1)
    graph = coo_matrix((np.ones(len(first), bool), (first, second)), shape=(even.size, even.size))
    label = connected_components(graph, directed=False)[1].reshape(even.shape)
    return np.where(even, label, -1)


def spread_over(numbers: Int[np.ndarray, " n"], count: int) -> Int[np.ndarray, " some"]:
    """So many of the numbers at most, evenly."""
    return numbers[np.unique(np.linspace(0, len(numbers) - 1, min(count, len(numbers))).round().astype(int))]
