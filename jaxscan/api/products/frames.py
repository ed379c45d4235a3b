"""Clouds in another frame."""

import dataclasses

import numpy as np
from jaxtyping import Float

from jaxscan.reconstruction import PointCloud, Stations


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
    moved = xyz.astype(np.float64) @ turn.T
    moved += shift
    moved[~valid] = 0.0
    kind = np.float64 if max(moved.max(initial=0.0), -moved.min(initial=0.0)) > _FAR_M else xyz.dtype
    before = cloud.stations
    if before is None:
        before = Stations(np.zeros(len(xyz), np.int32), np.eye(4)[None], np.zeros((1, 6, 6)))
    return dataclasses.replace(
        cloud,
        xyz=moved.astype(kind, copy=False),
        normals=(normals.astype(np.float64) @ turn.T).astype(normals.dtype),
        stations=before._replace(pose=transform @ np.asarray(before.pose, np.float64)),
    )
