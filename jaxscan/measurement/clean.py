"""Which points of a cloud are kept: one in each small cube, those in a box, those that have neighbours."""

import numpy as np

from jaxscan.measurement.samples import Cloud


def in_box(cloud: Cloud, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Which cells [profiles, lines] have a point between two corners [3], m."""
    xyz = np.asarray(cloud.xyz)
    return np.asarray(cloud.valid) & ((xyz >= low) & (xyz <= high)).all(-1)


def thinned(cloud: Cloud, side_m: float) -> np.ndarray:
    """Which cells [profiles, lines] are kept so that every cube of this side has one point: its best known one."""
    cells = np.flatnonzero(cloud.valid)
    xyz = np.asarray(cloud.xyz, np.float64).reshape(-1, 3)[cells]
    order = np.argsort(np.asarray(cloud.sigma_random).ravel()[cells], kind="stable")
    cubes = np.floor((xyz[order] - xyz.min(0, initial=np.inf)) / side_m)
    _, first = np.unique(cubes, axis=0, return_index=True)
    return _mask(cloud, cells[order[first]])


def with_neighbours(cloud: Cloud, within_m: float, fewest: int) -> np.ndarray:
    """Which cells [profiles, lines] have a point with at least so many others within a distance [m] of it."""
    # Imported here, because only this needs it.
    from scipy.spatial import cKDTree  # type: ignore[import-untyped]

    cells = np.flatnonzero(cloud.valid)
    if len(cells) <= fewest:
        return _mask(cloud, cells[:0])
    xyz = np.asarray(cloud.xyz, np.float64).reshape(-1, 3)[cells]
    # A point is its own nearest neighbour.
    distance = cKDTree(xyz).query(xyz, [fewest + 1], distance_upper_bound=within_m)[0]
    return _mask(cloud, cells[np.isfinite(distance[:, 0])])


def _mask(cloud: Cloud, cells: np.ndarray) -> np.ndarray:
    kept = np.zeros(np.size(cloud.valid), bool)
    kept[cells] = True
    return kept.reshape(np.shape(cloud.valid))
