"""A vertical section through a room."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from jaxscan.drawing.contours import cut, joined_quads, kept_parts, simplified, steep_quads
from jaxscan.drawing.labels import Obstacles
from jaxscan.drawing.model import Area, DimensionLine, Drawing, Line, dimension, known_dimensions, with_origin
from jaxscan.drawing.plan import BAND_MM, LAYER_OF, ROW_MM, SHORTEST_M, room_words
from jaxscan.drawing.sheet import Sheet
from jaxscan.drawing.survey import WALL_M, Survey
from jaxscan.errors import MeasurementError
from jaxscan.measurement.outline import Estimate, Opening
from jaxscan.measurement.outline.corners import Surface, corner_of, length_between


WITHIN_M = 0.06
"""A section runs within a wall if both ends of the wall are nearer to it than this [m]."""
MOVED_M = 0.08
"""Such a section is moved to this distance before the wall [m]: farther than what is taken for the wall."""


class _End(NamedTuple):
    """Where the section meets a wall, s metres along it."""

    s: float
    surface: Surface
    seen: bool
    openings: list[Opening]


def section_before(survey: Survey, wall: str, distance_m: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """The two points of the plan [m] of a section parallel to a wall, at a distance before it; for `draw_section`.

    Raises:
        MeasurementError: If there is no wall of this name.
    """
    walls = {one.side.name: one for one in survey.walls()}
    if wall in walls:
        step = distance_m * walls[wall].inward
        (ax, ay), (bx, by) = walls[wall].start + step, walls[wall].end + step
        return (float(ax), float(ay)), (float(bx), float(by))
    raise MeasurementError(f"found no wall {wall:.40}, expected one of the plan's: {', '.join(walls)}.")


def draw_section(
    survey: Survey, a: tuple[float, float], b: tuple[float, float], *, sheet: Sheet | None = None
) -> Drawing:
    """Draw what the upright plane through two points of the plan cuts: floor, walls, ceiling and furniture.

    x of the drawing runs from the first point towards the second, y is the height above the floor. Dimensions are the
    widths at the floor and the heights in the middle of each stretch inside.

    Args:
        survey: The room.
        a: First point [m], as in the plan.
        b: Second point [m].
        sheet: What it is drawn on; by default an A4 and the largest standard scale at which the section fits.

    Returns:
        The section; the first point is at x = 0.

    Raises:
        MeasurementError: If the points are one, or the plane does not meet the room.
        OptionError: If the section does not fit the sheet at the scale that was chosen.
    """
    first, second = np.array(a, np.float64), np.array(b, np.float64)
    if np.linalg.norm(second - first) < 0.01:
        raise MeasurementError(
            f"The points {_text(first)} and {_text(second)} of the section are one; give two at least 0.01 m apart."
        )
    along = (second - first) / np.linalg.norm(second - first)
    across = np.array([-along[1], along[0], 0.0])
    step = _out_of_walls(survey, first, across)
    remarks = [f"{remark}." for remark in survey.outline.remarks]
    if step != 0.0:
        first, second = first + step * across[:2], second + step * across[:2]
        remarks.append(
            f"The section ran within a wall and is moved by {100 * abs(step):.0f} cm into the room, through "
            f"{_text(first)}."
        )
    plane = Surface.exact(across, float(across[:2] @ first))
    ends = _ends(survey, plane, first, along)
    if len(ends) < 2:
        low, high = (
            limit([corner.at[:2] for corner in survey.outline.corners()[0]], axis=0) for limit in (np.min, np.max)
        )
        raise MeasurementError(
            f"The section through {_text(first)} and {_text(second)} does not meet the room, which reaches from "
            f"{_text(low)} to {_text(high)} in the plan."
        )
    room = survey.outline
    top = room.height()
    high = float(survey.p[:, 2].max()) if top is None else top.value
    sheet = (sheet or Sheet()).fitted(np.array([ends[-1].s - ends[0].s, high]))
    lines: list[Line] = []
    areas: list[Area] = []
    wanted: list[tuple[Estimate, DimensionLine]] = []
    for left, right in zip(ends[::2], ends[1::2], strict=True):
        some = _stretch(survey, plane, left, right, np.append(along, 0.0), first, sheet.paper_m)
        lines, areas, wanted = lines + some[0], areas + some[1], wanted + some[2]
    dimensions, left_out = known_dimensions(wanted)
    if not dimensions:
        raise MeasurementError(
            f"No dimension of the section through {_text(first)} and {_text(second)} is known to a fifth of itself: "
            "give one that crosses the walls more steeply, or through more of the room."
        )
    remarks += left_out
    lines += [Line("A-FURN", points) for points in _furniture(survey, plane, first, along)]
    words = f"Section through {_text(first)} and {_text(second)} of the plan"
    drawing = with_origin(Drawing(words, sheet, tuple(lines), tuple(areas)), "along", "up")
    obstacles = Obstacles.of(drawing)
    return replace(
        drawing,
        dimensions=tuple(obstacles.dimension(one) for one in dimensions),
        remarks=tuple(remarks),
        facts=tuple(room_words(survey)),
        frame=f"x = 0 at {_text(first)} of the plan, y = 0 on the floor",
        level=False,
    )


def _out_of_walls(survey: Survey, first: np.ndarray, across: np.ndarray) -> float:
    """How far along `across` a section through a point [2] has to be moved so that it does not run within a wall [m].

    Raises:
        MeasurementError: If it runs within another wall there.
    """
    walls = [
        (np.array([wall.start - first, wall.end - first]) @ across[:2], float(np.sign(wall.inward @ across[:2])))
        for wall in survey.walls()
        if wall.side.seen
    ]

    def within(step: float) -> list[float]:
        """Where the section would have to be to be clear of each wall in which it is."""
        return [
            float(sign * (sign * heights).max() + sign * MOVED_M)
            for heights, sign in walls
            if np.abs(heights - step).max() < WITHIN_M
        ]

    steps = within(0.0)
    if not steps:
        return 0.0
    step = max(steps, key=abs)
    if np.ptp(np.sign(steps)) or within(step):
        raise MeasurementError(
            f"The section through {_text(first)} runs within walls on both sides; give one that crosses the room."
        )
    return step


def _text(point: np.ndarray) -> str:
    return "(" + ", ".join(f"{x:.2f}" for x in point) + ")"


def _ends(survey: Survey, plane: Surface, first: np.ndarray, along: np.ndarray) -> list[_End]:
    """All walls that the plane meets, from left to right."""
    ends = []
    for wall in survey.walls():
        one, other = (float(at @ plane.plane.normal[:2] - plane.plane.distance) for at in (wall.start, wall.end))
        if (one > 0) == (other > 0):
            continue
        share = one / (one - other)
        met = wall.start + share * (wall.end - wall.start)
        reached = share * float(np.linalg.norm(wall.end - wall.start))
        cuts = [each for each in wall.openings if each.left.value < reached < each.right.value]
        ends.append(_End(float((met - first) @ along), wall.side.surface, wall.side.seen, cuts))
    return sorted(ends, key=lambda end: end.s)


def _stretch(
    survey: Survey, plane: Surface, left: _End, right: _End, along: np.ndarray, first: np.ndarray, paper_m: float
) -> tuple[list[Line], list[Area], list[tuple[Estimate, DimensionLine]]]:
    """Floor, ceiling and the two walls of a stretch inside, the grey behind their faces, and dimensions."""
    room = survey.outline
    middle = 0.5 * (left.s + right.s)
    upright = Surface.exact(along, float(along[:2] @ first) + middle)
    band = BAND_MM * paper_m

    def flat(p: np.ndarray) -> np.ndarray:
        return np.array([float((p[:2] - first) @ along[:2]), p[2]])

    low = [corner_of(end.surface, plane, room.floor) for end in (left, right)]
    feet = np.stack([flat(corner.at) for corner in low])
    lines = [Line("A-FLOR", feet)]
    areas = [Area("A-WALL-PATT", _behind(feet, np.array([0.0, -band]), band))]
    wanted: list[tuple[Estimate, DimensionLine]] = []
    if room.ceiling is not None:
        heads = np.stack([flat(corner_of(end.surface, plane, room.ceiling).at) for end in (left, right)])
        lines.append(Line("A-CLNG", heads))
        areas.append(Area("A-WALL-PATT", _behind(heads, np.array([0.0, band]), band)))
        ends = [corner_of(upright, plane, surface) for surface in (room.floor, room.ceiling)]
        height = length_between(ends[0], ends[1], room.errors)
        wanted.append((height, dimension(flat(ends[0].at), flat(ends[1].at), 0.0, height)))
    else:
        heads = feet + [0.0, float(survey.p[:, 2].max())]
    for end, foot, head, out in zip((left, right), feet, heads, (-band, band), strict=True):
        some_lines, some_areas = _upright(end, foot, head, np.array([out, 0.0]))
        lines, areas = lines + some_lines, areas + some_areas
    if left.seen and right.seen:
        width = length_between(low[0], low[1], room.errors)
        wanted.append((width, dimension(feet[0], feet[1], -ROW_MM * paper_m, width)))
    return lines, areas, wanted


def _behind(ends: np.ndarray, out: np.ndarray, beyond_m: float = 0.0) -> np.ndarray:
    """The grey behind a face between two ends [2, 2], a little longer than it [4, 2], m."""
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    longer = ends + beyond_m * np.stack([-along, along])
    return np.concatenate([longer, longer[::-1] + out])


def _upright(end: _End, low: np.ndarray, high: np.ndarray, out: np.ndarray) -> tuple[list[Line], list[Area]]:
    """A wall from floor to ceiling, with gaps where it is cut, and the grey behind its face."""
    if not end.seen:
        return [Line("A-WALL-OPEN", np.stack([low, high]))], []

    def at(height: float) -> np.ndarray:
        return low + float(np.clip(height / (high[1] - low[1]), 0.0, 1.0)) * (high - low)

    lines, walls, begun = [], [], 0.0
    for one in sorted(end.openings, key=lambda each: each.bottom.value):
        if one.kind == "panel":
            continue
        walls.append(np.stack([at(begun), at(one.bottom.value)]))
        lines.append(Line(LAYER_OF[one.kind], np.stack([at(one.bottom.value), at(one.top.value)])))
        begun = one.top.value
    walls.append(np.stack([at(begun), high]))
    # An opening that begins on the floor leaves no wall below it.
    walls = [wall for wall in walls if np.linalg.norm(wall[1] - wall[0]) > 1e-9]
    return [*(Line("A-WALL", wall) for wall in walls), *lines], [Area("A-WALL-PATT", _behind(w, out)) for w in walls]


def _furniture(survey: Survey, plane: Surface, first: np.ndarray, along: np.ndarray) -> list[np.ndarray]:
    """Lines in which the plane cuts what stands in the room."""
    height = survey.p @ plane.plane.normal - plane.plane.distance
    quads = steep_quads(joined_quads(survey.quads, survey.p, survey.eye), survey.p, height)
    room = survey.outline
    found = []
    for line in cut(quads, survey.p, height):
        kept = survey.is_inside(line)
        for surface in (room.floor, room.ceiling):
            if surface is not None:
                kept &= surface.plane.distance - line @ surface.plane.normal > 0.5 * WALL_M
        flat = np.stack([(line[:, :2] - first) @ along, line[:, 2]], 1)
        for part in kept_parts(flat, kept):
            if np.linalg.norm(np.diff(part, axis=0), axis=1).sum() >= SHORTEST_M:
                found.append(simplified(part))
    return found
