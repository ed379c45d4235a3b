"""The floor plan of a room at heights above its floor."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jaxscan.drawing.contours import cut, joined_quads, kept_parts, simplified
from jaxscan.drawing.model import TEXT_M, DimensionLine, Drawing, Line, Text, known_dimensions, with_origin, with_sigma
from jaxscan.drawing.survey import Survey
from jaxscan.errors import MeasurementError
from jaxscan.measurement.outline import Estimate, Opening, Side
from jaxscan.measurement.outline.clear import clear_distances


OUTSIDE_M = 0.5
"""Distance of the dimensions of walls from them [m]."""
NEARER_M = 0.22
"""That of the dimensions of doors and windows [m]."""
GLASS_M = 0.05
"""Distance of the two lines of a window in the drawing [m]."""
SHORTEST_M = 0.08
"""Outlines of furniture that are shorter are not drawn [m]."""
LAYER_OF = {"door": "A-DOOR", "window": "A-GLAZ", "opening": "A-WALL-OPEN", "panel": "A-WALL-PANL"}


def draw_plan(survey: Survey, *, heights_m: Sequence[float] = (1.0,)) -> Drawing:
    """Draw walls, what is in them, and the outlines of furniture, with dimensions.

    Lengths and openings are those at the first height. With several heights the furniture of each is on a layer of its
    own, "A-FURN-150" for 1.5 m.

    Args:
        survey: The room.
        heights_m: Heights above the floor [m].

    Returns:
        The plan, in its frame [m].

    Raises:
        MeasurementError: If a height is not between floor and ceiling.
    """
    room = survey.outline
    top = room.height()
    for height in heights_m:
        if not 0 < height < (top.value if top is not None else np.inf):
            ceiling = "any height above it" if top is None else f"{top.value:.3f} m, where the ceiling is"
            raise MeasurementError(f"Height {height:g} m: expected a height above the floor, below {ceiling}.")
    first = heights_m[0]
    lines: list[Line] = []
    wanted: list[tuple[Estimate, DimensionLine]] = []
    lengths = room.lengths(first)
    texts = []
    for number, (loop, corners) in enumerate(zip(room.loops, room.corners(first), strict=True)):
        at = np.array([corner.at[:2] for corner in corners])
        for i, side in enumerate(loop):
            start, end, length = at[i], at[(i + 1) % len(at)], lengths[number][i]
            cuts = [one for one in survey.openings[number][i] if one.bottom.value < first < one.top.value]
            lines += _wall(side, start, end, cuts)
            wanted += [(one.width, _width(one, start, end)) for one in cuts]
            if length is not None:
                words = with_sigma(length)
                wanted.append((length, DimensionLine("A-ANNO-DIMS", start, end, -OUTSIDE_M, words)))
            texts.append(_name(side, start, end))
    for start_3d, end_3d, found in clear_distances(room, first):
        words = with_sigma(found)
        wanted.append((found, DimensionLine("A-ANNO-DIMS", start_3d[:2], end_3d[:2], 0.0, words)))
    dimensions, left_out = known_dimensions(wanted)
    remarks = [*(f"{remark}." for remark in room.remarks), *left_out]
    for height in heights_m:
        layer = "A-FURN" if len(heights_m) == 1 else f"A-FURN-{round(100 * height)}"
        lines += [Line(layer, points) for points in _furniture(survey, height)]
    words = f"Plan, cut {' and '.join(f'{height:.2f}' for height in heights_m)} m above the floor"
    drawing = Drawing(words, tuple(lines), tuple(texts), tuple(dimensions), tuple(remarks))
    notes = [f"{words}. ± one standard deviation.", *room_words(survey), *remarks]
    return with_notes(with_origin(drawing, "x", "y"), notes)


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


def with_notes(drawing: Drawing, notes: Sequence[str]) -> Drawing:
    """The drawing with lines of text below it."""
    low, high = drawing.bounds()
    middle = 0.5 * (low[0] + high[0])
    texts = [
        Text("A-ANNO-TEXT", np.array([middle, low[1] - 2.0 * TEXT_M * (i + 1.5)]), words)
        for i, words in enumerate(notes)
    ]
    return replace(drawing, texts=(*drawing.texts, *texts))


def _wall(side: Side, start: np.ndarray, end: np.ndarray, cuts: list[Opening]) -> list[Line]:
    """A wall between its corners, with gaps where it is cut, and what is in them."""
    if not side.seen:
        return [Line("A-WALL-OPEN", np.stack([start, end]))]
    length = float(np.linalg.norm(end - start))
    along = (end - start) / length
    out = np.array([along[1], -along[0]])
    lines, begun = [], 0.0
    for one in cuts:
        ends = np.clip([one.left.value, one.right.value], 0.0, length)
        here = start + ends[:, None] * along
        # How deep an opening is beyond the wall nobody saw.
        depth = float(np.clip(one.depth_m or 0.0, -GLASS_M, GLASS_M))
        if one.kind == "panel":
            shape = np.stack([here[0], here[0] + depth * out, here[1] + depth * out, here[1]])
            lines.append(Line("A-WALL-PANL", shape))
            continue
        lines.append(Line("A-WALL", np.stack([start + begun * along, here[0]])))
        begun = float(ends[1])
        layer = LAYER_OF[one.kind]
        offsets = {"door": (0.0, depth), "window": (0.0, GLASS_M), "opening": (0.0,)}[one.kind]
        lines += [Line(layer, here + offset * out) for offset in sorted(set(offsets))]
        if one.kind == "door":
            lines += [Line(layer, np.stack([jamb - GLASS_M * out, jamb + GLASS_M * out])) for jamb in here]
    return [*lines, Line("A-WALL", np.stack([start + begun * along, end]))]


def _width(one: Opening, start: np.ndarray, end: np.ndarray) -> DimensionLine:
    along = (end - start) / np.linalg.norm(end - start)
    words = f"{one.kind} {with_sigma(one.width)}"
    return DimensionLine(
        "A-ANNO-DIMS", start + one.left.value * along, start + one.right.value * along, -NEARER_M, words
    )


def _name(side: Side, start: np.ndarray, end: np.ndarray) -> Text:
    along = (end - start) / np.linalg.norm(end - start)
    inward = np.array([-along[1], along[0]])
    return Text("A-ANNO-TEXT", start + 0.12 * (end - start) + 0.15 * inward, side.name)


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
