"""A picture on any mesh: its charts are packed into one picture, and every texel asks for the colour of its place."""

import numpy as np
from jaxtyping import Float, Int, UInt8

from jaxscan.reconstruction.ahead import map_ahead, workers
from jaxscan.surface.mesh import Mesh
from jaxscan.surface.texture import AT_A_TIME, BAND_WIDTH, LARGEST_SIDE, Colour, Texels, spread


GAP = 4
"""Texels round each chart that have the colour of the nearest one in it."""
PART = 200_000
"""Texels that are placed at a time, with those beside the faces."""


def texture_any_mesh(mesh: Mesh, colour: Colour, pixels_per_radian: float) -> Mesh:
    """A mesh in the scanner frame with a picture of the surface, whatever its faces.

    Vertices at the border of a chart are there once for each chart.

    Args:
        mesh: Any.
        colour: Asked for each texel. Where it knows none, the colours of the vertices serve.
        pixels_per_radian: Resolution of the camera: in the middle of each chart, a texel is about a pixel, or larger
            where the picture would be too large for graphics cards.
    """
    chart, direction, directions = make_charts(mesh)
    # A vertex of each chart.
    count = len(mesh.vertices)
    key, corner = np.unique(chart[:, None] * count + mesh.faces, return_inverse=True)
    of, vertex = key // count, key % count
    faces = corner.reshape(mesh.faces.shape).astype(np.int32)
    side = directions[direction[of] % 3 - 2], directions[direction[of] % 3 - 1]
    flat = np.stack([np.sum(mesh.vertices[vertex] * axis, 1) for axis in side], 1)
    place, shape = _packed(flat, of, _scales(mesh, of, vertex, pixels_per_radian))
    parts = [field[vertex] for field in (mesh.vertices, mesh.normals, mesh.rgb)]
    uv = (place / shape[::-1]).astype(np.float32)
    made = Mesh(parts[0], parts[1], parts[2], faces, uv)
    return made._replace(texture=_picture(made, place, shape, colour))


def _scales(
    mesh: Mesh, of: Int[np.ndarray, " n"], vertex: Int[np.ndarray, " n"], pixels_per_radian: float
) -> Float[np.ndarray, " charts"]:
    """Texels per metre of each chart."""
    away = np.linalg.norm(mesh.vertices[vertex], axis=1)
    middle = np.bincount(of, away) / np.bincount(of)
    return pixels_per_radian / np.maximum(middle, 0.1)


def _packed(
    flat: Float[np.ndarray, "n 2"], of: Int[np.ndarray, " n"], scale: Float[np.ndarray, " charts"]
) -> tuple[Float[np.ndarray, "n 2"], tuple[int, int]]:
    """Places [texels] of the vertices in one picture, and its rows and columns."""
    low, high = (np.full((len(scale), 2), end) for end in (np.inf, -np.inf))
    np.minimum.at(low, of, flat)
    np.maximum.at(high, of, flat)
    while True:
        size = np.ceil((high - low) * scale[:, None]).astype(int) + 1 + 2 * GAP
        corner, shape = _shelves(size)
        if max(shape) <= LARGEST_SIDE:
            return (flat - low[of]) * scale[of, None] + corner[of] + GAP + 0.5, shape
        scale = 0.9 * scale


def _shelves(size: Int[np.ndarray, "charts 2"]) -> tuple[Int[np.ndarray, "charts 2"], tuple[int, int]]:
    """Upper left corners of rectangles, the highest first, from left to right on shelves; rows and columns of all."""
    area = float(np.sum(size[:, 0] * size[:, 1], dtype=np.float64))
    width = max(int(size[:, 0].max()), min(BAND_WIDTH, int(np.sqrt(1.2 * area))))
    corner = np.zeros_like(size)
    left, top, shelf = 0, 0, 0
    for number in np.argsort(-size[:, 1], kind="stable"):
        if left + size[number, 0] > width:
            left, top, shelf = 0, top + shelf, 0
        corner[number] = left, top
        left, shelf = left + size[number, 0], max(shelf, size[number, 1])
    return corner, (int(top + shelf), width)


