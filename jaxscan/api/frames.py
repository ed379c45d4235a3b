"""Clouds in another frame."""

import dataclasses
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from jaxscan.reconstruction import PointCloud, Stations


_AT_ONCE = 1 << 18
"""Points that are turned together: in float64 all of a cloud are twice as large as it."""
_FAR_M = 1000.0
"""Coordinates beyond this keep a tenth of a millimetre in float64 alone."""


def align_cloud(cloud: PointCloud, transform: Float[np.ndarray, "4 4"]) -> PointCloud:
    """A cloud in another frame: points, normals, and the places that it was taken from.

    Args:
        cloud: The cloud [m].
        transform: T_site_scanner [4, 4], as `align_targets` and `align_room` find it.

    Returns:
        The cloud in the frame of the site; float64 where coordinates are large. Its `stations` say where the scanner
        stood, which E57, PTX, PLY and NPZ keep.
    """
    turn, shift = transform[:3, :3], transform[:3, 3]
    xyz, normals, valid = np.asarray(cloud.xyz), np.asarray(cloud.normals), np.asarray(cloud.valid)
    far = max((np.abs(block).max(initial=0.0) for block in _blocks(xyz, valid, turn, shift)), default=0.0)
    moved = np.empty(xyz.shape, np.float64 if far > _FAR_M else xyz.dtype)
    turned = np.empty_like(normals)
    for target, values, offset in ((moved, xyz, shift), (turned, normals, np.zeros(3))):
        flat = target.reshape(-1, 3)
        for number, block in enumerate(_blocks(values, valid, turn, offset)):
            flat[number * _AT_ONCE : number * _AT_ONCE + len(block)] = block
    before = cloud.stations
    if before is None:
        before = Stations(np.zeros(len(xyz), np.int32), np.eye(4)[None], np.zeros((1, 6, 6)))
    return dataclasses.replace(
        cloud,
        xyz=moved,
        normals=turned,
        stations=before._replace(pose=transform @ np.asarray(before.pose, np.float64)),
    )


def _blocks(values: np.ndarray, valid: np.ndarray, turn: np.ndarray, shift: np.ndarray) -> Iterator[np.ndarray]:
    """Vectors [profiles, lines, 3], turned and shifted, some at a time, float64 [n, 3]; zero without a point."""
    flat, seen = values.reshape(-1, 3), valid.reshape(-1)
    for start in range(0, len(flat), _AT_ONCE):
        part = slice(start, start + _AT_ONCE)
        block = flat[part].astype(np.float64) @ turn.T + shift
        block[~seen[part]] = 0.0
        yield block
