"""Edges of a border as closed loops."""

import numpy as np

from jaxscan.measurement.outline.cells import Edge, Line


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
    """Of points [n, 2] from the stretch between two [2] [n], m."""
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
