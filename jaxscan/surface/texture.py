"""A picture on the mesh of a grid: the grid is its chart.

Column and line of a point are its place in the picture, and every cell has the same number of texels. A long chart is
folded: its parts are bands, one below the other.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, UInt8

from jaxscan.errors import CloudError
from jaxscan.reconstruction.ahead import map_ahead, workers
from jaxscan.surface.grid_mesh import GridMesh, used_places, vertex_fields
from jaxscan.surface.mesh import Mesh


Colour = Callable[
    [Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]], tuple[UInt8[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]
]
"""Maps points [m] and unit normals to their colours, and to whether these are known."""

LARGEST_SIDE = 16_384
"""Most texels on a side: what graphics cards hold."""
BAND_WIDTH = 8192
"""Longer charts are folded: every browser holds this many texels on a side."""
AT_A_TIME = 4_000_000
PART = 50_000


class Texels(NamedTuple):
    """Texels that lie on a face."""

    at: tuple[np.ndarray, np.ndarray]
    points: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    rgb: UInt8[np.ndarray, "n 3"]
    """Between the colours of the vertices."""

    @staticmethod
    def joined(parts: "list[Texels]") -> "Texels":
        """All of some parts."""
        at, points, normals, rgb = zip(*parts, strict=True)
        rows, columns = zip(*at, strict=True)
        joined = [np.concatenate(field) for field in (rows, columns, points, normals, rgb)]
        return Texels((joined[0], joined[1]), joined[2], joined[3], joined[4])


class _Chart(NamedTuple):
    """Where the cells are in the picture."""

    across: int
    along: int
    columns: int
    shape: tuple[int, int]
    stride: int


def texels_of_pixels(grid: GridMesh, pixels_per_radian: float) -> tuple[int, int]:
    """Texels on a cell, across and along the profiles, so that one is about a pixel of the camera [px / rad].

    At least one each, and no more than a picture holds.
    """
    column, line = np.nonzero(grid.codes)
    few = slice(None, None, max(1, len(column) // 100_000))
    column, line = column[few], line[few]
    profile, xyz, valid = grid.lattice.profile, np.asarray(grid.cloud.xyz), np.asarray(grid.cloud.valid)
    eye = grid.eyes[profile[column]]

    def median_pixels(ahead: int, below: int) -> int:
        one, other = (profile[column], line), (profile[column + ahead], line + below)
        both = valid[one] & valid[other]
        if not both.any():
            return 1
        ray, next_ray = (xyz[place][both] - eye[both] for place in (one, other))
        angle = np.arctan2(np.linalg.norm(np.cross(ray, next_ray), axis=1), np.sum(ray * next_ray, axis=1))
        return max(1, round(float(np.median(angle)) * pixels_per_radian))

    across, along = median_pixels(1, 0), median_pixels(0, 1)
    gaps, cells = grid.codes.shape
    while (across > 1 or along > 1) and max(_chart(gaps, cells, (across, along)).shape) > LARGEST_SIDE:
        across, along = (across - 1, along) if across >= along else (across, along - 1)
    return across, along


def textured_mesh(grid: GridMesh, colour: Colour, texels: tuple[int, int] = (2, 2)) -> Mesh:
    """The mesh of all faces with a picture of the surface.

    A closed sheet has the vertices of its first profile twice, at both ends of the picture, and so have profiles where
    the chart is folded.

    Args:
        grid: The faces of a cloud.
        colour: Asked for each texel. Where it knows none, the colours of the vertices serve; where there is no
            surface, that of the next texel.
        texels: On each cell, across and along the profiles; see `texels_of_pixels`.

    Raises:
        CloudError: If the picture would have more than `LARGEST_SIDE` texels on a side.
    """
    gaps, cells = grid.codes.shape
    chart = _chart(gaps, cells, texels)
    if max(chart.shape) > LARGEST_SIDE:
        raise CloudError(
            f"a texture of {chart.shape[1]} x {chart.shape[0]} px is too large; at most {LARGEST_SIDE} px on a side, "
            "so take fewer texels on each cell."
        )
    lines = cells + 1
    faces = grid.faces()
    # A face lies between two columns, of which the lower is its cell's.
    band = (faces.min(1) // lines // chart.columns)[:, None]
    places, faces = used_places(faces + band * lines, (len(grid.lattice.profile) + gaps // chart.columns) * lines)
    column, line = places // lines, places % lines
    band, here = column // (chart.columns + 1), column % (chart.columns + 1)
    xyz, normals, rgb = vertex_fields(grid, grid.lattice.profile[column - band], line)
    rows, width = chart.shape
    uv = np.stack([here * chart.across / width, (band * chart.stride + line * chart.along) / rows], 1)
    return Mesh(xyz, normals, rgb, faces, uv.astype(np.float32), _picture(grid, colour, chart))


def _chart(gaps: int, cells: int, texels: tuple[int, int]) -> _Chart:
    across, along = texels
    bands = -(-gaps * across // BAND_WIDTH)
    columns = -(-gaps // bands)
    # Each of two neighbouring bands has its own margin.
    stride = cells * along + (2 * _MARGIN if bands > 1 else 0)
    return _Chart(across, along, columns, (stride * (bands - 1) + cells * along, columns * across), stride)


def _picture(grid: GridMesh, colour: Colour, chart: _Chart) -> UInt8[np.ndarray, "rows columns 3"]:
    gaps, cells = grid.codes.shape
    picture = np.zeros((*chart.shape, 3), np.uint8)
    drawn = np.zeros(chart.shape, np.bool_)
    stride = max(1, AT_A_TIME // (cells * chart.across * chart.along))
    for start in range(0, gaps, stride):
        found = _texels_between(grid, start, min(start + stride, gaps), chart)
        if len(found.points):
            rgb, seen = colour(found.points, found.normals)
            picture[found.at] = np.where(seen[:, None], rgb, found.rgb)
            drawn[found.at] = True
    return spread(picture, drawn, _MARGIN)


def _texels_between(grid: GridMesh, start: int, stop: int, chart: _Chart) -> Texels:
    """Texels on the faces of the cells between some columns, in parts that fit into the cache."""
    few = max(1, PART // (grid.codes.shape[1] * chart.across * chart.along))
    starts = range(start, stop, few)
    parts = map_ahead(lambda k: _texels(grid, k, min(k + few, stop), chart), starts, workers(), compiled=True)
    return Texels.joined(list(parts))


def _texels(grid: GridMesh, start: int, stop: int, chart: _Chart) -> Texels:
    """Texels on the faces of the cells between some columns."""
    # All texels of a cell one after the other.
    steps = [part.ravel() for part in np.meshgrid(np.arange(chart.across), np.arange(chart.along), indexing="ij")]
    shares = ((steps[0] + 0.5) / chart.across, (steps[1] + 0.5) / chart.along)
    codes = grid.codes[start:stop]
    column, line = np.nonzero(codes)
    code = codes[column, line]
    # The sense of a face does not matter here.
    weights = _weights((code | (code >> 4)) & np.uint8(15), *(share.astype(np.float32) for share in shares))
    profile = grid.lattice.profile
    xyz, normals, rgb = (np.zeros((*weights.shape[:2], 3), np.float32) for _ in range(3))
    centre = grid.eyes[profile[start]]
    for corner, (ahead, below) in enumerate(((0, 0), (1, 0), (1, 1), (0, 1))):
        place = vertex_fields(grid, profile[column + start + ahead], line + below)
        for total, values in zip((xyz, normals, rgb), (place[0] - centre, *place[1:]), strict=True):
            total += weights[..., corner, None] * values[:, None].astype(np.float32)
    band, here = (column + start) // chart.columns, (column + start) % chart.columns
    x = here[:, None] * chart.across + steps[0]
    y = (band * chart.stride + line * chart.along)[:, None] + steps[1]
    normals = normals.reshape(-1, 3)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-6)
    points = (xyz.reshape(-1, 3) + centre).astype(np.float32)
    return Texels((y.ravel(), x.ravel()), points, normals, np.clip(rgb.reshape(-1, 3) + 0.5, 0, 255).astype(np.uint8))


def _weights(bits: np.ndarray, u: np.ndarray, v: np.ndarray) -> Float[np.ndarray, "cells texels 4"]:
    """Shares of the corners a, b, c and d in each texel, by the face that it is on, or the only one there is."""
    zero, weight = np.zeros_like(u), np.zeros((len(bits), len(u), 4), np.float32)
    planes = (
        (1, u >= v, (1 - u, u - v, v, zero)),
        (2, u < v, (1 - v, zero, u, v - u)),
        (4, u + v <= 1, (1 - u - v, u, zero, v)),
        (8, u + v > 1, (zero, 1 - v, u + v - 1, 1 - u)),
    )
    for bit, inside, shares in planes:
        other = {1: 2, 2: 1, 4: 8, 8: 4}[bit]
        mine = ((bits & bit) != 0)[:, None] & (inside | ((bits & other) == 0)[:, None])
        weight = np.where(mine[..., None], np.stack(shares, -1), weight)
    return weight


def spread(picture: np.ndarray, drawn: np.ndarray, margin: int) -> np.ndarray:
    """The picture with the colour of a drawn texel so near where there is no surface, so that borders stay clean."""
    for axis in (0, 1):
        if drawn.all():
            break
        picture, drawn = np.swapaxes(picture, 0, axis), np.swapaxes(drawn, 0, axis)
        size = len(picture)
        for order in (slice(None), slice(None, None, -1)):
            number = np.where(drawn[order], np.arange(size, dtype=np.int32)[:, None], np.int32(-1))
            last = np.maximum.accumulate(number, 0)
            near = (last >= 0) & ~drawn[order] & (np.arange(size, dtype=np.int32)[:, None] - last <= margin)
            row, column = np.nonzero(near)
            view = picture[order]
            view[row, column] = view[last[row, column], column]
            drawn[order] |= near
        picture, drawn = np.swapaxes(picture, 0, axis), np.swapaxes(drawn, 0, axis)
    # Far from all surfaces any colour serves; the mean makes the smallest file.
    if not drawn.all():
        picture[~drawn] = picture[drawn][:: max(1, int(drawn.sum()) >> 20)].mean(0).astype(np.uint8)
    return picture


_MARGIN = 16
"""Texels round a surface that have its colour: two blocks of a JPEG, and four halvings of the picture."""
