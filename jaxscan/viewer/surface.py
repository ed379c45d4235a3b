"""The surface between the points of a cloud, as triangles that a page draws."""

from typing import NamedTuple

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.surface import faces_of_cloud, mesh_grid
from jaxscan.viewer.shown import ShownCloud


_MOST_POINTS = 3_000_000
"""Of a cloud whose surface a page draws."""


class Surface(NamedTuple):
    """Triangles between neighbours of the grid that are on one surface."""

    points: np.ndarray
    """The point of each corner, in the order in which they are shown, int [n]."""
    faces: np.ndarray
    """Corners of each triangle, anticlockwise as the scanner saw them, uint32 [m, 3]."""


def has_grid(shown: ShownCloud) -> bool:
    """Whether a cloud has a grid on which neighbours may be joined."""
    cloud = shown.cloud
    return min(cloud.valid.shape) > 1 and bool(np.ptp(np.asarray(cloud.angle)) > 0) and shown.points <= _MOST_POINTS


def surface_of(shown: ShownCloud) -> Surface:
    """Join the neighbours of a cloud's grid, as `jaxscan mesh` does.

    Raises:
        CloudError: If it has no grid, or no neighbours are on one surface.
    """
    if not has_grid(shown):
        raise CloudError(f"{shown.name}: has no surface to show: it needs a grid, and 3 million points at most.")
    places, faces = faces_of_cloud(mesh_grid(shown.cloud))
    number = np.zeros(shown.cloud.valid.size, np.int32)
    number[shown.cells] = np.arange(shown.points, dtype=np.int32)
    return Surface(number[places], faces.astype("<u4"))


def surface_bytes(shown: ShownCloud, surface: Surface) -> bytes:
    """Counts of corners and triangles, uint32; places about the scene's origin, float32; normals, int8 with a fourth
    byte each; triangles, uint32.
    """
    normals = np.zeros((len(surface.points), 4), np.int8)
    normals[:, :3] = np.rint(127 * np.clip(shown.take(shown.cloud.normals)[surface.points], -1, 1))
    counts = np.array([len(surface.points), len(surface.faces)], "<u4")
    parts = (counts, shown.xyz[surface.points].astype("<f4"), normals, surface.faces)
    return b"".join(np.ascontiguousarray(part).tobytes() for part in parts)
