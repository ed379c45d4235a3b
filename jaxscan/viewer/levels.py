"""Levels of detail: a cloud in tiles, each in chunks from coarse to fine, so that a view needs few points.

Which chunks a view needs is decided in the browser, by `gap` and distance: page/draw.js.
"""

import itertools
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
_WHOLE = 0.9
"""With this share of the points shown, the rest comes in one chunk."""


class Chunk(NamedTuple):
    """Points of a tile that are shown together: `Levels.order[start:stop]`; the centre is that of the tile [m]."""

    tile: int
    start: int
    stop: int
    centre: Float[np.ndarray, "3"]
    radius: float
    """Distance of the farthest of them [m]."""
    gap: float
    """Distance between points where this chunk is missing [m]; infinite for the first of a tile."""
    spacing: float
    """Distance between points with it [m], on surfaces of the area that the first chunk of the tile shows."""


class Levels(NamedTuple):
    """A cloud in the order in which it is shown."""

    order: Int[np.ndarray, " n"]
    chunks: tuple[Chunk, ...]
    """Chunks, tile by tile, each from coarse to fine."""


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
    order, ends = _by_tile(xyz, low, extent)
    digit = np.empty(len(xyz), np.uint8)
    before = np.uint64(0)
    for start, stop in itertools.pairwise(ends.tolist()):
        if stop > start:
            codes = _morton(xyz[order[start:stop]], low, extent)
            along = np.argsort(codes)
            order[start:stop], codes = order[start:stop][along], codes[along]
            # The highest bit that differs gives the level. Equal places differ in none, and are of the finest level.
            changed = codes ^ np.concatenate([[before], codes[:-1]])
            digit[start:stop] = DEPTH - 1 - np.maximum(_highest_bit(changed), 0) // 3
            before = codes[-1]
    digit[0] = 0
    counts = np.cumsum(np.bincount(digit, minlength=DEPTH))
    first = max(int(np.searchsorted(counts, overview, side="right")) - 1, 0)
    last = max(int(np.searchsorted(counts, _WHOLE * len(xyz))), first)
    runs, keys = [np.zeros(0, int)], [np.zeros(0, int)]
    for tile, (start, stop) in enumerate(itertools.pairwise(ends.tolist())):
        level = np.clip(digit[start:stop], first, last)
        by_level = np.argsort(level, kind="stable")
        order[start:stop] = order[start:stop][by_level]
        found, begin = np.unique(level[by_level], return_index=True)
        runs.append(start + begin)
        keys.append(tile * DEPTH + found.astype(int))
    return Levels(order, _chunks(xyz, order, (np.concatenate(runs), np.concatenate(keys)), extent))


def _by_tile(xyz: np.ndarray, low: np.ndarray, extent: float) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the points by tile, int32 [n], and where each tile begins and the last one ends [tiles + 1].

    What comes after takes one tile at a time: codes and sorted numbers of all points would be twice as large as they.
    """
    tile = np.empty(len(xyz), np.int16)
    for start in range(0, len(xyz), _AT_ONCE):
        codes = _morton(xyz[start : start + _AT_ONCE], low, extent)
        tile[start : start + _AT_ONCE] = codes >> np.uint64(3 * (DEPTH - _TILE_DEPTH))
    ends = np.concatenate([[0], np.cumsum(np.bincount(tile, minlength=8**_TILE_DEPTH))])
    order, free = np.empty(len(xyz), np.int32), ends[:-1].copy()
    for start in range(0, len(xyz), _AT_ONCE):
        some = tile[start : start + _AT_ONCE]
        by_tile = np.argsort(some, kind="stable")
        counts = np.bincount(some, minlength=len(free))
        # Each point of a tile goes to the next free place of that tile.
        order[np.repeat(free - np.cumsum(counts) + counts, counts) + np.arange(len(some))] = start + by_tile
        free += counts
    return order, ends


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
