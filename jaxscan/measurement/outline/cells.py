"""The inside of a room among the lines of its walls, and its border as closed loops.

The lines divide the plan into cells. What rays crossed on their way to a point is free; where points stand one above
the other there is a wall. The inside is the set of cells with the least free area outside, unseen area inside, and
border without a wall: a minimal cut.
"""

from typing import NamedTuple

import numpy as np

from jaxscan.measurement.samples import Samples, spread_out


GRID_M = 0.05
"""Size of the squares in which free space is counted [m]."""
RAYS = 20_000
"""Most rays that are followed."""
MOST_BETWEEN = 6
"""Most squares that are filled from one profile halfway to the next."""
MARGIN_M = 0.5
"""How far the plan reaches beyond the walls [m]."""
UNSEEN = 0.3
"""What unseen area inside costs, where free area outside costs 1."""
BORDER_M = 0.5
"""Cost of a metre of border without a wall, as the area that costs as much [m^2 / m]."""
WALLED = 0.04
"""Share of that cost which border along a wall has, too, so that walls within a room are not taken for borders [1]."""
STRETCH_M = 0.2
"""Length of a stretch of wall that counts as seen or unseen as a whole [m]."""
STOREYS = 4
"""Heights, 0.1 m apart, at which a stretch of wall has points."""
NEAR_M = 0.03
"""Distance of the points of a wall from its line, beside 4 sigma [m]."""


class Line(NamedTuple):
    """The trace of an upright plane in the plan, `normal . p = distance` [m]."""

    normal: np.ndarray
    distance: float

    def along(self, p: np.ndarray) -> np.ndarray:
        """Places [n] of points [n, 2 or more] along the line, m."""
        return p[..., 1] * self.normal[0] - p[..., 0] * self.normal[1]

    def at(self, s: float) -> np.ndarray:
        """The point [2] of the line at a place, m."""
        return self.distance * self.normal + s * np.array([-self.normal[1], self.normal[0]])


class Edge(NamedTuple):
    """A stretch of a line between inside and outside."""

    line: int
    """Number of its line; the four sides of the plan come last."""
    start: float
    """Its ends along the line, in the direction in which the inside is on the left [m]."""
    end: float


def find_inside(samples: Samples, lines: list[Line], heights: tuple[float, float]) -> tuple[list[Edge], list[Line]]:
    """The border of the inside: its edges in no order, and the lines with the sides of the plan after them.

    Points between two heights [m], without floor and ceiling, belong to walls.
    """
    low, high = _extent(samples, lines)
    boxed = [*lines, *_sides(low, high)]
    squares, centres = _squares(low, high)
    codes = _codes(centres, lines)
    cells, cell_of = np.unique(codes, return_inverse=True)
    free = _free(samples, low, squares).ravel()
    area = np.bincount(cell_of) * GRID_M**2
    seen = np.bincount(cell_of, free) * GRID_M**2
    stations = np.searchsorted(cells, _codes(_stations(samples)[0], lines))
    seen[np.minimum(stations, len(cells) - 1)] += 1e3
    borders, count = _borders(cells, boxed, len(lines))
    costs = [_cost(samples, boxed[one.line], one.start, one.end, heights, one.line < len(lines)) for one in borders]
    thin = np.zeros(count - len(cells))
    inside = _cut(np.append(np.maximum(area - seen, 0.0), thin), np.append(seen, thin), borders, costs)
    return [
        Edge(one.line, *((one.start, one.end) if inside[one.behind] else (one.end, one.start)))
        for one in borders
        if inside[one.behind] != (one.before >= 0 and inside[one.before])
    ], boxed


class _Border(NamedTuple):
    line: int
    start: float
    end: float
    behind: int
    """The cell on the side against the line's normal."""
    before: int
    """That on the normal's side; -1 beyond the plan."""


