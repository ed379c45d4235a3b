"""Edges of the scene's facets: between them a picture sees one plane.

A facet is the part of a plane that has one surface. Where no edge of any facet crosses a part of a picture, all of it
shows one facet: any other that reached into that part would cover the whole of it, in front or behind.
"""

from functools import cached_property
from typing import NamedTuple

import numpy as np

from jaxscan.simulation.scene.meshes import Mesh


_SAME = 1e6
"""Planes and corners are told apart to one part of this: a micrometre."""


class Outline:
    """Facets and edges of a mesh; found when they are first asked for."""

    def __init__(self, mesh: Mesh, normal: np.ndarray) -> None:
        """`normal` is that of every triangle, float64 [triangles, 3]."""
        self._mesh, self.normal = mesh, normal

    @cached_property
    def corners(self) -> np.ndarray:
        """Of all triangles [triangles, 3, 3], m."""
        return np.concatenate(self._mesh.triangles)

    @cached_property
    def facet(self) -> np.ndarray:
        """Facet of every triangle, int64 [triangles + 1]; the last entry is for rays that hit nothing."""
        surface = np.repeat(np.arange(len(self._mesh.triangles)), [len(part) for part in self._mesh.triangles])
        offset = np.sum(self.normal * self.corners[:, 0], -1)
        keys = np.column_stack([surface, np.rint(np.column_stack([self.normal, offset]) * _SAME)])
        _, facet = np.unique(keys.astype(np.int64), axis=0, return_inverse=True)
        return np.append(facet.ravel(), -1)

    @cached_property
    def _box(self) -> np.ndarray:
        """The corners of the box round all triangles [8, 3]."""
        low, high = self.corners.min((0, 1)), self.corners.max((0, 1))
        return np.where(np.indices((2, 2, 2)).reshape(3, 8).T == 0, low, high)

    def farthest(self, place: np.ndarray) -> float:
        """Distance from a place [3] that no point of the mesh exceeds [m]."""
        return float(np.linalg.norm(self._box - place, axis=-1).max())

    @cached_property
    def edges(self) -> np.ndarray:
        """Ends of the edges between facets, [edges, 2, 3], m."""
        ends = np.stack([self.corners, np.roll(self.corners, -1, 1)], 2).reshape(-1, 2, 3)
        places = np.rint(ends * _SAME).astype(np.int64)
        _, point = np.unique(places.reshape(-1, 3), axis=0, return_inverse=True)
        pair = np.sort(point.reshape(-1, 2), 1)
        # An edge that two triangles of one facet share, as the diagonal of a quad, is none.
        _, first, count = np.unique(
            np.column_stack([self.facet[:-1].repeat(3), pair]), axis=0, return_index=True, return_counts=True
        )
        kept = first[count == 1]
        _, once = np.unique(pair[kept], axis=0, return_index=True)
        return ends[kept[once]]


class Cone(NamedTuple):
    """Directions within an angle of an axis."""

    axis: np.ndarray
    """Unit vector [3]."""
    half: float
    """The angle [rad]."""


def points_on(edges: np.ndarray, eye: np.ndarray, step: float, cone: Cone) -> np.ndarray:
    """Points of edges, no farther apart than an angle, as an eye sees them.

    Args:
        edges: Their ends [n, 2, 3], m.
        eye: Where they are seen from [3].
        step: The angle [rad].
        cone: The field of view; points outside may be missing.

    Returns:
        [points, 3], m.
    """
    edges = edges[_within(edges, eye, step, cone)]
    legs = edges - eye
    far = np.maximum(np.sqrt(np.einsum("nij,nij->ni", legs, legs)), 1e-9)
    ways = legs / far[..., None]
    between = np.arctan2(
        np.linalg.norm(np.cross(ways[:, 0], ways[:, 1]), axis=-1), np.einsum("ni,ni->n", ways[:, 0], ways[:, 1])
    )
    aside = np.arccos(np.clip(ways @ cone.axis, -1, 1)).min(1)
    # An edge that is seen under an angle reaches no farther into the cone than half of it from its nearer end.
    near = aside - between / 2 < cone.half + step
    far, ways, between = far[near], ways[near], between[near]
    counts = np.ceil(between / step).astype(int) + 1
    which = np.arange(len(counts)).repeat(counts)
    share = (np.arange(len(which)) - (np.cumsum(counts) - counts)[which]) / np.maximum(counts[which] - 1, 1)
    angle = between[which]
    sine = np.where(angle < 1e-6, 1.0, np.sin(angle))
    first = np.where(angle < 1e-6, 1 - share, np.sin((1 - share) * angle) / sine)
    second = np.where(angle < 1e-6, share, np.sin(share * angle) / sine)
    way = first[:, None] * ways[which, 0] + second[:, None] * ways[which, 1]
    # The line through both ends: along the direction first w0 + second w1 it lies at 1 / (first / r0 + second / r1).
    length = 1 / (first / far[which, 0] + second / far[which, 1])
    return eye + length[:, None] * way


def _within(edges: np.ndarray, eye: np.ndarray, step: float, cone: Cone) -> np.ndarray:
    """Which edges may reach into a cone that is wider by two steps: found by the spheres round them, bool [n]."""
    middle, leg = (edges[:, 0] + edges[:, 1]) / 2 - eye, edges[:, 1] - edges[:, 0]
    far = np.maximum(np.sqrt(np.einsum("ni,ni->n", middle, middle)), 1e-9)
    radius = np.sqrt(np.einsum("ni,ni->n", leg, leg)) / 2
    aside = np.arccos(np.clip(np.einsum("ni,i->n", middle, cone.axis) / far, -1, 1))
    # Seen from within its sphere, an edge may lie anywhere.
    return (aside - np.arcsin(np.minimum(radius / far, 1)) < cone.half + 2 * step) | (far <= radius)
