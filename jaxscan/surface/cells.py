"""The faces of each cell of the lattice.

A cell has the corners a (column, line), b (next column), c (next column and line) and d (next line). Its faces are
abc and acd, or abd and bcd.
"""

import numpy as np
from jaxtyping import Bool, Int, UInt8

from jaxscan.surface.joints import Edges, Nodes, Vector, dot, join
from jaxscan.surface.settings import MeshSettings


TRIANGLES = (((0, 0), (1, 0), (1, 1)), ((0, 0), (1, 1), (0, 1)), ((0, 0), (1, 0), (0, 1)), ((1, 0), (1, 1), (0, 1)))
"""Corners (columns and lines ahead) of the faces abc, acd, abd and bcd. The bits 0 to 3 of a cell's code are theirs
where they are anticlockwise as seen, and the bits 4 to 7 where they are clockwise."""


def cell_codes(
    nodes: Nodes, joined: Bool[np.ndarray, " gaps"], settings: MeshSettings
) -> UInt8[np.ndarray, "gaps cells"]:
    """The faces of the cells between the columns of some nodes.

    Args:
        nodes: Points of columns that follow each other.
        joined: Whether each column and the next one are neighbours.
        settings: What counts as one surface.

    Returns:
        Code of each cell; see `TRIANGLES`.
    """
    every, before, after = slice(None), slice(None, -1), slice(1, None)
    along = join(nodes.part(every, before), nodes.part(every, after), settings).joined
    across = join(nodes.part(before, every), nodes.part(after, every), settings).joined & joined[:, None]
    a, c = nodes.part(before, before), nodes.part(after, after)
    b, d = nodes.part(after, before), nodes.part(before, after)
    ac, bd = join(a, c, settings), join(b, d, settings)
    ab, dc, ad, bc = across[:, :-1], across[:, 1:], along[:-1], along[1:]
    seen = [
        _facing(a, b, c, settings, ab & bc & ac.joined),
        _facing(a, c, d, settings, dc & ad & ac.joined),
        _facing(a, b, d, settings, ab & ad & bd.joined),
        _facing(b, c, d, settings, bc & dc & bd.joined),
    ]
    return _chosen(seen, ac, bd)


def _facing(
    first: Nodes, second: Nodes, third: Nodes, settings: MeshSettings, joined: np.ndarray
) -> Int[np.ndarray, "gaps cells"]:
    """1 for a face that is anticlockwise as seen, -1 for a clockwise one, 0 for none."""
    u = _step(first.xyz, second.xyz)
    v = _step(first.xyz, third.xyz)
    n = (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
    length = np.sqrt(dot(n, n))
    cosine = -dot(n, second.ray)
    steep = np.abs(cosine) <= settings.least_cosine() * length
    return np.where(joined & ~steep, np.sign(cosine), 0).astype(np.int8)


def _step(first: Vector, second: Vector) -> Vector:
    return tuple(b - a for a, b in zip(first, second, strict=True))


def _chosen(seen: list[np.ndarray], ac: Edges, bd: Edges) -> UInt8[np.ndarray, "gaps cells"]:
    """Codes of the faces on one side and the other of the better diagonal."""
    by_ac, by_bd = (np.abs(one) + np.abs(other) for one, other in (seen[:2], seen[2:]))
    first = (by_ac > by_bd) | ((by_ac == by_bd) & (ac.cost <= bd.cost))
    code = np.zeros(first.shape, np.uint8)
    for number, side in enumerate(seen):
        mine = first if number < 2 else ~first
        code |= np.where(mine & (side > 0), np.uint8(1 << number), np.uint8(0))
        code |= np.where(mine & (side < 0), np.uint8(16 << number), np.uint8(0))
    return code
