"""A drawing on its sheet of paper, in millimetres: with frame, title block, legend, scale bar and notes."""

import re
import textwrap
from dataclasses import dataclass, field, replace

import numpy as np

from jaxscan.drawing.model import LAYERS, SMALL_MM, WIDE, Area, Drawing, Line, Text, group_of, layers_of, strokes
from jaxscan.drawing.sheet import TITLE_MM


BORDER, NOTE = "A-ANNO-TTLB", "A-ANNO-NOTE"
LABEL_MM = 1.6
ROW_MM = 3.0
SAMPLE_MM = 9.0


@dataclass
class Page:
    """All that is on the paper, x to the right and y up from its lower left corner."""

    size_mm: tuple[float, float]
    middle_m: np.ndarray
    """The point of the drawing [2], m, that is in the middle of its part of the paper."""
    middle_mm: np.ndarray
    lines: list[Line] = field(default_factory=list)
    areas: list[Area] = field(default_factory=list)
    texts: list[Text] = field(default_factory=list)

    def line(self, *points: tuple[float, float], layer: str = BORDER) -> None:
        """Add a line through points."""
        self.lines.append(Line(layer, np.array(points)))

    def box(self, low: np.ndarray, high: np.ndarray) -> None:
        """Add a rectangle."""
        self.line(*_rectangle(low, high))

    def write(self, at: tuple[float, float], words: str, height: float, *, layer: str = BORDER) -> None:
        """Add a line of text, the middle of its left end at a point."""
        self.texts.append(Text(layer, np.array(at), words, height, align="left"))

    @property
    def layers(self) -> list[str]:
        """Names of the layers that are used, in the order in which they are drawn."""
        return layers_of([*self.lines, *self.areas, *self.texts])


def lay_out(drawing: Drawing) -> Page:
    """The whole sheet: the border, and the drawing at its scale."""
    page = border(drawing)
    scale = 1.0 / drawing.sheet.paper_m

    def placed(points: np.ndarray) -> np.ndarray:
        return page.middle_mm + scale * (points - page.middle_m)

    lines, texts = strokes(drawing)
    page.lines += [Line(one.layer, placed(one.points)) for one in lines]
    page.areas += [Area(one.layer, placed(one.points)) for one in drawing.areas]
    page.texts += [replace(one, at=placed(one.at), height=scale * one.height) for one in texts]
    return page


def border(drawing: Drawing) -> Page:
    """What is on the sheet beside the drawing: frame, title block, legend, scale bar and notes."""
    sheet = drawing.sheet
    low, high = sheet.room_mm
    page = Page(sheet.size_mm, 0.5 * np.sum(drawing.bounds(), axis=0), 0.5 * (low + high))
    low, high = sheet.frame_mm
    page.box(low, high)
    width, height = TITLE_MM
    if sheet.legend_beside:
        title, legend = np.array([high[0] - width, low[1]]), low
        size = np.array([title[0] - low[0], height])
    else:
        title, legend = low, low + [0.0, height]
        size = np.array([high[0] - low[0], height])
    _title_block(page, drawing, title, np.array([high[0], low[1] + height]))
    page.box(legend, legend + size)
    _legend(page, drawing, legend, legend + size * [0.6, 1.0])
    _notes(page, drawing, legend + size * [0.6, 0.0], legend + size)
    return page


def _rectangle(low: np.ndarray, high: np.ndarray) -> list[tuple[float, float]]:
    (a, b), (c, d) = map(tuple, (low.tolist(), high.tolist()))
    return [(a, b), (c, b), (c, d), (a, d), (a, b)]


def _title_block(page: Page, drawing: Drawing, low: np.ndarray, high: np.ndarray) -> None:
    """Rows of cells, from the top: each with a small label and what it says (ISO 7200)."""
    sheet = drawing.sheet
    north = "not known" if sheet.north_deg is None else f"{sheet.north_deg:g}°"
    north = north if drawing.level else "–"
    rows: list[tuple[float, list[tuple[float, str, str]]]] = [
        (11.0, [(0.6, "project", sheet.project or "–"), (0.4, "room", sheet.room or "–")]),
        (10.0, [(1.0, "drawing", drawing.title)]),
        (
            11.0,
            [
                (0.2, "scale", f"1 : {sheet.scale}"),
                (0.15, "sheet", sheet.size.upper()),
                (0.25, "date", sheet.date or "–"),
                (0.4, "north", north),
            ],
        ),
        (10.0, [(0.65, "frame", drawing.frame or "–"), (0.35, "made by", sheet.made_by)]),
    ]
    page.box(low, high)
    y = float(high[1])
    for height, cells in rows:
        x = float(low[0])
        for share, label, words in cells:
            width = share * float(high[0] - low[0])
            page.write((x + 1.5, y - 2.2), label, LABEL_MM, layer=NOTE)
            shown = min(3.5, (width - 3.0) / (WIDE * len(words)))
            if shown < 1.5:
                lines = textwrap.wrap(words, int((width - 3.0) / (WIDE * 1.5)))[:2]
                for number, line in enumerate(lines):
                    page.write((x + 1.5, y - 4.9 - 2.6 * number), line, 1.5)
            else:
                page.write((x + 1.5, y - 0.5 * height - 1.2), words, shown)
            if label == "north" and sheet.north_deg is not None and drawing.level:
                _north(page, np.array([x + width - 6.0, y - 0.5 * height]), sheet.north_deg)
            x += width
            if x < high[0] - 0.1:
                page.line((x, y), (x, y - height))
        y -= height
        if y > low[1] + 0.1:
            page.line((float(low[0]), y), (float(high[0]), y))