def _extent(samples: Samples, lines: list[Line]) -> tuple[np.ndarray, np.ndarray]:
    near = np.zeros(len(samples.p), bool)
    for line in lines:
        near |= np.abs(samples.p[:, :2] @ line.normal - line.distance) < NEAR_M
    low, high = np.percentile(samples.p[near, :2], [0.5, 99.5], axis=0)
    return low - MARGIN_M, high + MARGIN_M


def _sides(low: np.ndarray, high: np.ndarray) -> list[Line]:
    """The sides of the plan, normals out of it."""
    axes = np.eye(2)
    return [Line(sign * axes[k], sign * (high if sign > 0 else low)[k]) for k in (0, 1) for sign in (1.0, -1.0)]


def _squares(low: np.ndarray, high: np.ndarray) -> tuple[tuple[int, int], np.ndarray]:
    columns, rows = (int(np.ceil(side / GRID_M)) for side in high - low)
    x, y = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5, indexing="ij")
    return (columns, rows), low + GRID_M * np.stack([x, y], -1).reshape(-1, 2)


def _codes(p: np.ndarray, lines: list[Line]) -> np.ndarray:
    """One number per point [n, 2]: bit k is set where it is before line k, on the side of its normal."""
    codes = np.zeros(len(p), np.int64)
    for k, line in enumerate(lines):
        codes |= (p @ line.normal > line.distance).astype(np.int64) << k
    return codes


def _free(samples: Samples, low: np.ndarray, squares: tuple[int, int]) -> np.ndarray:
    """Which squares a ray crossed [columns, rows], or lie between two that neighbouring rays crossed."""
    # Imported here, so that `import jaxscan` does not load SciPy.
    from scipy.ndimage import binary_closing  # type: ignore[import-untyped]

    some = spread_out(len(samples.p), RAYS, np.random.default_rng(0))
    start, end = samples.origin[some, :2], samples.p[some, :2]
    reach = np.linalg.norm(end - start, axis=1)
    free = np.zeros(squares, bool)
    # Rays end just before the surface, which is itself not free.
    for step in np.arange(0.5, np.ceil(reach.max() / GRID_M)) * GRID_M:
        going = reach > step + 0.5 * GRID_M
        at = start[going] + (end[going] - start[going]) * (step / reach[going])[:, None]
        square = np.floor((at - low) / GRID_M).astype(int)
        square = square[((square >= 0) & (square < squares)).all(1)]
        free[square[:, 0], square[:, 1]] = True
    apart = float(np.percentile(reach, 95)) * _stations(samples)[1]
    between = min(MOST_BETWEEN, int(np.ceil(0.5 * apart / GRID_M)))
    closed: np.ndarray = binary_closing(np.pad(free, between), iterations=between)
    return closed[between:-between, between:-between]


def _borders(cells: np.ndarray, boxed: list[Line], walls: int) -> tuple[list[_Border], int]:
    """The stretches of lines between two cells, or between a cell and what is beyond the plan; and how many cells.

    Cells between lines that are nearer than the squares come last.
    """
    number = {int(code): index for index, code in enumerate(cells)}
    ahead, borders = list(number), []
    while ahead:
        code = ahead.pop()
        for k, line in enumerate(boxed):
            start, end = _clipped(line, k, code, boxed, walls)
            if end - start <= 1e-6:
                continue
            other = code ^ 1 << k
            if k < walls and other not in number:
                number[other] = len(number)
                ahead.append(other)
            if k >= walls or not code >> k & 1:
                borders.append(_Border(k, start, end, number[code], number[other] if k < walls else -1))
    return borders, len(number)


def _clipped(line: Line, k: int, code: int, boxed: list[Line], walls: int) -> tuple[float, float]:
    """The stretch of a line that borders a cell."""
    start, end = -np.inf, np.inf
    for j, other in enumerate(boxed):
        if j == k:
            continue
        sign = -1.0 if j < walls and code >> j & 1 else 1.0
        # The cell has sign * (normal . p - distance) < 0.
        slope = sign * (line.normal[0] * other.normal[1] - line.normal[1] * other.normal[0])
        offset = sign * (line.distance * float(line.normal @ other.normal) - other.distance)
        if abs(slope) < 1e-12:
            if offset > 0:
                return 0.0, 0.0
        elif slope > 0:
            end = min(end, -offset / slope)
        else:
            start = max(start, -offset / slope)
    return float(start), float(end)


