"""A surface as triangles."""

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
    """The picture on the surface, RGB."""
