"""The outline of a room of any shape, from its walls; and clear distances from wall to opposite wall."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from jaxscan.errors import MeasurementError
from jaxscan.geometry import Scanner
from jaxscan.measurement.outline.cells import (
    NEAR_M,
    Edge,
    Line,
    closed_loops,
    distance_to,
    find_inside,
    is_within,
    wall_share,
)
from jaxscan.measurement.outline.corners import Corner, Errors, Estimate, Surface, area_of, corner_of, length_between
from jaxscan.measurement.outline.level import Frame, find_level
from jaxscan.measurement.planes import Plane, facing
from jaxscan.measurement.room import because, is_upright
from jaxscan.measurement.samples import Cloud, Samples, about_the_scanner, checked_samples, places_of, spread_out
from jaxscan.measurement.walls import BEYOND, BEYOND_M, NEIGHBOURHOOD_M, SHARE, Wall, find_planes, refine_wall


ONE_WALL_M = 0.12
"""Parallel planes nearer than this are one wall with things on it; the outermost is the wall [m]."""
PARALLEL = np.cos(np.radians(5.0))
END_M = 0.1
"""Points nearer than this to an end of a wall, to the floor or to the ceiling have no part in it [m]."""
SEEN = 0.25
"""Share of its length along which a wall is seen; with less, its side is open."""
FEWEST = 50
"""Smallest number of points of a wall."""
EXTENDED_M = 1.0
"""A corner is known if one of its walls was seen nearer to it than this; the other may be hidden there [m]."""
REACH_M = 0.3
"""Points farther than this from a plane are not looked at [m]."""
LOOKED_AT = 100_000
"""Number of points that the outline is tested with."""
SHEETS = 2
"""A profile and the one opposite to it lie on a plane, which is no wall."""


@dataclass(frozen=True)
class Side:
    """One side of a room: a wall between two corners, or an opening as wide as that."""

    name: str
    surface: Surface
    """Its plane, the normal pointing out of the room."""
    seen: bool
    """Whether there is a wall; otherwise the plane only closes the outline."""
    gaps: tuple[float, float] = (np.inf, np.inf)
    """Distances from its first and its last corner to the nearest points of the wall [m]."""

    def moved(self, frame: Frame) -> "Side":
        """The side in another frame."""
        wall = self.surface.wall
        surface = Surface(frame.plane(self.surface.plane), None if wall is None else frame.wall(wall))
        return Side(self.name, surface, self.seen, self.gaps)


@dataclass(frozen=True)
class RoomOutline:
    """The walls of a room in order. All coordinates are those of `frame`: metres, the floor at z = 0."""

    frame: Frame
    loops: tuple[tuple[Side, ...], ...]
    """The sides of the outline, the inside on the left from one to the next; then those of pillars."""
    floor: Surface
    ceiling: Surface | None
    errors: Errors = field(repr=False)
    samples: Samples = field(repr=False)
    remarks: tuple[str, ...] = ()
    """Why sides are open where planes were found for them, and why the ceiling is left out: parts of a sentence."""

    @property
    def closed(self) -> bool:
        """Whether every corner is one of two walls that were seen near it."""
        return all(self.is_corner(number, i) for number, loop in enumerate(self.loops) for i in range(len(loop)))

    def is_corner(self, loop: int, side: int) -> bool:
        """Whether two walls meet at the first corner of a side, and at least one of them was seen near it."""
        before, after = self.loops[loop][side - 1], self.loops[loop][side]
        return before.seen and after.seen and min(before.gaps[1], after.gaps[0]) < EXTENDED_M

    def corners(self, level: Surface | float | None = None) -> list[list[Corner]]:
        """The first corner of every side of every loop, on the floor, another surface, or at a height above it [m]."""
        surface = self.floor.raised(level or 0.0) if not isinstance(level, Surface) else level
        return [
            [corner_of(loop[i - 1].surface, side.surface, surface) for i, side in enumerate(loop)]
            for loop in self.loops
        ]

    def lengths(self, height: float = 0.0) -> list[list[Estimate | None]]:
        """The length of every side at a height [m]; None where one of its ends is no corner of walls that were seen."""
        return [
            [
                length_between(corners[i], corners[(i + 1) % len(loop)], self.errors)
                if self.is_corner(number, i) and self.is_corner(number, (i + 1) % len(loop))
                else None
                for i in range(len(loop))
            ]
            for number, (loop, corners) in enumerate(zip(self.loops, self.corners(height), strict=True))
        ]

    def height(self) -> Estimate | None:
        """Floor to ceiling in the middle of the outline [m]; None without a ceiling."""
        if self.ceiling is None:
            return None
        middle = np.mean([corner.at for corner in self.corners()[0]], axis=0)
        upright = [Surface.exact(axis, float(middle @ axis)) for axis in np.eye(3)[:2]]
        low, high = (corner_of(*upright, surface) for surface in (self.floor, self.ceiling))
        return length_between(low, high, self.errors)

    def floor_area(self) -> Estimate | None:
        """[m^2]; None where a corner is not known."""
        if not self.closed:
            return None
        return area_of(self.corners(), -self.floor.plane.normal, self.errors)

    def wall_area(self, loop: int, side: int) -> Estimate | None:
        """Area of one side from floor to ceiling, openings included [m^2]; None where it is not bounded."""
        length = self.lengths()[loop][side]
        if self.ceiling is None or length is None:
            return None
        surface = self.loops[loop][side].surface
        return area_of([self._wall_corners(loop, side)], surface.plane.normal, self.errors)

    def volume(self) -> Estimate | None:
        """Between floor, ceiling and walls [m^3]; None where it is not bounded."""
        if self.ceiling is None or not self.closed:
            return None
        faces = [(self.floor, [loop[::-1] for loop in self.corners()]), (self.ceiling, self.corners(self.ceiling))]
        for number, loop in enumerate(self.loops):
            faces += [(side.surface, [self._wall_corners(number, i)]) for i, side in enumerate(loop)]
        value, effects = 0.0, []
        for surface, loops in faces:
            area, middle = _area_and_middle(loops, surface.plane.normal)
            value += area * surface.plane.distance / 3.0
            # Displaced along its normal, a face adds what it sweeps.
            effects.append((surface, area * surface.plane.height_weights(middle)))
        return self.errors.estimate(value, effects)

    def _wall_corners(self, loop: int, side: int) -> list[Corner]:
        low, high = self.corners()[loop], self.corners(self.ceiling)[loop]
        after = (side + 1) % len(low)
        return [low[side], low[after], high[after], high[side]]


def measure_outline(cloud: Cloud, *, scanner: Scanner | None = None, seed: int = 0) -> RoomOutline:
    """Find the walls around a room of any shape, and their corners.

    Upright planes divide the plan; of its cells those are inside that rays crossed, up to where walls are. Planes
    within 0.12 m of a wall and parallel to it are things on the wall. A plane is no wall if rays went through it to
    more than a fifth of the points, or if the points on it are those of two profiles: the light of each is a plane
    itself. At most a fifth of the points lies outside with the scanner.

    Args:
        cloud: The room, scanned from within; z of its frame is vertical within 10 degrees.
        scanner: The scanner it was made with; its covariance gives the systematic part of sigmas.
        seed: Seed of the random hypotheses; the result is deterministic.

    Returns:
        The outline, from which lengths, areas and the volume follow with their standard deviations.

    Raises:
        MeasurementError: If there is no floor, or fewer than three walls around the scanner.
    """
    found, place = about_the_scanner(checked_samples(cloud))
    rng = np.random.default_rng(seed)
    planes = find_planes(found, seed=seed)
    samples = found.all()
    frame, floor, ceiling, remarks = find_level(samples, planes, rng)
    standing = frame.samples(samples)
    walls = _candidates(frame, planes, standing)
    if len(walls) < 2:
        raise MeasurementError(
            f"Found {len(walls)} walls among {len(planes)} planes in {len(samples.p)} points, expected at least two; "
            "a room must be scanned from within, all around, in steps of a few degrees."
        )
    top = np.inf if ceiling is None else float(frame.of(ceiling.plane.centre)[2])
    heights = (END_M, top - END_M)
    edges, lines = find_inside(standing, [_trace(plane) for plane in walls], heights)
    loops = closed_loops(edges, lines)
    if not loops:
        raise _unbounded(len(walls), remarks)
    starts = np.array([lines[edge.line].at(edge.start) for edge in loops[0]])
    first = int(np.argmin(starts.sum(1)))
    loops[0] = [*loops[0][first:], *loops[0][:first]]
    names = iter(range(1, 1 + sum(map(len, loops))))
    around = _Around(standing, lines, walls, heights, remarks)
    sides = [[around.side(f"W{next(names)}", edge, rng) for edge in loop] for loop in loops]
    if sum(side.seen for side in sides[0]) < 2:
        raise _unbounded(len(walls), remarks)
    if (
        share := _share_unheld(standing, [np.array([lines[e.line].at(e.start) for e in loop]) for loop in loops])
    ) > BEYOND:
        remarks.append(f"{100 * share:.0f} % of the points lie outside of them, as the scanner does")
        raise _unbounded(len(walls), remarks)
    shift = Frame(np.eye(3), -np.append(starts.min(0), 0.0))
    frame = frame.shifted(shift.translation)
    ground, roof = frame.wall(floor), None if ceiling is None else frame.wall(ceiling)
    of_cloud = frame.shifted(-frame.rotation @ place)
    return RoomOutline(
        of_cloud,
        tuple(tuple(side.moved(shift) for side in loop) for loop in sides),
        Surface(ground.plane, ground),
        None if roof is None else Surface(roof.plane, roof),
        Errors(scanner, places_of(cloud), of_cloud),
        frame.samples(samples),
        tuple(remarks),
    )


def _unbounded(walls: int, remarks: list[str]) -> MeasurementError:
    return MeasurementError(
        f"No two of {walls} walls bound the space around the scanner{because(remarks)}; a room must be scanned from "
        "within, all around, in steps of a few degrees."
    )


def _candidates(frame: Frame, planes: list[tuple[Plane, np.ndarray]], standing: Samples) -> list[Plane]:
    """Upright planes in the plan, normals away from the scanner; of those that are one wall, the outermost."""
    found: list[list[tuple[Plane, int]]] = []
    for plane, p in planes:
        if not is_upright(plane):
            continue
        upright = _outward(frame.plane(plane), standing)
        group = next((each for each in found if _are_one_wall(each[0][0], upright)), None)
        if group is None:
            found.append([(upright, len(p))])
        else:
            group.append((upright, len(p)))
    walls = []
    for group in found:
        least = SHARE * max(count for _, count in group)
        first = group[0][0]
        depths = [(float(first.normal @ plane.centre), plane) for plane, count in group if count >= least]
        walls.append(max(depths, key=lambda each: each[0])[1])
    return walls


def _outward(plane: Plane, standing: Samples) -> Plane:
    near = np.abs(standing.p @ plane.normal - plane.distance) < NEAR_M
    return facing(plane, (standing.p[near] - standing.origin[near]).mean(0))


def _are_one_wall(first: Plane, second: Plane) -> bool:
    apart = abs(float(first.normal @ second.centre) - first.distance)
    return bool(first.normal @ second.normal > PARALLEL) and apart < ONE_WALL_M


def _area_and_middle(loops: list[list[Corner]], normal: np.ndarray) -> tuple[float, np.ndarray]:
    """Area [m^2] and centroid [3] of a flat polygon with holes; its loops are right-handed about the normal."""
    area, moment = 0.0, np.zeros(3)
    for loop in loops:
        at = np.array([corner.at for corner in loop])
        apart = at - at[0]
        parts = 0.5 * np.cross(apart, np.roll(apart, -1, 0)) @ normal
        area += float(parts.sum())
        moment += parts @ (at[0] + at + np.roll(at, -1, 0)) / 3.0
    return area, moment / area


def _trace(plane: Plane) -> Line:
    """The line in which an upright plane meets the height of its middle."""
    flat = plane.normal[:2] / np.linalg.norm(plane.normal[:2])
    return Line(flat, float(flat @ plane.centre[:2]))


class _Around(NamedTuple):
    """What the sides of an outline are made of."""

    standing: Samples
    lines: list[Line]
    walls: list[Plane]
    heights: tuple[float, float]
    remarks: list[str]
    """Contradictions to walls are appended here."""

    def side(self, name: str, edge: Edge, rng: np.random.Generator) -> Side:
        """The wall along an edge, fitted to its own points."""
        line = self.lines[edge.line]
        # The inside is on the left, so that the way out is to the right.
        sign = 1.0 if edge.end > edge.start else -1.0
        outward = np.append(sign * line.normal, 0.0)
        given = Surface.exact(outward, sign * line.distance)
        if edge.line >= len(self.walls):
            return Side(name, given, False)
        plane = facing(self.walls[edge.line], outward)
        opened = Side(name, Surface(plane._replace(covariance=np.zeros((3, 3))), None), False)
        ends = min(edge.start, edge.end), max(edge.start, edge.end)
        inset = min(END_M, 0.25 * (ends[1] - ends[0]))
        s, z = line.along(self.standing.p), self.standing.p[:, 2]
        mine = (s > ends[0] + inset) & (s < ends[1] - inset) & (z > self.heights[0]) & (z < self.heights[1])
        mine &= np.abs(self.standing.p @ plane.normal - plane.distance) < REACH_M
        near = np.abs(self.standing.p[mine] @ plane.normal - plane.distance) < NEIGHBOURHOOD_M
        if wall_share(self.standing, line, ends, self.heights) < SEEN or np.count_nonzero(near) < FEWEST:
            return opened
        wall = refine_wall(self.standing.take(mine), plane, rng=rng)
        if (problem := self._contradicted(wall, line, ends)) is not None:
            self.remarks.append(f"{name} is no wall: its plane at {wall.plane.distance:.2f} m {problem}")
            return opened
        low, high = np.percentile(line.along(wall.samples.p), [1, 99])
        gaps = (float(low - ends[0]), float(ends[1] - high))
        return Side(name, Surface(wall.plane, wall), True, gaps if sign > 0 else gaps[::-1])

    def _contradicted(self, wall: Wall, line: Line, ends: tuple[float, float]) -> str | None:
        """Why there is no wall along a stretch of a line where points lie on a plane; None if there may be one."""
        before = wall.plane.distance - wall.samples.origin @ wall.plane.normal
        if np.mean(before < -BEYOND_M) > 0.5:
            return "was seen from behind"
        share = _share_through(self.standing, wall.plane, line, ends)
        if share > BEYOND:
            return f"has {100 * share:.0f} % of the points behind it"
        counts = np.sort(_points_by_angle(wall.samples))
        if np.ptp(self.standing.angle) > 0 and counts[:-SHEETS].sum() < SHARE * counts.sum():
            profiles = "one profile" if len(counts) == 1 else f"{SHEETS} profiles"
            return f"has the points of {profiles}, and the light of each is a plane itself"
        return None


def _share_through(samples: Samples, plane: Plane, line: Line, ends: tuple[float, float]) -> float:
    """Share of the points that are behind a stretch of a wall, so that their rays went through it [1]."""
    before = plane.distance - samples.origin @ plane.normal
    behind = samples.p @ plane.normal - plane.distance
    # The plane of a profile goes through the scanner, or passes it on either side.
    far = (before > -BEYOND_M) & (behind > BEYOND_M + 6.0 * samples.sigma)
    before, behind = np.maximum(before[far], 0.0), behind[far]
    origin, p = samples.origin[far, :2], samples.p[far, :2]
    s = line.along(origin + (before / (before + behind))[:, None] * (p - origin))
    return float(np.count_nonzero((s > ends[0]) & (s < ends[1])) / len(samples.p))


def _share_unheld(standing: Samples, loops: list[np.ndarray]) -> float:
    """Share of the points that are outside of an outline, and that its scanner did not see through a side of it [1].

    A ray from within crosses a side; what crosses walls is counted for each of them.
    """
    some = standing.take(spread_out(len(standing.p), LOOKED_AT, np.random.default_rng(0)))
    p, origin = some.p[:, :2], some.origin[:, :2]
    away, aside = np.full(len(p), np.inf), np.full(len(p), np.inf)
    for at in loops:
        for start, end in zip(at, np.roll(at, -1, 0), strict=True):
            away, aside = (
                np.minimum(away, distance_to(start, end, p)),
                np.minimum(aside, distance_to(start, end, origin)),
            )
    unheld = ~is_within(loops, p) & (away > BEYOND_M + 6.0 * some.sigma)
    return float(np.mean(unheld & (~is_within(loops, origin) | (aside < NEAR_M))))


def _points_by_angle(samples: Samples) -> np.ndarray:
    """How many points were seen at each angle of each station [angles]; profiles may repeat an angle."""
    _, first, counts = np.unique(samples.profile, return_index=True, return_counts=True)
    places = np.stack([samples.station[first], samples.angle[first]], 1)
    _, same = np.unique(places, axis=0, return_inverse=True)
    return np.bincount(same.ravel(), counts)


OPPOSITE = np.cos(np.radians(5.0))
MOST = 2
"""Distances that are given."""


def clear_distances(room: RoomOutline, height: float) -> list[tuple[np.ndarray, np.ndarray, Estimate]]:
    """The distances of the opposite walls with most between them, at a height above the floor [m].

    Gives, for each direction, both ends [3], m, a third of the way along what both walls share, and the distance.
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
