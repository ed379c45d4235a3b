"""The sheets of a board: its ink, a ruler, what it is, and marks where several sheets are joined."""

from typing import NamedTuple

import numpy as np

from jaxscan.geometry import AbstractBoard, Charuco, Circles
from jaxscan.report.prints.papers import (
    FOOTER_MM,
    GAP_MM,
    MARGIN_MM,
    MARKS_MM,
    OVERLAP_MM,
    Layout,
    Paper,
    lay_out,
    one_sheet,
)
from jaxscan.vision import Ink, board_ink


RULER_MM = 100.0
_LINE_MM = 0.2
_TEXT_MM, _SMALL_MM = 2.8, 2.2
"""Heights of letters."""


class Text(NamedTuple):
    """A line of text that begins at a point of its base line [mm]."""

    x: float
    y: float
    size: float
    text: str


class Page(NamedTuple):
    """A sheet of paper; millimetres, x to the right and y down from the upper left corner."""

    width: float
    height: float
    window: tuple[float, float, float, float]
    """x0, y0, x1, y1: the ink of the board is cut off here."""
    ink: Ink
    rectangles: np.ndarray
    """Ruler and marks: x0, y0, x1, y1, float64 [rectangles, 4]."""
    texts: tuple[Text, ...]


def board_pages(board: AbstractBoard, paper: Paper) -> tuple[list[Page], list[str]]:
    """The sheets of a board in true size.

    Args:
        board: The board.
        paper: The size of the sheets, which lie upright or across, whichever needs fewer.

    Returns:
        pages: The sheets, row after row.
        notes: What to know before they are printed.

    Raises:
        OptionError: If it needs too many sheets.
    """
    low, high = board.outline()[[0, 2]] * 1e3
    # Metres and back cost a rounding.
    width, height = (round(float(length), 9) for length in high - low)
    layout = lay_out((width, height), paper)
    ink = board_ink(board)
    ink = Ink(1e3 * ink.rectangles - np.tile(low, 2), 1e3 * ink.circles - np.append(low, 0.0))
    pages = [
        _page(layout, ink, (column, row), _words(board))
        for row in range(layout.rows)
        for column in range(layout.columns)
    ]
    notes = []
    if layout.sheets > 1:
        larger = one_sheet((width, height))
        instead = f"; one sheet of {larger} holds it" if larger else ""
        notes.append(f"{layout.sheets} sheets of {paper}, and a joint is never as true as a print{instead}")
    return pages, notes


def _words(board: AbstractBoard) -> str:
    """What the board is, and the longest lengths on it that can be measured."""
    more = ""
    if isinstance(board, Charuco):
        more = f", markers {1e3 * board.marker:g} mm, {board.dictionary}"
    elif isinstance(board, Circles):
        more = f", diameter {1e3 * board.diameter:g} mm"
    across, down = 1e3 * np.ptp(board.places(), axis=0)
    name = "centres" if isinstance(board, Circles) else "corners"
    return f"{board.describe()}{more}; outermost {name} {across:g} mm across, {down:g} mm down"


def _page(layout: Layout, ink: Ink, place: tuple[int, int], words: str) -> Page:
    several = layout.sheets > 1
    (width, height), (tile_x, tile_y) = layout.page, layout.tile
    footer = height - MARGIN_MM - FOOTER_MM
    left, top = (width - tile_x) / 2, (MARGIN_MM + footer - GAP_MM - tile_y) / 2
    window = (left, top, left + tile_x, top + tile_y)
    start = np.array(place) * (np.array(layout.tile) - OVERLAP_MM)
    shift = np.array([left, top]) - start
    shown = Ink(ink.rectangles + np.tile(shift, 2), ink.circles + np.append(shift, 0.0))
    texts = [
        Text(MARGIN_MM, footer + 2.6, _TEXT_MM, words),
        Text(
            MARGIN_MM + RULER_MM + 12.0,
            footer + 6.4,
            _SMALL_MM,
            f"Print at 100 %. Check: the ruler has {RULER_MM:g} mm.",
        ),
    ]
    rectangles, numbers = _ruler(MARGIN_MM, footer + 4.0)
    if several:
        rectangles += _marks(layout, place, window)
        column, row = place
        sheet = f"Sheet {row * layout.columns + column + 1} of {layout.sheets} (row {row + 1}, column {column + 1})."
        texts.append(Text(texts[1].x, footer + 9.6, _SMALL_MM, f"{sheet} Cut at the marks, join edge to edge."))
    return Page(width, height, window, _within(shown, window), np.array(rectangles), (*texts, *numbers))


def _within(ink: Ink, window: tuple[float, float, float, float]) -> Ink:
    """The shapes of which a part is in the window."""
    low, high = np.array(window[:2]), np.array(window[2:])
    boxes, (x, y, radius) = ink.rectangles, ink.circles.T
    outer = np.stack([x - radius, y - radius, x + radius, y + radius], -1)
    seen = [np.all((box[:, 2:] > low) & (box[:, :2] < high), axis=1) for box in (boxes, outer)]
    return Ink(boxes[seen[0]], ink.circles[seen[1]])


def _ruler(x: float, y: float) -> tuple[list[list[float]], list[Text]]:
    """A ruler that hangs from a line, and its numbers; the outer sides of the first and last mark are its ends."""
    rectangles = [[x, y, x + RULER_MM, y + _LINE_MM]]
    for at in range(int(RULER_MM) + 1):
        length = 3.0 if at % 10 == 0 else 2.2 if at % 5 == 0 else 1.4
        centre = min(max(x + at, x + _LINE_MM / 2), x + RULER_MM - _LINE_MM / 2)
        rectangles.append([centre - _LINE_MM / 2, y, centre + _LINE_MM / 2, y + length])
    numbers = ((0, "0"), (50, "50"), (int(RULER_MM), f"{RULER_MM:g} mm"))
    return rectangles, [Text(x + at + 0.5, y + 5.2, _SMALL_MM, number) for at, number in numbers]


def _marks(layout: Layout, place: tuple[int, int], window: tuple[float, float, float, float]) -> list[list[float]]:
    """Where a sheet is cut: a pair of lines beside the window for every neighbour, in the middle of what both show."""
    x0, y0, x1, y1 = window
    gap, end, half = 0.5, MARKS_MM - 0.5, _LINE_MM / 2
    cuts = [(x0, x1), (y0, y1)]
    marks = []
    for axis, (index, count) in enumerate(zip(place, (layout.columns, layout.rows), strict=True)):
        near, far = cuts[axis]
        places = ([near + OVERLAP_MM / 2] if index > 0 else []) + ([far - OVERLAP_MM / 2] if index < count - 1 else [])
        begin, finish = cuts[1 - axis]
        for at in places:
            for low, high in ((begin - end, begin - gap), (finish + gap, finish + end)):
                marks.append([at - half, low, at + half, high] if axis == 0 else [low, at - half, high, at + half])
    return marks
