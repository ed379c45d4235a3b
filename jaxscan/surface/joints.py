r"""Which points of the grid lie on one surface.

Points p and q, rays r, normals n. A plane through p predicts that q is $(q - p) \cdot n / (r \cdot n)$ nearer along its
ray than it is. Of the planes of p and of q, one predicts too much at a crease and the other too little, whatever the
crease is: they are on one surface if the signs differ, or if the smaller departure is within the noise of both points
and a share of the distance between their rays.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.surface.settings import MeshSettings


Vector = tuple[np.ndarray, ...]
"""Components x, y and z, each [columns, lines]."""


class Nodes(NamedTuple):
    """Points of some columns of the lattice, with what joins them; components apart, because that is faster."""

    xyz: Vector
    normal: Vector
    """Zero where there is none."""
    ray: Vector
    """Unit direction of sight."""
    variance: np.ndarray
    """Of the noise along the ray [m^2]."""
    valid: np.ndarray

    def part(self, columns: slice, lines: slice) -> "Nodes":
        """A rectangle of them."""
        cut = (columns, lines)
        xyz, normal, ray = (tuple(component[cut] for component in vector) for vector in self[:3])
        return Nodes(xyz, normal, ray, self.variance[cut], self.valid[cut])


def make_nodes(
    xyz: Float[np.ndarray, "columns lines 3"],
    normals: Float[np.ndarray, "columns lines 3"],
    sigma: Float[np.ndarray, "columns lines"],
    valid: Bool[np.ndarray, "columns lines"],
    eyes: Float[np.ndarray, "columns 3"],
) -> Nodes:
    """Nodes of points [m], their noise along the ray [m], and the place from which each column was seen [m]."""
    p = _apart(xyz)
    way = tuple(component - eyes[:, k, None].astype(np.float32) for k, component in enumerate(p))
    far = np.maximum(np.sqrt(dot(way, way)), 1e-9)
    ray = tuple(component / far for component in way)
    return Nodes(p, _apart(normals), ray, np.square(sigma, dtype=np.float32), valid)


def _apart(vectors: np.ndarray) -> tuple[np.ndarray, ...]:
    return tuple(np.ascontiguousarray(vectors[..., k], np.float32) for k in range(3))


class Edges(NamedTuple):
    """Pairs of nodes."""

    joined: Bool[np.ndarray, "columns lines"]
    """Whether both are on one surface."""
    cost: Float[np.ndarray, "columns lines"]
    """Departure beyond the noise [m], with a trace of the length: of two diagonals the cheaper one is better."""


def join(first: Nodes, second: Nodes, settings: MeshSettings) -> Edges:
    """Pairs of nodes that are neighbours."""
    step = tuple(b - a for a, b in zip(first.xyz, second.xyz, strict=True))
    ray = tuple(0.5 * (a + b) for a, b in zip(first.ray, second.ray, strict=True))
    deep = dot(step, ray)
    length = dot(step, step)
    lateral = np.sqrt(np.maximum(length - deep * deep, 0.0))
    steepest = settings.least_cosine()
    one, cosine_one = _departure(first, step, ray, deep, steepest)
    two, cosine_two = _departure(second, step, ray, deep, steepest)
    # Both are distances along the ray, positive where the second point is farther than the plane says.
    least = np.where(one * two <= 0, 0.0, np.minimum(np.abs(one), np.abs(two)))
    noise = settings.sigmas * np.sqrt(first.variance + second.variance)
    # Across the plane, a share of the distance between the rays; along the ray that is more, as the plane is steeper.
    beyond = least - noise
    steepness = np.maximum(cosine_one, cosine_two)
    joined = first.valid & second.valid & (beyond * steepness <= settings.bend * lateral)
    return Edges(joined, np.maximum(beyond, 0.0) * steepness + 1e-3 * np.sqrt(length))


def _departure(node: Nodes, step: Vector, ray: Vector, deep: np.ndarray, least: float) -> tuple[np.ndarray, np.ndarray]:
    """Depth beyond a node's plane, along the ray, and the plane's cosine; head-on where there is no normal."""
    facing = dot(node.normal, ray)
    # A plane seen from the side predicts any depth: by it the last point of a limb would reach what is behind it.
    known = facing < -least
    safe = np.where(known, facing, np.float32(-1.0))
    return np.where(known, dot(step, node.normal) / safe, deep), -safe


def dot(a: Vector, b: Vector) -> np.ndarray:
    """Scalar products of vectors by component."""
    product: np.ndarray = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product
