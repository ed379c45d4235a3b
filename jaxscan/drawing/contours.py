"""Where a plane cuts the surfaces of a cloud: lines between neighbours of its grid."""

import numpy as np

from jaxscan.measurement.grid import Quads, rasterise
from jaxscan.measurement.outline.cells import is_within


STEEP = 4.0
"""Largest ratio of depth difference to lateral distance for neighbours on one surface [1]."""
STEP_M = 0.03
"""And this much more [m]."""
APART_M = 0.3
"""Largest distance of neighbours on one surface [m]."""
CROSSING = 0.1
"""Sine of the angle at which a surface must cross a plane, for its place in it to be known [1]."""
TOLERANCE_M = 0.008


def joined_quads(quads: Quads, p: np.ndarray, eye: np.ndarray) -> Quads:
    """The quads whose corners are of one surface, by points and where they were seen from [cells, 3], m."""
    way = p - eye
    reach = np.linalg.norm(way, axis=1)
    joined = np.ones(len(quads.corners), bool)
    for first, second in ((0, 1), (2, 3), (0, 2), (1, 3)):
        a, b = quads.corners[:, first], quads.corners[:, second]
        apart = np.linalg.norm(p[a] - p[b], axis=1)
        behind = np.abs(reach[a] - reach[b])
        beside = np.sqrt(np.maximum(apart**2 - behind**2, 0.0))
        joined &= (behind < STEEP * beside + STEP_M) & (apart < APART_M)
    return Quads(quads.corners[joined])


def steep_quads(quads: Quads, p: np.ndarray, height: np.ndarray) -> Quads:
    """The quads that cross the plane of a height [cells], m, so steeply that their place in it is known."""
    heights, corners = height[quads.corners], p[quads.corners]
    across = np.linalg.norm(corners[:, [0, 1]] - corners[:, [3, 2]], axis=2).max(1)
    return Quads(quads.corners[np.ptp(heights, axis=1) > CROSSING * across])


def cut(quads: Quads, p: np.ndarray, height: np.ndarray) -> list[np.ndarray]:
    """The lines [n, 3], m, along which a height [cells] over the cutting plane is zero, of quads of one surface each.

    Two quads that share a side share the point on it.
    """
    above = height[quads.corners] > 0
    mixed = np.flatnonzero(above.any(1) & ~above.all(1))
    segments: list[tuple[tuple[int, int], tuple[int, int]]] = []
    for quad in mixed:
        corners = quads.corners[quad]
        sides = [(corners[i], corners[j]) for i, j in ((0, 1), (1, 3), (3, 2), (2, 0))]
        crossed = [(int(min(side)), int(max(side))) for side in sides if (height[side[0]] > 0) != (height[side[1]] > 0)]
        segments += [(crossed[k], crossed[k + 1]) for k in range(0, len(crossed), 2)]
    return [_points(chain, p, height) for chain in _chains(segments)]


def _points(chain: list[tuple[int, int]], p: np.ndarray, height: np.ndarray) -> np.ndarray:
    first, second = np.array(chain).T
    share = height[first] / (height[first] - height[second])
    return p[first] + share[:, None] * (p[second] - p[first])


def _chains(segments: list[tuple[tuple[int, int], tuple[int, int]]]) -> list[list[tuple[int, int]]]:
    """Segments with common ends one after the other."""
    at: dict[tuple[int, int], list[int]] = {}
    for number, ends in enumerate(segments):
        for end in ends:
            at.setdefault(end, []).append(number)
    left, chains = set(range(len(segments))), []
    # Open chains first; what is left are rings.
    firsts = [number for number, ends in enumerate(segments) if any(len(at[end]) == 1 for end in ends)]
    for number in (*firsts, *range(len(segments))):
        if number not in left:
            continue
        left.remove(number)
        start, end = segments[number]
        chain = [end, start] if len(at[start]) > 1 and len(at[end]) == 1 else [start, end]
        while following := [other for other in at[chain[-1]] if other in left]:
            left.remove(following[0])
            one, two = segments[following[0]]
            chain.append(two if one == chain[-1] else one)
        chains.append(chain)
    return chains


def simplified(points: np.ndarray, tolerance_m: float = TOLERANCE_M) -> np.ndarray:
    """A line [n, k] without points that are nearer than a tolerance [m] to the line without them."""
    kept = np.zeros(len(points), bool)
    kept[[0, -1]] = True
    spans = [(0, len(points) - 1)]
    while spans:
        first, last = spans.pop()
        if last - first < 2:
            continue
        along = points[last] - points[first]
        apart = points[first + 1 : last] - points[first]
        square = float(along @ along)
        share = np.clip(apart @ along / square, 0.0, 1.0) if square > 0 else np.zeros(len(apart))
        away = np.linalg.norm(apart - share[:, None] * along, axis=1)
        worst = int(np.argmax(away))
        if away[worst] > tolerance_m:
            middle = first + 1 + worst
            kept[middle] = True
            spans += [(first, middle), (middle, last)]
    return points[kept]


def kept_parts(points: np.ndarray, kept: np.ndarray) -> list[np.ndarray]:
    """The stretches of a line [n, k] whose points are kept [n], of two points or more."""
    ends = np.flatnonzero(np.diff(np.concatenate([[False], kept, [False]]).astype(int)))
    return [points[start:stop] for start, stop in ends.reshape(-1, 2) if stop - start > 1]


PIXEL_M = 0.02
AROUND_PX = 6
"""Gaps within an outline are closed if they have at most about twice this many pixels."""
SMALLEST_M2 = 0.02


def outlines(quads: Quads, places: np.ndarray) -> list[np.ndarray]:
    """Outlines [n, 2], m, of what quads cover, without those within another, by places of the cells [cells, 2]."""
    # Imported here: not every drawing has furniture.
    from scipy import ndimage  # type: ignore[import-untyped]

    if not len(quads.corners):
        return []
    corners = places[quads.corners].reshape(-1, 2)
    low = corners.min(0) - 3 * AROUND_PX * PIXEL_M
    shape = np.ceil((corners.max(0) - low) / PIXEL_M).astype(int) + 3 * AROUND_PX
    covered = rasterise(quads, (places - low) / PIXEL_M, (int(shape[1]), int(shape[0]))).quad >= 0
    around = np.ones((2 * AROUND_PX + 1, 2 * AROUND_PX + 1), bool)
    closed = ndimage.binary_erosion(ndimage.binary_dilation(covered, around), around)
    height = ndimage.uniform_filter(closed.astype(np.float64), 3, mode="constant") - 0.5
    rows, columns = np.indices(height.shape)
    at = np.stack([columns, rows], -1).reshape(-1, 2) * PIXEL_M + low
    cells = np.arange(height.size).reshape(height.shape)
    grid = Quads(np.stack([cells[:-1, :-1], cells[:-1, 1:], cells[1:, :-1], cells[1:, 1:]], -1).reshape(-1, 4))
    found = [simplified(ring, PIXEL_M) for ring in cut(grid, at, height.ravel())]
    found = [ring for ring in found if len(ring) > 3 and _area(ring) > SMALLEST_M2]
    return [ring for ring in found if not any(other is not ring and is_within([other], ring[:1])[0] for other in found)]


def _area(ring: np.ndarray) -> float:
    after = np.roll(ring, -1, 0)
    return 0.5 * abs(float(np.sum(ring[:, 0] * after[:, 1] - after[:, 0] * ring[:, 1])))
