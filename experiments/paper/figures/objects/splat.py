"""Pictures of organised clouds, with and without colour, by a depth buffer of small points."""

from typing import NamedTuple

import numpy as np
from scipy import ndimage


BACKGROUND = 247.0
_JOINED_M = 0.012
"""Neighbours on the grid that are farther apart lie on different surfaces."""
_FINE_M = 0.0008
"""Points are added between neighbours until they are as near as this [m]."""
_MOST = 6
"""Most points for each old one, along either axis of the grid."""


class Eye(NamedTuple):
    """A camera that looks at a target."""

    place: np.ndarray
    """[3], m."""
    target: np.ndarray
    """[3], m."""
    focal: float
    """px."""
    size: tuple[int, int]
    """Width and height, px."""


class Surface(NamedTuple):
    """A cloud made dense enough for a picture."""

    points: np.ndarray
    """[n, 3], m."""
    normals: np.ndarray
    """[n, 3]."""
    colours: np.ndarray
    """[n, 3], DN."""


def dense(xyz: np.ndarray, valid: np.ndarray, normals: np.ndarray, rgb: np.ndarray) -> Surface:
    """Points between neighbours of the grid that lie on one surface.

    Args:
        xyz: [profiles, lines, 3], m.
        valid: Which exist.
        normals: Towards the scanner; zero where unknown.
        rgb: Colours.
    """
    fields = [np.asarray(field, np.float32) for field in (xyz, normals, rgb)]
    for axis in (0, 1):
        fields, valid = _filled(fields, valid, axis)
    return Surface(*(field[valid] for field in fields))


def picture(surface: Surface, eye: Eye, *, coloured: bool) -> np.ndarray:
    """Draw a surface.

    Args:
        surface: Dense points.
        eye: The camera.
        coloured: In its colours; otherwise grey, shaded by its normals.

    Returns:
        uint8 [height, width, 3].
    """
    width, height = eye.size
    forward = eye.target - eye.place
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(forward, right), forward]).astype(np.float32)
    local = (surface.points - eye.place.astype(np.float32)) @ axes.T
    u, v = (np.rint(eye.focal * local[:, k] / local[:, 2] + eye.size[k] / 2).astype(int) for k in (0, 1))
    seen = (u >= 0) & (u < width) & (v >= 0) & (v < height) & (local[:, 2] > 0.05)
    order = np.flatnonzero(seen)
    order = order[np.argsort(-local[order, 2], kind="stable")]
    # The nearest point is written last, and stays.
    shown, depth = np.full((height, width, 3), np.nan, np.float32), np.full((height, width), np.nan, np.float32)
    shown[v[order], u[order]] = (surface.colours if coloured else _shaded(surface, right, forward))[order]
    depth[v[order], u[order]] = local[order, 2]
    return _closed(shown, depth)


def _filled(fields: list[np.ndarray], valid: np.ndarray, axis: int) -> tuple[list[np.ndarray], np.ndarray]:
    """Fields on a grid that is finer along an axis."""
    one, two = (tuple(slice(*ends) if k == axis else slice(None) for k in (0, 1)) for ends in ((None, -1), (1, None)))
    xyz = fields[0]
    gap = np.linalg.norm(xyz[two] - xyz[one], axis=-1)
    both = valid[one] & valid[two]
    both &= gap < _JOINED_M
    count = int(np.clip(np.ceil(np.percentile(gap[both], 90) / _FINE_M), 1, _MOST)) if both.any() else 1
    shape = list(valid.shape)
    shape[axis] = count * (shape[axis] - 1)
    new = [np.empty((*shape, 3), np.float32) for _ in fields]
    exists = np.empty(shape, bool)
    for k in range(count):
        share = np.float32(k / count)
        place = tuple(slice(k, None, count) if n == axis else slice(None) for n in (0, 1))
        for field, out in zip(fields, new, strict=True):
            out[place] = (1 - share) * field[one] + share * field[two]
        exists[place] = both if k else valid[one]
    return new, exists


def _shaded(surface: Surface, right: np.ndarray, forward: np.ndarray) -> np.ndarray:
    """Clay in the light of a lamp at the upper left."""
    lamp = -forward - 0.6 * right + np.array([0.0, 0.0, 0.8])
    lamp /= np.linalg.norm(lamp)
    length = np.linalg.norm(surface.normals, axis=1)
    light = np.abs(surface.normals @ lamp) / np.maximum(length, 1e-6)
    light = np.where(length > 0, 0.25 + 0.75 * light, 0.25)
    return (np.array([226.0, 222.0, 214.0]) * light[:, None]).astype(np.float32)


def _closed(shown: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Single empty pixels take the mean of their neighbours; the rest is background."""
    empty = np.isnan(depth)
    weight = ndimage.uniform_filter((~empty).astype(np.float32), 3)
    means = np.stack([ndimage.uniform_filter(np.where(empty, 0, shown[..., k]), 3) for k in range(3)], -1)
    fill = empty & (weight > 0.45)
    shown[fill] = means[fill] / weight[fill][:, None]
    return np.clip(np.where(np.isnan(shown), BACKGROUND, shown), 0, 255).astype(np.uint8)
