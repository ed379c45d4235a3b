"""A room as a cloud of `reconstruct`, without a scan."""

import dataclasses

import numpy as np

from jaxscan.reconstruction import PointCloud

from ..measurement.rooms import seen_room


BOX = ((0.0, 0.0), (5.0, 0.0), (5.0, 3.5), (0.0, 3.5))
ELEVATION = 50.0


def made_room(grid=(180, 100), **how):
    """A cloud of a box with a floor of 5 m x 3.5 m."""
    seen = seen_room(BOX, grid=grid, elevation=ELEVATION, **how)
    return PointCloud(
        xyz=seen.xyz,
        rgb=seen.rgb,
        intensity=np.full(grid, 100, np.float32),
        normals=np.zeros((*grid, 3), np.float32),
        sigma_random=seen.sigma_random,
        sigma_systematic=np.zeros(grid, np.float32),
        valid=seen.valid,
        record=np.arange(grid[0]),
        laser=seen.laser,
        angle=seen.angle,
    )


def only(cloud, kept):
    """The same cloud with these cells alone."""
    names = [field.name for field in dataclasses.fields(cloud) if np.ndim(getattr(cloud, field.name)) >= 2]
    emptied = {name: getattr(cloud, name).copy() for name in names}
    for values in emptied.values():
        values[~kept] = 0
    return dataclasses.replace(cloud, **emptied)
