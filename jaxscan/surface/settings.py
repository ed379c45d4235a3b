"""The rule by which neighbours belong to one surface."""

import math
from typing import NamedTuple


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
        """Of the angle between sight and normal."""
        return math.cos(math.radians(self.grazing_deg))


DEFAULT_MESH = MeshSettings()