def _north(page: Page, at: np.ndarray, degrees: float) -> None:
    """An arrow through a point, towards north."""
    way = np.array([np.sin(np.radians(degrees)), np.cos(np.radians(degrees))])
    side, tip = np.array([way[1], -way[0]]), at + 3.5 * way
    page.lines.append(Line(BORDER, np.stack([at - 3.5 * way, tip])))
    page.areas.append(Area(BORDER, np.stack([tip, at + 1.3 * side, at - 1.3 * side])))


def _legend(page: Page, drawing: Drawing, low: np.ndarray, high: np.ndarray) -> None:
    """A sample of each layer, and what it means."""
    page.write((low[0] + 2.0, high[1] - 2.5), "legend", LABEL_MM, layer=NOTE)
    used = {group_of(name) for name in drawing.layers}
    y = float(high[1]) - 6.0
    letters = int((high[0] - low[0] - SAMPLE_MM - 7.0) / (WIDE * SMALL_MM))
    for name, layer in LAYERS.items():
        if name not in used or not layer.means:
            continue
        words = textwrap.wrap(layer.means, letters)
        left, right = float(low[0]) + 2.0, float(low[0]) + 2.0 + SAMPLE_MM
        if f"{name}-PATT" in used:
            page.areas.append(
                Area(f"{name}-PATT", np.array(_rectangle(np.array([left, y - 1.0]), np.array([right, y + 0.6]))))
            )
        middle = y + 0.6 if f"{name}-PATT" in used else y
        page.line((left, middle), (right, middle), layer=name)
        if name == "A-ANNO-DIMS":
            for x in (left + 1.0, right - 1.0):
                page.line((x - 0.8, y - 0.8), (x + 0.8, y + 0.8), layer=name)
        for line in words:
            page.write((right + 2.5, y), line, SMALL_MM)
            y -= ROW_MM
        y -= 0.5


def _notes(page: Page, drawing: Drawing, low: np.ndarray, high: np.ndarray) -> None:
    """The scale bar, and sentences below it."""
    scale = 1.0 / drawing.sheet.paper_m
    most = min(45.0, float(high[0] - low[0]) - 14.0)
    steps = [step * 10.0**power for power in range(-3, 4) for step in (1.0, 2.0, 5.0)]
    whole = max((step for step in steps if step * scale <= most), default=steps[0])
    left, y = float(low[0]) + 3.0, float(high[1]) - 8.0
    for number in range(4):
        ends = [left + 0.25 * (number + k) * whole * scale for k in (0, 1)]
        rectangle = _rectangle(np.array([ends[0], y]), np.array([ends[1], y + 1.2]))
        page.line(*rectangle)
        if number % 2 == 0:
            page.areas.append(Area(BORDER, np.array(rectangle)))
    for share in (0.0, 0.5, 1.0):
        words = f"{share * whole:g}" + (" m" if share == 1.0 else "")
        page.texts.append(Text(BORDER, np.array([left + share * whole * scale, y + 3.2]), words, SMALL_MM))
    letters = int((high[0] - low[0] - 5.0) / (WIDE * SMALL_MM))
    told = ["± is one standard deviation.", *drawing.facts, *drawing.remarks]
    # A number stays with its unit.
    told = [re.sub(r" (?=±|(m|mm|m²|m³)\b)", "\xa0", sentence) for sentence in told]
    rows = [line.replace("\xa0", " ") for sentence in told for line in textwrap.wrap(sentence, letters)]
    room = int((y - low[1] - 3.0) / ROW_MM)
    if len(rows) > room:
        rows = [*rows[: room - 1], "… the program printed the others."]
    for number, line in enumerate(rows):
        page.write((left, y - 3.5 - ROW_MM * number), line, SMALL_MM)