def _picture(
    mesh: Mesh, place: Float[np.ndarray, "n 2"], shape: tuple[int, int], colour: Colour
) -> UInt8[np.ndarray, "rows columns 3"]:
    """The picture of a mesh whose vertices are at these places of it [texels]."""
    picture, drawn = np.zeros((*shape, 3), np.uint8), np.zeros(shape, np.bool_)

    def draw(texels: Texels) -> None:
        rgb, seen = colour(texels.points, texels.normals)
        picture[texels.at] = np.where(seen[:, None], rgb, texels.rgb)
        drawn[texels.at] = True

    # So that a face that covers no texel's middle still has a texel.
    column, row = np.floor(place).astype(np.int64).T
    draw(Texels((row, column), mesh.vertices.astype(np.float32), mesh.normals, mesh.rgb))
    corners = place[mesh.faces]
    first = np.ceil(corners.min(1) - 0.5).astype(np.int64)
    boxes = np.maximum(np.floor(corners.max(1) - 0.5).astype(np.int64) - first + 1, 0)
    # Sorted by bearing, so that some photographs show nothing of a group and are skipped.
    middle = mesh.vertices[mesh.faces].mean(1)
    order = np.argsort(np.arctan2(middle[:, 1], middle[:, 0]))
    size = boxes[order, 0] * boxes[order, 1]
    # Half of the box round a face is on the face.
    for group in _runs(size, 2 * AT_A_TIME):
        runs = [order[group[run]] for run in _runs(size[group], PART)]
        parts = map_ahead(lambda run: _texels(mesh, place, run, (first, boxes)), runs, workers(), compiled=True)
        draw(Texels.joined(list(parts)))
    return spread(picture, drawn, GAP)


def _runs(size: Int[np.ndarray, " n"], most: int) -> list[Int[np.ndarray, " k"]]:
    """Numbers of things that follow each other, cut where the sum of their sizes passes a multiple of `most`."""
    return np.split(np.arange(len(size)), np.flatnonzero(np.diff(np.cumsum(size) // most)) + 1)


def _texels(
    mesh: Mesh,
    place: Float[np.ndarray, "n 2"],
    run: Int[np.ndarray, " k"],
    boxes: tuple[Int[np.ndarray, "m 2"], Int[np.ndarray, "m 2"]],
) -> Texels:
    """Texels whose middle is on some faces; the first texel and the size of the box round each face are known."""
    first, size = (field[run] for field in boxes)
    area = size[:, 0] * size[:, 1]
    face = np.repeat(np.arange(len(run)), area)
    number = np.arange(len(face)) - np.repeat(np.cumsum(area) - area, area)
    column, row = first[face, 0] + number % size[face, 0], first[face, 1] + number // size[face, 0]
    a, b, c = np.moveaxis(place[mesh.faces[run]], 1, 0)
    u, v = b - a, c - a
    det = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    u, v = (side / np.where(det == 0, np.inf, det)[:, None] for side in (u, v))
    x, y = column + 0.5 - a[face, 0], row + 0.5 - a[face, 1]
    second, third = x * v[face, 1] - y * v[face, 0], y * u[face, 0] - x * u[face, 1]
    weights = np.stack([1 - second - third, second, third], 1)
    # A texel on the edge of two faces is drawn by both, rather than by none.
    inside = (weights > -1e-6).all(1) & (det[face] != 0)
    corner, weights = mesh.faces[run[face[inside]]], weights[inside]
    points, normals, rgb = (
        np.einsum("nk,nkc->nc", weights, field[corner]) for field in (mesh.vertices, mesh.normals, mesh.rgb)
    )
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-6)
    at = row[inside], column[inside]
    return Texels(at, points.astype(np.float32), normals.astype(np.float32), (rgb + 0.5).astype(np.uint8))


ROUNDS = 8
"""Times that faces take the direction of most of their neighbours: so noise does not tear a chart to pieces."""
LEAST_FACING = 0.35
"""Least cosine between the normal of a face and the direction of its chart, which limits how much a face is
squeezed."""


def chart_directions(areas: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, "6 3"]:
    """Unit vectors along most of the walls, and up and down, by normals of faces as long as their areas."""
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
        # Ties between directions go to the one that the face looks at most directly.
        label = np.argmax(np.where(facing >= LEAST_FACING, votes + facing, facing - 2), 1)
    chart = components(pairs[label[pairs[:, 0]] == label[pairs[:, 1]]], len(label))
    first = np.unique(chart, return_index=True)[1]
    return chart, label[first], directions


def components(pairs: Int[np.ndarray, "pairs 2"], count: int) -> Int[np.ndarray, " n"]:
    """Number of the connected part of each of `count` things, of which some pairs belong together."""
    # Imported here: it takes its time.
    from scipy.sparse import coo_matrix  # type: ignore[import-untyped]
    from scipy.sparse.csgraph import connected_components  # type: ignore[import-untyped]

    graph = coo_matrix((np.ones(len(pairs), np.bool_), tuple(pairs.T)), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1])
