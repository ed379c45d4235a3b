"""Levels of detail: a cloud in tiles, each in chunks from coarse to fine, so that a view needs few points.

Which chunks a view needs is decided in the browser, by `gap` and distance: page/draw.js.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


DEPTH = 16
"""Halvings of the cube around the cloud: its finest cells."""
_TILE_DEPTH = 3
"""Halvings to a tile: 8 along each edge."""
OVERVIEW = 20_000
"""Points that are shown of all tiles, however far, at most."""
_AT_ONCE = 1 << 18
"""Points whose places on the curve are found together."""
_WHOLE = 0.9
"""With this share of the points shown, the rest comes in one chunk."""


class Chunk(NamedTuple):
    """Points of a tile that are shown together: `Levels.order[start:stop]`."""

    tile: int
    start: int
    stop: int
    centre: Float[np.ndarray, "3"]
    """Of the points of the tile [m]."""
    radius: float
    """Distance of the farthest of them [m]."""
    gap: float
    """Distance between points where this chunk is missing [m]; infinite for the first of a tile."""
    spacing: float
    """Distance between points with it [m], on surfaces of the area that the first chunk of the tile shows."""


class Levels(NamedTuple):
    """A cloud in the order in which it is shown."""

    order: Int[np.ndarray, " n"]
    """Which point of the cloud comes where."""
    chunks: tuple[Chunk, ...]
    """By tile, from coarse to fine."""


def make_levels(xyz: Float[np.ndarray, "n 3"], *, overview: int = OVERVIEW) -> Levels:
    """Sort points along a Morton curve, on which each level's first point of a cell stands for the cell.

    The coarsest level at which a point enters a new cell is the highest octal digit in which its place on the curve
    differs from that of the point before it, so that one pass over the sorted points finds all levels.

    Args:
        xyz: Points [m], in any order; at least one.
        overview: Points of the first chunks of all tiles together, at most; more where tiles are many.
    """
    low = xyz.min(0)
    extent = max(float((xyz.max(0) - low).max()), 1e-9)
    codes = np.empty(len(xyz), np.uint64)
    for start in range(0, len(xyz), _AT_ONCE):
        codes[start : start + _AT_ONCE] = _morton(xyz[start : start + _AT_ONCE], low, extent)
    along = np.argsort(codes).astype(np.int32)
    codes = codes[along]
    digit = np.zeros(len(codes), np.uint8)
    for start in range(0, len(codes) - 1, _AT_ONCE):
        changed = codes[start + 1 : start + _AT_ONCE + 1] ^ codes[start : start + _AT_ONCE][: len(codes) - 1 - start]
        # By the highest bit that differs; equal places differ in none, and are of the finest level.
        digit[start + 1 : start + 1 + len(changed)] = DEPTH - 1 - np.maximum(_highest_bit(changed), 0) // 3
    counts = np.cumsum(np.bincount(digit, minlength=DEPTH))
    first = max(int(np.searchsorted(counts, overview, side="right")) - 1, 0)
    last = max(int(np.searchsorted(counts, _WHOLE * len(xyz))), first)
    level = np.clip(digit, first, last)
    tile = (codes >> np.uint64(3 * (DEPTH - _TILE_DEPTH))).astype(np.int16)
    del codes
    key = tile * np.int16(DEPTH) + level
    by_level = np.argsort(key, kind="stable")
    order, key = along[by_level], key[by_level]
    starts = np.flatnonzero(np.diff(key, prepend=-1))
    return Levels(order, _chunks(xyz, order, (starts, key[starts]), extent))


def _morton(xyz: np.ndarray, low: np.ndarray, extent: float) -> np.ndarray:
    """Places on the curve, uint64 [n]: the bits of the three cells' numbers in turn."""
    code = np.zeros(len(xyz), np.uint64)
    for axis in range(3):
        cell = ((xyz[:, axis] - low[axis]) * ((2**DEPTH - 1) / extent)).astype(np.uint64)
        for shift, mask in _SPREAD:
            cell = (cell | (cell << np.uint64(shift))) & np.uint64(mask)
        code |= cell << np.uint64(2 - axis)
    return code


_SPREAD = ((16, 0x0000FF0000FF), (8, 0x00F00F00F00F), (4, 0x0C30C30C30C3), (2, 0x249249249249))
"""Puts two empty bits between the 16 bits of a number."""


def _highest_bit(values: np.ndarray) -> np.ndarray:
    """Number of the highest bit that is set, int64 [n]; -1 where none is."""
    # float64 holds 48 bits exactly; frexp gives the number of bits.
    return np.frexp(values.astype(np.float64))[1].astype(np.int64) - 1


def _chunks(
    xyz: np.ndarray, order: np.ndarray, runs: tuple[np.ndarray, np.ndarray], extent: float
) -> tuple[Chunk, ...]:
    starts, keys = runs
    stops = [*starts[1:].tolist(), len(order)]
    made: list[Chunk] = []
    tiles, levels = keys // DEPTH, keys % DEPTH
    begin, area = 0, 0.0
    for number, (start, stop) in enumerate(zip(starts.tolist(), stops, strict=True)):
        tile = int(tiles[number])
        if made and made[-1].tile == tile:
            before = made[-1]
            spacing = float(np.sqrt(area / (stop - begin)))
            made.append(Chunk(tile, start, stop, before.centre, before.radius, before.spacing, spacing))
            continue
        # The first chunk has one point in each cell that the surfaces cross.
        cell = extent / 2 ** (int(levels[number]) + 1)
        begin, area = start, cell**2 * (stop - start)
        whole = order[start : int(stops[np.flatnonzero(tiles == tile)[-1]])]
        centre, radius = _ball(xyz[whole])
        made.append(Chunk(tile, start, stop, centre, radius, np.inf, cell))
    return tuple(made)


def _ball(points: np.ndarray) -> tuple[np.ndarray, float]:
    low, high = points.min(0).astype(np.float64), points.max(0).astype(np.float64)
    return 0.5 * (low + high), float(0.5 * np.linalg.norm(high - low))
