"""Any mesh as flat charts: neighbouring faces that look about the same way, seen along one of six directions.

Two of the directions are up and down; the others are along most of the walls, so a wall is one chart, not distorted.
"""

import numpy as np
from jaxtyping import Float, Int

from jaxscan.surface.mesh import Mesh


ROUNDS = 8
"""Times that faces take the direction of most of their neighbours: so noise does not tear a chart to pieces."""
LEAST_FACING = 0.35
"""Cosine between the normal of a face and the direction of its chart: so little is a face squeezed at the most."""


def chart_directions(areas: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, "6 3"]:
    """Unit vectors along most of the walls, and up and down.

    Args:
        areas: Normals of faces, as long as their areas.
    """
    flat = areas[:, 0] + 1j * areas[:, 1]
    size = np.maximum(np.abs(flat), 1e-30)
    turn = np.angle(np.sum(size * (flat / size) ** 4)) / 4
    x = np.array([np.cos(turn), np.sin(turn), 0])
    axes = np.stack([x, [-x[1], x[0], 0], [0, 0, 1]])
    return np.concatenate([axes, -axes])


def neighbours(faces: Int[np.ndarray, "m 3"]) -> Int[np.ndarray, "pairs 2"]:
    """Pairs of faces that share an edge."""
    ends = np.sort(np.stack([faces, np.roll(faces, -1, 1)], -1).reshape(-1, 2), 1).astype(np.int64)
    key = ends[:, 0] * (int(faces.max()) + 1) + ends[:, 1]
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(key[order][1:] == key[order][:-1])
    return np.stack([order[same], order[same + 1]], 1) // 3


def make_charts(mesh: Mesh) -> tuple[Int[np.ndarray, " m"], Int[np.ndarray, " charts"], Float[np.ndarray, "6 3"]]:
    """Divide the faces of a mesh.

    Returns:
        Chart of each face, direction of each chart, and what the directions are.
    """
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    directions = chart_directions(areas)
    size = np.linalg.norm(areas, axis=1)
    facing = areas @ directions.T / np.maximum(size, 1e-30)[:, None]
    pairs = neighbours(mesh.faces)
    label = np.argmax(facing, 1)
    for _ in range(ROUNDS):
        votes = np.zeros(facing.shape)
        for one, other in (pairs.T, pairs.T[::-1]):
            np.add.at(votes, (one, label[other]), 1.0)
        votes[np.arange(len(label)), label] += 1.0
        # Of directions with as many votes, the one that is faced most.
        label = np.argmax(np.where(facing >= LEAST_FACING, votes + facing, facing - 2), 1)
    chart = components(pairs[label[pairs[:, 0]] == label[pairs[:, 1]]], len(label))
    first = np.unique(chart, return_index=True)[1]
    return chart, label[first], directions


def components(pairs: Int[np.ndarray, "pairs 2"], count: int) -> Int[np.ndarray, " n"]:
    """Number of the connected part of each of `count` things, of which some pairs belong together."""
    parent = np.arange(count)
    while len(pairs):
        low, high = np.sort(parent[pairs], 1).T
        np.minimum.at(parent, high, low)
        # Each points to the first of its chain.
        while np.any(parent != parent[parent]):
            parent = parent[parent]
        pairs = pairs[parent[pairs[:, 0]] != parent[pairs[:, 1]]]
    return np.unique(parent, return_inverse=True)[1]