def wall_share(samples: Samples, line: Line, ends: tuple[float, float], heights: tuple[float, float]) -> float:
    """The share of a stretch of a line along which points stand one above the other [1]; heights as in `find_inside`.

    Far away and at a slant profiles are farther apart than stretches: the wall is taken to go on from one to the next.
    """
    start, end = min(ends), max(ends)
    near = np.abs(samples.p[:, :2] @ line.normal - line.distance) < NEAR_M + 4.0 * samples.sigma
    near &= (samples.p[:, 2] > heights[0]) & (samples.p[:, 2] < heights[1])
    # Whole numbers of 0.1 m, upwards and along; there are fewer than a million.
    along, up = (np.floor(values[near] / 0.1).astype(np.int64) for values in (line.along(samples.p), samples.p[:, 2]))
    columns, storeys = np.unique(np.unique(along * 1_000_000 + up) // 1_000_000, return_counts=True)
    columns = 0.1 * (columns[storeys >= STOREYS] + 0.5)
    if not len(columns):
        return 0.0
    middles = start + (np.arange(count := max(1, round((end - start) / STRETCH_M))) + 0.5) * (end - start) / count
    origins, step = _stations(samples)
    before = np.maximum(np.abs(origins @ line.normal - line.distance), NEAR_M)
    aside = middles[:, None] - line.along(origins)
    spacing = ((before**2 + aside**2) / before).min(1) * step
    away = np.abs(middles[:, None] - columns).min(1)
    return float(np.mean(away < 0.5 * STRETCH_M + np.minimum(0.6 * spacing, MOST_BETWEEN * GRID_M)))


def _stations(samples: Samples) -> tuple[np.ndarray, float]:
    """The origins of the stations in the plan [stations, 2], m, and the angle between profiles of a full turn [rad]."""
    # Stations are numbered from 0; sorting all points, here for every border, would take most of the time.
    has = np.flatnonzero(np.bincount(samples.station))
    first = [int(np.argmax(samples.station == number)) for number in has]
    profiles = np.count_nonzero(np.bincount(samples.profile))
    return samples.origin[first, :2], 2.0 * np.pi * len(has) / profiles


def _cost(samples: Samples, line: Line, start: float, end: float, heights: tuple[float, float], is_wall: bool) -> float:
    share = wall_share(samples, line, (start, end), heights) if is_wall else 0.0
    return BORDER_M * (end - start) * (1.0 - (1.0 - WALLED) * share)


def _cut(unseen: np.ndarray, seen: np.ndarray, borders: list[_Border], costs: list[float]) -> np.ndarray:
    """Which cells are inside: the minimal cut between free space and what is beyond the plan."""
    # Imported here, so that `import jaxscan` does not load SciPy.
    from scipy.sparse import csr_array  # type: ignore[import-untyped]
    from scipy.sparse.csgraph import breadth_first_order, maximum_flow  # type: ignore[import-untyped]

    count = len(seen)
    source, sink = count, count + 1
    rows, columns, values = [], [], []
    for cell in range(count):
        rows += [source, cell]
        columns += [cell, sink]
        values += [seen[cell], UNSEEN * unseen[cell]]
    for border, cost in zip(borders, costs, strict=True):
        other = sink if border.before < 0 else border.before
        rows += [border.behind, other]
        columns += [other, border.behind]
        values += [cost, 0.0 if other == sink else cost]
    # Whole square centimetres; sums of repeated entries are made here.
    whole = np.round(1e4 * np.array(values)).astype(np.int32)
    graph = csr_array((whole, (rows, columns)), shape=(count + 2, count + 2), dtype=np.int32)
    graph.sum_duplicates()
    flow = maximum_flow(graph, source, sink).flow
    left = csr_array(graph - flow)
    left.data = np.where(left.data > 0, left.data, 0)
    left.eliminate_zeros()
    reached = breadth_first_order(left, source, return_predecessors=False)
    inside = np.zeros(count + 2, bool)
    inside[reached] = True
    return inside[:count]


SAME_M = 2e-3
"""Ends of edges nearer than this are one corner [m]."""


def closed_loops(edges: list[Edge], lines: list[Line]) -> list[list[Edge]]:
    """Loops of edges, each with the inside on its left; edges that continue each other on one line are joined.

    The first loop is the largest; loops that are not its holes are left out.
    """
    ends = [(lines[edge.line].at(edge.start), lines[edge.line].at(edge.end)) for edge in edges]
    left = set(range(len(edges)))
    loops = []
    while left:
        loop = [left.pop()]
        while (following := _following(loop[-1], left, ends, edges, lines)) is not None:
            left.remove(following)
            loop.append(following)
        if len(loop) > 2 and np.linalg.norm(ends[loop[-1]][1] - ends[loop[0]][0]) < SAME_M:
            loops.append(_joined([edges[index] for index in loop]))
    areas = [_area(loop, lines) for loop in loops]
    if not loops or max(areas) <= 0:
        return []
    outer = loops[int(np.argmax(areas))]
    return [outer, *(loop for loop, area in zip(loops, areas, strict=True) if area < 0)]


def is_within(loops: list[np.ndarray], p: np.ndarray) -> np.ndarray:
    """Which points [n, 2 or more] are within loops of corners [corners, 2], holes left out [n]."""
    inside = np.zeros(len(p), bool)
    for at in loops:
        for start, end in zip(at, np.roll(at, -1, 0), strict=True):
            crosses = (start[1] > p[:, 1]) != (end[1] > p[:, 1])
            rise = end[1] - start[1]
            x = start[0] + (p[:, 1] - start[1]) * (end[0] - start[0]) / (rise if rise != 0 else 1.0)
            inside ^= crosses & (p[:, 0] < x)
    return inside


def distance_to(start: np.ndarray, end: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Distances of points [n, 2] from the stretch between two points [2] [n], m."""
    length = np.linalg.norm(end - start)
    along = (end - start) / length
    s = np.clip((p - start) @ along, 0.0, length)
    return np.asarray(np.linalg.norm(p - start - s[:, None] * along, axis=1))


def _following(
    index: int, left: set[int], ends: list[tuple[np.ndarray, np.ndarray]], edges: list[Edge], lines: list[Line]
) -> int | None:
    at = ends[index][1]
    near = [other for other in sorted(left) if np.linalg.norm(ends[other][0] - at) < SAME_M]
    if not near:
        return None
    # Where the inside touches itself at a corner, the sharpest turn to the left keeps the two corners apart.
    return max(near, key=lambda other: _turn(ends[index], ends[other]))


def _turn(first: tuple[np.ndarray, np.ndarray], second: tuple[np.ndarray, np.ndarray]) -> float:
    a, b = first[1] - first[0], second[1] - second[0]
    return float(np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b))


def _joined(loop: list[Edge]) -> list[Edge]:
    # Begin at a corner, so that no line is at both ends.
    first = next((i for i, edge in enumerate(loop) if edge.line != loop[i - 1].line), 0)
    joined: list[Edge] = []
    for edge in [*loop[first:], *loop[:first]]:
        if joined and joined[-1].line == edge.line:
            joined[-1] = joined[-1]._replace(end=edge.end)
        else:
            joined.append(edge)
    return joined


def _area(loop: list[Edge], lines: list[Line]) -> float:
    at = np.array([lines[edge.line].at(edge.start) for edge in loop])
    after = np.roll(at, -1, 0)
    return 0.5 * float(np.sum(at[:, 0] * after[:, 1] - at[:, 1] * after[:, 0]))
