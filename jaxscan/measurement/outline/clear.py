"""Distances through a room, from wall to opposite wall."""

import numpy as np

from jaxscan.measurement.outline.corners import Corner, Estimate, Surface, corner_of, length_between
from jaxscan.measurement.outline.outline import RoomOutline


OPPOSITE = np.cos(np.radians(5.0))
MOST = 2
"""Distances that are given."""


def clear_distances(room: RoomOutline, height: float) -> list[tuple[np.ndarray, np.ndarray, Estimate]]:
    """The distances of the opposite walls with most between them, at a height above the floor [m].

    Of each direction the two ends [3], m, a third of the way along what both walls share, and the distance.
    """
    level = room.floor.raised(height)
    sides = [
        (side.surface, corners[i].at, corners[(i + 1) % len(corners)].at)
        for loop, corners in zip(room.loops, room.corners(height), strict=True)
        for i, side in enumerate(loop)
        if side.seen
    ]
    found: list[tuple[float, np.ndarray, Corner, Corner]] = []
    for i, (first, start, end) in enumerate(sides):
        along = (end - start) / np.linalg.norm(end - start)
        for second, other_start, other_end in sides[i + 1 :]:
            shared = (
                sorted((0.0, float(np.linalg.norm(end - start)))),
                sorted(float(along @ (other - start)) for other in (other_start, other_end)),
            )
            low, high = max(shared[0][0], shared[1][0]), min(shared[0][1], shared[1][1])
            if -first.plane.normal @ second.plane.normal < OPPOSITE or high - low < 0.1:
                continue
            # A third of the way, so that in drawings one distance does not cross the words of the other.
            across = Surface.exact(along, float(along @ start) + low + (high - low) / 3.0)
            ends = [corner_of(surface, across, level) for surface in (first, second)]
            way = ends[1].at - ends[0].at
            if way @ first.plane.normal < 0 and not _blocked(ends[0].at, ends[1].at, sides):
                found.append(((high - low) * float(np.linalg.norm(way)), along, ends[0], ends[1]))
    chosen: list[tuple[float, np.ndarray, Corner, Corner]] = []
    for one in sorted(found, key=lambda each: -each[0]):
        if len(chosen) < MOST and all(abs(float(one[1] @ other[1])) < OPPOSITE for other in chosen):
            chosen.append(one)
    return [(start.at, end.at, length_between(start, end, room.errors)) for _, _, start, end in chosen]


def _blocked(start: np.ndarray, end: np.ndarray, sides: list[tuple[Surface, np.ndarray, np.ndarray]]) -> bool:
    """Whether a wall stands between two points on walls."""
    inner = [start + share * (end - start) for share in (1e-3, 1.0 - 1e-3)]
    for surface, first, second in sides:
        plane = surface.plane
        heights = [float(plane.normal @ p) - plane.distance for p in inner]
        if heights[0] * heights[1] < 0:
            at = inner[0] + heights[0] / (heights[0] - heights[1]) * (inner[1] - inner[0])
            if 0 < (at - first) @ (second - first) < (second - first) @ (second - first):
                return True
    return False
