"""Flat patches of the room on the grid [profile, line], with a tolerance that a faulty table does not break."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int


HALF = 2
"""Cells on each side of a cell in whose window its normal is taken."""
FLATNESS = 0.001
"""Part of the range by which a window may depart from its plane, beside noise."""
BEND = np.cos(np.deg2rad(2.5))
"""Cosine of the angle between the normals of neighbours on one patch."""
SAME = 0.005
"""Part of the range by which the distances of two parts of one wall from the axis may differ."""
LEAST_CELLS = 40
FOLD = np.deg2rad(6.0)
"""Largest turn about the axis between two parts of a wall that a lost step has broken."""


class Grid(NamedTuple):
    """Points on a coarse grid of one laser."""

    x: Float[np.ndarray, "profiles lines 3"]
    """Points in the room [m]."""
    noise: Float[np.ndarray, "profiles lines 3"]
    """Their displacement by one sigma of the stripe [m]."""
    valid: Bool[np.ndarray, "profiles lines"]


class Plane(NamedTuple):
    """A plane `normal . x = distance`."""

    normal: Float[np.ndarray, "3"]
    distance: float
    centre: Float[np.ndarray, "3"]


def find_patches(grid: Grid) -> Int[np.ndarray, "profiles lines"]:
    """Number of the flat patch of each point; -1: none.

    Neighbours belong together where windows about them are flat and have nearly the same plane. Parts of one wall that
    a lost step turned against each other, or that furniture divides, get one number.
    """
    normal, flat = normals(grid)
    labels = _connect(grid, normal, flat)
    numbers, counts = np.unique(labels[labels >= 0], return_counts=True)
    planes = {}
    for number in numbers[counts >= LEAST_CELLS].tolist():
        plane = fit(grid.x[labels == number])
        if plane is not None:
            planes[number] = plane
    return _join(grid, labels, planes)


def fit(x: Float[np.ndarray, "points 3"]) -> Plane | None:
    """The plane of least squares, with less weight for points that are far from it; None where there is none."""
    weight = np.ones(len(x))
    for _ in range(4):
        centre = weight @ x / weight.sum()
        spread = (x - centre) * np.sqrt(weight)[:, None]
        values, vectors = np.linalg.eigh(spread.T @ spread / weight.sum())
        error = (x - centre) @ vectors[:, 0]
        weight = 1.0 / (1.0 + (error / (3.0 * np.median(np.abs(error)) + 1e-6)) ** 2)
    if values[1] < 4.0 * values[0] or not np.isfinite(values).all():
        return None
    normal = vectors[:, 0] * (np.sign(vectors[:, 0] @ centre) or 1.0)
    return Plane(normal, float(normal @ centre), centre)


def normals(grid: Grid) -> tuple[Float[np.ndarray, "profiles lines 3"], Bool[np.ndarray, "profiles lines"]]:
    """Normal of the window about each cell, away from the axis, and whether that window is flat."""
    mask = grid.valid.astype(float)
    x = np.where(grid.valid[..., None], grid.x, 0.0)
    size = np.linalg.norm(x, axis=-1)
    count = _windows(mask)
    safe = np.maximum(count, 1.0)
    mean = _windows(x) / safe[..., None]
    second = _windows(x[..., :, None] * x[..., None, :]) / safe[..., None, None]
    covariance = second - mean[..., :, None] * mean[..., None, :]
    values, vectors = np.linalg.eigh(covariance)
    normal = vectors[..., 0]
    normal = normal * np.where(np.sum(normal * x, axis=-1) < 0, -1.0, 1.0)[..., None]
    noise = np.abs(np.sum(normal * grid.noise, axis=-1))
    along = np.linalg.norm(grid.noise, axis=-1)
    thin = np.sqrt(np.maximum(values[..., 0], 0.0)) < 1.5 * noise + FLATNESS * size
    wide = np.sqrt(np.maximum(values[..., 1], 0.0)) > 3.0 * noise + 5.0 * FLATNESS * size
    enough = count >= 0.6 * (2 * HALF + 1) ** 2
    return normal, grid.valid & thin & wide & enough & (noise > 0.1 * along)


def _windows(values: np.ndarray) -> np.ndarray:
    """Sums over windows of the first two axes."""
    for axis in (0, 1):
        pad = [(HALF + 1, HALF) if k == axis else (0, 0) for k in range(values.ndim)]
        sums = np.cumsum(np.pad(values, pad), axis=axis)
        high = np.take(sums, range(2 * HALF + 1, sums.shape[axis]), axis=axis)
        low = np.take(sums, range(0, sums.shape[axis] - 2 * HALF - 1), axis=axis)
        values = high - low
    return values


def _connect(grid: Grid, normal: np.ndarray, flat: np.ndarray) -> np.ndarray:
    """Numbers of connected cells, by the smallest index among them; -1 where not flat."""
    count = flat.size
    index = np.arange(count).reshape(flat.shape)
    first, second = [], []
    for near, far in ((np.s_[:-1, :], np.s_[1:, :]), (np.s_[:, :-1], np.s_[:, 1:])):
        step = grid.x[far] - grid.x[near]
        size = 0.5 * (np.linalg.norm(grid.x[far], axis=-1) + np.linalg.norm(grid.x[near], axis=-1))
        off = np.maximum(
            np.abs(np.sum(step * normal[near], axis=-1)) - 4 * np.abs(np.sum(grid.noise[near] * normal[near], axis=-1)),
            np.abs(np.sum(step * normal[far], axis=-1)) - 4 * np.abs(np.sum(grid.noise[far] * normal[far], axis=-1)),
        )
        same = (
            flat[near] & flat[far] & (np.sum(normal[near] * normal[far], axis=-1) > BEND) & (off < 4 * FLATNESS * size)
        )
        first.append(index[near][same])
        second.append(index[far][same])
    a, b = np.concatenate(first), np.concatenate(second)
    label = np.arange(count)
    while True:
        smaller = label.copy()
        np.minimum.at(smaller, a, label[b])
        np.minimum.at(smaller, b, label[a])
        # The smallest number of a chain is passed on by doubling.
        smaller = np.minimum(smaller, smaller[smaller])
        if np.array_equal(smaller, label):
            return np.where(flat, label.reshape(flat.shape), -1)
        label = smaller


def _join(grid: Grid, labels: np.ndarray, planes: dict[int, Plane]) -> np.ndarray:
    """Patches as numbers from 0, where parts of one wall have one number."""
    names = sorted(planes, key=lambda number: -np.count_nonzero(labels == number))
    result = np.full(labels.shape, -1)
    parent: dict[int, int] = {}
    points = {number: grid.x[labels == number] for number in names}
    for count, number in enumerate(names):
        other = next(
            (n for n in names[:count] if _one_wall(planes[number], planes[n], points[number], points[n])), None
        )
        parent[number] = number if other is None else parent[other]
    for count, root in enumerate(sorted(set(parent.values()))):
        for number in names:
            if parent[number] == root:
                result[labels == number] = count
    return result


def _one_wall(a: Plane, b: Plane, x: np.ndarray, y: np.ndarray) -> bool:
    """Whether a turn about the axis makes one plane of two, and they are neighbours."""
    upright_a, upright_b = np.hypot(*a.normal[:2]), np.hypot(*b.normal[:2])
    if min(upright_a, upright_b) < 0.5:
        # A turn about the axis leaves a floor where it is.
        near = abs(a.distance - b.distance) < SAME * np.linalg.norm(a.centre)
        return bool(near and a.normal @ b.normal > BEND)
    turn = np.arctan2(a.normal[1], a.normal[0]) - np.arctan2(b.normal[1], b.normal[0])
    turn = (turn + np.pi) % (2 * np.pi) - np.pi
    tilt = np.arcsin(np.clip(a.normal[2], -1, 1)) - np.arcsin(np.clip(b.normal[2], -1, 1))
    size = max(np.linalg.norm(a.centre), np.linalg.norm(b.centre))
    if abs(turn) > FOLD or abs(tilt) > np.deg2rad(2.5) or abs(a.distance - b.distance) > SAME * size:
        return False
    along = np.cross([0.0, 0.0, 1.0], a.normal)
    s, t = x @ along, y @ along
    gap = max(np.min(s) - np.max(t), np.min(t) - np.max(s))
    return bool(gap < 0.25 * size)
