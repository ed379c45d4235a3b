"""A surface as triangles."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8


class Mesh(NamedTuple):
    """Triangles with a coloured vertex for each point; scanner frame, metres."""

    vertices: Float[np.ndarray, "n 3"]
    """Positions [m], float32; float64 where the cloud has them."""
    normals: Float[np.ndarray, "n 3"]
    """Unit normals towards the scanner, float32; zero where there is none."""
    rgb: UInt8[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"]
    """Vertices of each triangle, int32; anticlockwise as the scanner sees them."""
    uv: Float[np.ndarray, "n 2"] | None = None
    """Place of each vertex in the texture, float32: from (0, 0), a corner of its first pixel, to (1, 1)."""
    texture: UInt8[np.ndarray, "rows columns 3"] | None = None


class MeshSettings(NamedTuple):
    """How neighbours of the grid are joined.

    Two neighbours are on one surface where the difference of their depths is one that their own slopes explain: it
    lies between the differences by the planes of both points, which is so for any crease between them, widened by
    `sigmas` of their noise and by `bend` of the distance between their rays, across the plane.
    """

    sigmas: float = 3.0
    """Combined standard deviations by which depths may differ beyond what the slopes explain."""
    bend: float = 0.25
    """Departure across the plane of a neighbour, as a share of the distance between the rays: smaller steps are below
    what the grid shows."""
    grazing_deg: float = 80.0
    """Faces whose normal is further from the direction of sight [degrees] are left out."""
    bridge: bool = False
    """Whether single missing cells are filled where the points on both sides are on one surface."""

    def least_cosine(self) -> float:
        """Cosine of the angle between sight and normal."""
        return math.cos(math.radians(self.grazing_deg))


DEFAULT_MESH = MeshSettings()
