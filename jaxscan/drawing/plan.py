"""The floor plan of a room at heights above its floor."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from jaxscan.drawing.contours import cut, joined_quads, kept_parts, outlines, simplified
from jaxscan.drawing.labels import Obstacles
from jaxscan.drawing.model import (
    SMALL_MM,
    TEXT_MM,
    Area,
    DimensionLine,
    Drawing,
    Line,
    Text,
    dimension,
    known_dimensions,
    with_origin,
    with_sigma,
)
from jaxscan.drawing.sheet import Sheet
from jaxscan.drawing.survey import Survey, outward
from jaxscan.errors import MeasurementError
from jaxscan.measurement.grid import Quads
from jaxscan.measurement.outline import Estimate, Opening, Side
from jaxscan.measurement.outline.openings import difference
from jaxscan.measurement.outline.outline import clear_distances


ROW_MM = 9.0
"""Distance from a wall to the first row of dimensions, and from that row to the second."""
BAND_MM = 2.0
"""Width of the grey behind the face of a wall, whose thickness is unknown."""
GLASS_M = 0.05
"""Distance of the two lines of a window in the drawing [m]."""
SHORTEST_M = 0.08
"""Outlines of furniture that are shorter are not drawn [m]."""
LOWEST_M = 0.08
"""Surfaces lower than this are the floor and what lies on it [m]."""
LEAST_PIECE_M = 0.02
"""Pieces of a wall beside its openings that are shorter have no dimension [m]."""
LAYER_OF = {"door": "A-DOOR", "window": "A-GLAZ", "opening": "A-WALL-OPEN", "panel": "A-WALL-PANL"}


def draw_plan(survey: Survey, *, heights_m: Sequence[float] = (1.0,), sheet: Sheet | None = None) -> Drawing:
    """Draw walls, what is in them, and furniture, with dimensions, for a sheet of paper.

    Lengths and openings are those at the first height. With several heights the furniture of each is on a layer of its
    own, "A-FURN-150" for 1.5 m.

    Args:
        survey: The room.
        heights_m: Heights above the floor [m].
        sheet: What it is drawn on; by default an A4 and the largest standard scale at which the room fits.

    Returns:
        The plan, in its frame [m].

    Raises:
        MeasurementError: If a height is not between floor and ceiling.
        OptionError: If the room does not fit the sheet at the scale that was chosen.
    """
    room = survey.outline
    top = room.height()
    for height in heights_m:
        if not 0 < height < (top.value if top is not None else np.inf):
            ceiling = "any height above it" if top is None else f"{top.value:.3f} m, where the ceiling is"
            raise MeasurementError(f"Height {height:g} m: expected a height above the floor, below {ceiling}.")
    first = heights_m[0]
    loops = [np.array([corner.at[:2] for corner in corners]) for corners in room.corners(first)]
    every = np.concatenate(loops)
    sheet = (sheet or Sheet()).fitted(np.ptp(every, axis=0))
    paper = sheet.paper_m
    lines: list[Line] = []
    areas: list[Area] = []
    outside: list[tuple[Estimate, DimensionLine]] = []
    lengths = room.lengths(first)
    for number, (loop, at) in enumerate(zip(room.loops, loops, strict=True)):
        beyond = outward(at, BAND_MM * paper)
        for i, side in enumerate(loop):
            j = (i + 1) % len(at)
            cuts = [one for one in survey.openings[number][i] if one.bottom.value < first < one.top.value]
            some_lines, some_areas = _wall(side, at[[i, j]], beyond[[i, j]], cuts)
            lines, areas = lines + some_lines, areas + some_areas
            outside += _chains(at[i], at[j], lengths[number][i], cuts, paper)
    through = [(found, dimension(start[:2], end[:2], 0.0, found)) for start, end, found in clear_distances(room, first)]
    for height in heights_m:
        more = "" if len(heights_m) == 1 else f"-{round(100 * height)}"
        for points in _seen_below(survey, height):
            areas.append(Area(f"A-FURN-PATT{more}", points))
            lines.append(Line(f"A-FURN-OTLN{more}", points))
        lines += [Line(f"A-FURN{more}", points) for points in _furniture(survey, height)]
    words = f"Plan, cut {' and '.join(f'{height:.2f}' for height in heights_m)} m above the floor"
    drawing = with_origin(Drawing(words, sheet, tuple(lines), tuple(areas)), "x", "y")
    chains, chains_left_out = known_dimensions(outside)
    inner, inner_left_out = known_dimensions(through)
    obstacles = Obstacles.of(drawing)
    for one in chains:
        obstacles.add_line(one.ends)
    chains = [obstacles.dimension(one) for one in chains]
    names = [
        text
        for loop, at in zip(room.loops, loops, strict=True)
        for i, side in enumerate(loop)
        for text in _name(side, at[i], at[(i + 1) % len(at)], obstacles)
    ]
    inner = [obstacles.dimension(one) for one in inner]
    label = obstacles.placed(_room_labels(survey, sheet, loops), 2.0) or []
    remarks = [*(f"{remark}." for remark in room.remarks), *chains_left_out, *inner_left_out]
    return replace(
        drawing,
        texts=(*drawing.texts, *names, *label),
        dimensions=(*chains, *inner),
        remarks=tuple(remarks),
        facts=tuple(room_words(survey)),
        frame=survey.frame_words(),
    )


def room_words(survey: Survey) -> list[str]:
    """Height, area and volume in words, as far as they are known."""
    room = survey.outline
    found = [
        *(f"Height {with_sigma(one)}" for one in [room.height()] if one is not None and one.known),
        *(f"floor {_amount(one)} m²" for one in [room.floor_area()] if one is not None and one.known),
        *(f"volume {_amount(one)} m³" for one in [room.volume()] if one is not None and one.known),
    ]
    return [", ".join(found) + "."] if found else []


def _amount(found: Estimate) -> str:
    return f"{found.value:.3f} ±{found.sigma:.3f}"


def _room_labels(survey: Survey, sheet: Sheet, loops: list[np.ndarray]) -> Iterator[list[Text]]:
    """The name of the room with its area and height, at places within it, those near its middle first."""
    area, height = survey.outline.floor_area(), survey.outline.height()
    rows = [(sheet.room, 3.5)] if sheet.room else []
    rows += [(f"{_amount(area)} m²", TEXT_MM)] if area is not None and area.known else []
    rows += [(f"height {with_sigma(height)}", SMALL_MM)] if height is not None and height.known else []
    if not rows:
        return
    paper = sheet.paper_m
    low, high = loops[0].min(0), loops[0].max(0)
    places = np.stack(np.meshgrid(*(np.linspace(a, b, 25)[1:-1] for a, b in zip(low, high, strict=True))), -1)
    places = places.reshape(-1, 2)
    places = places[survey.is_inside(places)]
    for at in places[np.argsort(np.linalg.norm(places - 0.5 * (low + high), axis=1), kind="stable")]:
        texts, y = [], 0.0
        for words, size in rows:
            y -= 0.5 * size * paper
            texts.append(Text("A-ANNO-TEXT", at + [0.0, y], words, size * paper))
            y -= (0.5 * size + 1.5) * paper
        yield texts


def _wall(side: Side, ends: np.ndarray, beyond: np.ndarray, cuts: list[Opening]) -> tuple[list[Line], list[Area]]:
    """A wall between its corners [2, 2], with gaps where it is cut, what is in them, and the grey behind its face."""
    start, end = ends
    if not side.seen:
        return [Line("A-WALL-OPEN", ends)], []
    length = float(np.linalg.norm(end - start))
    along = (end - start) / length
    out = np.array([along[1], -along[0]])
    behind = float((beyond[0] - start) @ out) * out
    lines: list[Line] = []
    areas: list[Area] = []
    begun, begun_behind = start, beyond[0]
    for one in cuts:
        places = np.clip([one.left.value, one.right.value], 0.0, length)
        here = start + places[:, None] * along
        # The depth of an opening is unknown.
        depth = float(np.clip(one.depth_m or 0.0, -GLASS_M, GLASS_M))
        if one.kind == "panel":
            shape = np.stack([here[0], here[0] + depth * out, here[1] + depth * out, here[1]])
            lines.append(Line("A-WALL-PANL", shape))
            continue
        lines.append(Line("A-WALL", np.stack([begun, here[0]])))
        areas.append(Area("A-WALL-PATT", np.stack([begun, here[0], here[0] + behind, begun_behind])))
        begun, begun_behind = here[1], here[1] + behind
        # The jambs, through the grey of the wall.
        lines += [Line("A-WALL", np.stack([jamb, jamb + behind])) for jamb in here]
        lines += _filling(one, here, depth, out, behind)
    lines.append(Line("A-WALL", np.stack([begun, end])))
    areas.append(Area("A-WALL-PATT", np.stack([begun, end, beyond[1], begun_behind])))
    return lines, areas


def _filling(one: Opening, here: np.ndarray, depth: float, out: np.ndarray, behind: np.ndarray) -> list[Line]:
    """What is drawn in an opening between its jambs [2, 2]."""
    layer = LAYER_OF[one.kind]
    if one.kind == "window":
        return [Line(layer, here + share * behind) for share in (0.0, 0.5, 1.0)]
    if one.kind == "opening":
        return [Line(layer, here + share * behind) for share in (0.0, 1.0)]
    # A leaf at a right angle to the wall and its way, into the room and hinged at the first jamb: a convention.
    leaf = here[1] - here[0]
    turn = np.linspace(0.0, 0.5 * np.pi, 25)[:, None]
    swing = here[0] + np.cos(turn) * leaf - np.sin(turn) * np.linalg.norm(leaf) * out
    return [
        Line("A-DOOR-SWNG", here + depth * out),
        Line("A-DOOR-SWNG", swing),
        Line(layer, np.stack([here[0], swing[-1]])),
    ]


def _chains(
    start: np.ndarray, end: np.ndarray, length: Estimate | None, cuts: list[Opening], paper_m: float
) -> list[tuple[Estimate, DimensionLine]]:
    """Dimensions outside of a wall: its openings and the pieces between them, and beyond them its length."""
    along = (end - start) / np.linalg.norm(end - start)
    pieces: list[tuple[Estimate, Estimate]] = [(one.left, one.right) for one in cuts]
    if length is not None and cuts:
        zero = Estimate(0.0, 0.0, 0.0, 0.0)
        stops = [zero, *(edge for one in cuts for edge in (one.left, one.right)), length]
        pieces = list(itertools.pairwise(stops))
    rows = [
        (found, dimension(start + low.value * along, start + high.value * along, -ROW_MM * paper_m, found))
        for low, high in pieces
        for found in [difference(high, low)]
        if found.value > LEAST_PIECE_M
    ]
    if length is not None:
        rows.append((length, dimension(start, end, -ROW_MM * paper_m * (2 if rows else 1), length)))
    return rows


def _name(side: Side, start: np.ndarray, end: np.ndarray, obstacles: Obstacles) -> list[Text]:
    """The name of a wall, within the room and as near to its middle as there is a place."""
    along = (end - start) / np.linalg.norm(end - start)
    inward = np.array([-along[1], along[0]])
    paper = obstacles.paper_m
    choices = (
        [Text("A-ANNO-TEXT", start + share * (end - start) + away * paper * inward, side.name, TEXT_MM * paper)]
        for away in (4.0, 7.0, 10.5)
        for share in (0.5, 0.45, 0.55, 0.4, 0.6, 0.35, 0.65, 0.3, 0.7, 0.2, 0.8, 0.1, 0.9)
    )
    middle = Text("A-ANNO-TEXT", 0.5 * (start + end) + 4.0 * paper * inward, side.name, TEXT_MM * paper)
    return obstacles.placed(choices) or [middle]


def _furniture(survey: Survey, height: float) -> list[np.ndarray]:
    """Lines in which the level plane cuts what stands in the room."""
    level = survey.outline.floor.raised(height).plane
    over = level.distance - survey.p @ level.normal
    quads = joined_quads(survey.quads, survey.p, survey.eye)
    found = []
    for line in cut(quads, survey.p, over):
        for part in kept_parts(line[:, :2], survey.is_inside(line)):
            if np.linalg.norm(np.diff(part, axis=0), axis=1).sum() >= SHORTEST_M:
                found.append(simplified(part))
    return found


def _seen_below(survey: Survey, height: float) -> list[np.ndarray]:
    """Outlines of what stands on the floor and was seen below a height: the tops of tables, seats and beds."""
    joined = joined_quads(survey.quads, survey.p, survey.eye)
    standing = (survey.p[:, 2] > LOWEST_M) & (survey.p[:, 2] < height) & survey.is_inside(survey.p)
    return outlines(Quads(joined.corners[standing[joined.corners].all(1)]), survey.p[:, :2])
