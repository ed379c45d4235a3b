"""The cloud as surfaces: neighbouring profiles of one laser from one place, and what lies between their points."""

from typing import NamedTuple

import numpy as np

from jaxscan.errors import MeasurementError
from jaxscan.measurement.samples import Cloud, places_of


MOST_PIXELS = 100_000_000
"""Most pixels of a raster."""
_MOST_AT_ONCE = 4_000_000
_FINEST = 64
"""Most places along a side of a quad at which it is sampled."""


class Quads(NamedTuple):
    """Squares of four neighbours, as cells of the cloud's grid: two profiles, two lines."""

    corners: np.ndarray
    """Cells of the grid, flat [n, 4]: (first profile, line), (first, next line), (second, line), (second, next)."""


def quads_of(cloud: Cloud) -> Quads:
    """All squares of four valid neighbours; profiles are neighbours in the order of their angle.

    Raises:
        MeasurementError: If the cloud has no grid.
    """
    valid = np.asarray(cloud.valid)
    profiles, lines = valid.shape
    if profiles < 2 or lines < 2:
        raise MeasurementError(
            f"The cloud has {profiles} profiles of {lines} lines, so it is unknown which are neighbours; a cloud "
            "of jaxscan reconstruct is needed, as .ply or .npz."
        )
    laser, angle, number = np.asarray(cloud.laser), np.asarray(cloud.angle, np.float64), places_of(cloud).number
    pairs = []
    for station in np.unique(number):
        for one in np.unique(laser[number == station]):
            mine = np.flatnonzero((number == station) & (laser == one))
            mine = mine[np.argsort(angle[mine], kind="stable")]
            pairs.append(np.stack([mine, np.roll(mine, -1)], 1)[: len(mine) if _is_turn(angle[mine]) else -1])
    first, second = np.concatenate(pairs).T
    whole = valid[first, :-1] & valid[first, 1:] & valid[second, :-1] & valid[second, 1:]
    pair, line = np.nonzero(whole)
    start, after = first[pair] * lines + line, second[pair] * lines + line
    return Quads(np.stack([start, start + 1, after, after + 1], 1))


def _is_turn(angle: np.ndarray) -> bool:
    """Whether the last angle [rad] is as near to the first, a turn later, as neighbours are."""
    if len(angle) < 8:
        return False
    step = float(np.median(np.diff(angle)))
    return bool(abs(angle[0] + 2.0 * np.pi - angle[-1]) < 2.0 * step)


class Raster(NamedTuple):
    """Which quad each pixel [rows, columns] shows, and where between its profiles and its lines, 0 to 1."""

    quad: np.ndarray
    """Number of the quad [rows, columns]; -1 where there is none."""
    across: np.ndarray
    along: np.ndarray

    def of(self, quads: Quads, values: np.ndarray) -> np.ndarray:
        """Values of the cells, flat [cells, k], between the corners [rows, columns, k]; any where there is no quad."""
        corners = quads.corners[np.maximum(self.quad, 0)]
        a, b = self.across[..., None], self.along[..., None]
        first = (1 - b) * values[corners[..., 0]] + b * values[corners[..., 1]]
        second = (1 - b) * values[corners[..., 2]] + b * values[corners[..., 3]]
        return (1 - a) * first + a * second

    def nearest(self, quads: Quads) -> np.ndarray:
        """The cell of the nearest corner [rows, columns]; -1 where there is none."""
        corner = 2 * (self.across >= 0.5) + (self.along >= 0.5)
        cell = np.take_along_axis(quads.corners[np.maximum(self.quad, 0)], corner[..., None], -1)[..., 0]
        return np.where(self.quad >= 0, cell, -1)


def rasterise(quads: Quads, places: np.ndarray, shape: tuple[int, int], depth: np.ndarray | None = None) -> Raster:
    """The quads on a raster of so many rows and columns.

    Args:
        quads: The quads.
        places: Column and row of every cell, flat [cells, 2], px: (0, 0) is the middle of the first pixel.
        shape: Rows and columns.
        depth: Depth of every cell [cells]: where two quads meet one pixel, the nearer one is shown; by default any.
    """
    corners = places[quads.corners]
    low, high = corners.min(1), corners.max(1)
    chosen = np.flatnonzero((high > -0.5).all(1) & (low < np.array([shape[1], shape[0]]) - 0.5).all(1))
    # Sampled more finely than the pixels, so that none is missed; in powers of two, so that many quads share a size.
    finer = np.stack([_places(corners[chosen], ((0, 2), (1, 3))), _places(corners[chosen], ((0, 1), (2, 3)))], 1)
    best = np.full(shape[0] * shape[1], np.inf)
    quad, across, along = np.full(best.shape, -1), np.zeros(best.shape), np.zeros(best.shape)
    for counts in np.unique(finer, axis=0):
        a, b = (grid.ravel() for grid in np.meshgrid(*((np.arange(n) + 0.5) / n for n in counts), indexing="ij"))
        mix = np.stack([(1 - a) * (1 - b), (1 - a) * b, a * (1 - b), a * b])
        mine = chosen[(finer == counts).all(1)]
        for part in np.array_split(mine, max(1, len(mine) * len(a) // _MOST_AT_ONCE)):
            at = np.round(np.moveaxis(corners[part], 1, 2) @ mix).astype(np.int64)
            inside = (at[:, 0] >= 0) & (at[:, 0] < shape[1]) & (at[:, 1] >= 0) & (at[:, 1] < shape[0])
            which, sample = np.nonzero(inside)
            pixel = at[which, 0, sample] + shape[1] * at[which, 1, sample]
            near = np.zeros(len(pixel)) if depth is None else (depth[quads.corners[part]] @ mix)[which, sample]
            wins = np.flatnonzero(near < best[pixel])
            if depth is not None:
                # NumPy keeps the last of several values for one pixel: the nearest.
                wins = wins[np.argsort(-near[wins], kind="stable")]
            target = pixel[wins]
            best[target], quad[target] = near[wins], part[which[wins]]
            across[target], along[target] = a[sample[wins]], b[sample[wins]]
    return Raster(quad.reshape(shape), across.reshape(shape), along.reshape(shape))


def _places(corners: np.ndarray, sides: tuple[tuple[int, int], tuple[int, int]]) -> np.ndarray:
    """Number of places at which each quad [n, 4, 2], px, is sampled along two of its sides [n]."""
    longest = np.max([np.abs(corners[:, j] - corners[:, i]).max(1) for i, j in sides], axis=0)
    return np.minimum(2 ** np.ceil(np.log2(np.maximum(1.5 * longest, 1.0))), _FINEST).astype(int)
