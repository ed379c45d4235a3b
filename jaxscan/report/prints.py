"""Boards on paper: sheets in true size, as PDF and SVG."""

import math
from collections.abc import Iterable, Sequence
from typing import Literal, NamedTuple, get_args
from xml.sax.saxutils import escape

import numpy as np

from jaxscan.drawing import SIZES_MM
from jaxscan.errors import OptionError
from jaxscan.geometry import AbstractBoard, Charuco, Circles
from jaxscan.vision import Ink, board_ink


def decimal(value: float) -> str:
    """A length to a ten-thousandth, without an exponent, which PDF does not know."""
    return f"{value:.4f}".rstrip("0").rstrip(".")


Paper = Literal["A4", "A3", "A2", "A1", "letter"]
PAPERS: tuple[Paper, ...] = get_args(Paper)
_SIZES_MM: dict[Paper, tuple[float, float]] = {
    "A4": SIZES_MM["a4"],
    "A3": SIZES_MM["a3"],
    "A2": SIZES_MM["a2"],
    "A1": SIZES_MM["a1"],
    "letter": (215.9, 279.4),
}
MARGIN_MM = 6.0
"""What printers leave white, and a little more."""
GAP_MM, FOOTER_MM = 4.0, 11.0
"""White under the board, and the lines of text below that."""
MARKS_MM = 6.0
"""Room for marks round the part of a board that is cut out of several sheets."""
OVERLAP_MM = 12.0
_MOST_SHEETS = 100
_ROUNDING_MM = 1e-6


class SheetLayout(NamedTuple):
    """Sheets of one size, in columns and rows, and the part of the board on each; millimetres."""

    page: tuple[float, float]
    columns: int
    rows: int
    tile: tuple[float, float]
    """Width and height of the part of a sheet, with what it shares with its neighbours."""

    @property
    def sheets(self) -> int:
        """Number of sheets."""
        return self.columns * self.rows


def lay_out(size: tuple[float, float], paper: Paper) -> SheetLayout:
    """The fewest sheets that hold a board of this size [mm], upright or across.

    Raises:
        OptionError: If there are too many, with a paper that needs fewer.
    """
    layout = _fewest(size, paper)
    if layout.sheets > _MOST_SHEETS:
        raise OptionError(
            f"--paper {paper}: the board of {size[0]:g} x {size[1]:g} mm needs {layout.sheets} sheets, expected at "
            f"most {_MOST_SHEETS}; choose a larger paper or a smaller board."
        )
    return layout


def one_sheet(size: tuple[float, float]) -> Paper | None:
    """The smallest paper that holds a board of this size [mm] in one sheet, if there is one."""
    fitting = [paper for paper in PAPERS if _fewest(size, paper).sheets == 1]
    return min(fitting, key=lambda paper: math.prod(_SIZES_MM[paper]), default=None)


def _fewest(size: tuple[float, float], paper: Paper) -> SheetLayout:
    short, long = _SIZES_MM[paper]
    # If both need as many, the first is taken: it lies as the board does.
    pages = [(short, long), (long, short)] if size[0] <= size[1] else [(long, short), (short, long)]
    return min((_sheets(size, page) for page in pages), key=lambda layout: layout.sheets)


def _sheets(size: tuple[float, float], page: tuple[float, float]) -> SheetLayout:
    free = (page[0] - 2 * MARGIN_MM, page[1] - 2 * MARGIN_MM - GAP_MM - FOOTER_MM)
    if all(length <= room + _ROUNDING_MM for length, room in zip(size, free, strict=True)):
        return SheetLayout(page, 1, 1, size)
    free = (free[0] - 2 * MARKS_MM, free[1] - 2 * MARKS_MM)
    count, tile = [], []
    for length, room in zip(size, free, strict=True):
        count.append(max(1, math.ceil((length - OVERLAP_MM - _ROUNDING_MM) / (room - OVERLAP_MM))))
        tile.append((length + (count[-1] - 1) * OVERLAP_MM) / count[-1])
    return SheetLayout(page, count[0], count[1], (tile[0], tile[1]))


RULER_MM = 100.0
_LINE_MM = 0.2
_TEXT_MM, _SMALL_MM = 2.8, 2.2


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
    """The sheets of a board in true size, row after row, and what to know before they are printed.

    Sheets lie upright or across, whichever needs fewer.

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


def _page(layout: SheetLayout, ink: Ink, place: tuple[int, int], words: str) -> Page:
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


def _marks(layout: SheetLayout, place: tuple[int, int], window: tuple[float, float, float, float]) -> list[list[float]]:
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


def svg_of(page: Page, title: str) -> bytes:
    """The file of one sheet in true size."""
    width, height = decimal(page.width), decimal(page.height)
    ink = [*map(_svg_rectangle, page.ink.rectangles), *map(_svg_circle, page.ink.circles)]
    size = f'width="{width}mm" height="{height}mm" viewBox="0 0 {width} {height}"'
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {size}>',
        f"<title>{escape(title)}</title>",
        f'<clipPath id="window"><path d="{_svg_rectangle(page.window)}"/></clipPath>',
        f'<path d="M0 0H{width}V{height}H0Z" fill="white"/>',
        # All in one path: where rectangles touch, no viewer leaves a white hair between them.
        f'<path clip-path="url(#window)" d="{" ".join(ink)}"/>',
        f'<path d="{" ".join(map(_svg_rectangle, page.rectangles))}"/>',
    ]
    for text in page.texts:
        place = f'x="{decimal(text.x)}" y="{decimal(text.y)}" font-size="{decimal(text.size)}"'
        lines.append(f'<text {place} font-family="Helvetica, Arial, sans-serif">{escape(text.text)}</text>')
    return ("\n".join([*lines, "</svg>"]) + "\n").encode()


def _svg_rectangle(box: Iterable[float]) -> str:
    x0, y0, x1, y1 = map(decimal, box)
    return f"M{x0} {y0}H{x1}V{y1}H{x0}Z"


def _svg_circle(circle: Iterable[float]) -> str:
    x, y, radius = circle
    r, across = decimal(radius), decimal(2 * radius)
    return f"M{decimal(x)} {decimal(y - radius)}a{r} {r} 0 0 1 0 {across}a{r} {r} 0 0 1 0 -{across}Z"


# Sheets as PDF: filled rectangles and circles, and Helvetica, which every reader has.
#
# Written out here: a plotting library would embed fonts, and cannot ask the reader to print without scaling.

_POINTS_PER_MM = 72 / 25.4
_ROUND = 4 / 3 * (np.sqrt(2) - 1)
"""Distance of the control points of a quarter of a circle, in radii; it is off by 0.03 % of a radius at most."""


def pdf_of(pages: Sequence[Page], title: str) -> bytes:
    """The file of some sheets, each a page in true size."""
    kids = " ".join(f"{4 + 2 * k} 0 R" for k in range(len(pages)))
    objects = [
        # Readers that heed it print in true size.
        "<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        f"<< /Type /Pages /Kids [{kids}] /Count {len(pages)} >>",
        "<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>",
    ]
    for k, page in enumerate(pages):
        size = f"{decimal(page.width * _POINTS_PER_MM)} {decimal(page.height * _POINTS_PER_MM)}"
        objects.append(
            f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {size}] /Contents {5 + 2 * k} 0 R "
            "/Resources << /Font << /F1 3 0 R >> >> >>"
        )
        content = _content(page)
        objects.append(f"<< /Length {len(content.encode('cp1252'))} >>\nstream\n{content}\nendstream")
    objects.append(f"<< /Title ({_escaped(title)}) /Producer (jaxscan) >>")
    data, places = b"%PDF-1.6\n", []
    for number, body in enumerate(objects, 1):
        places.append(len(data))
        data += f"{number} 0 obj\n{body}\nendobj\n".encode("cp1252")
    table = "".join(f"{place:010d} 00000 n \n" for place in places)
    end = (
        f"trailer\n<< /Size {len(objects) + 1} /Root 1 0 R /Info {len(objects)} 0 R >>\nstartxref\n{len(data)}\n%%EOF\n"
    )
    return data + f"xref\n0 {len(objects) + 1}\n0000000000 65535 f \n{table}{end}".encode("cp1252")


def _content(page: Page) -> str:
    """The operators that draw a sheet, in millimetres with y down."""
    scale = f"{_POINTS_PER_MM:.10f}"
    lines = [f"{scale} 0 0 -{scale} 0 {decimal(page.height * _POINTS_PER_MM)} cm"]
    x0, y0, x1, y1 = page.window
    lines += ["q", f"{_pdf_rectangle(x0, y0, x1, y1)} W n"]
    # All in one path: where rectangles touch, no reader leaves a white hair between them.
    lines += [_pdf_rectangle(*box) for box in page.ink.rectangles]
    lines += [_pdf_circle(*circle) for circle in page.ink.circles]
    lines += ["f", "Q", *(_pdf_rectangle(*box) for box in page.rectangles), "f", "BT"]
    for text in page.texts:
        size = decimal(text.size)
        lines.append(f"/F1 1 Tf {size} 0 0 -{size} {decimal(text.x)} {decimal(text.y)} Tm ({_escaped(text.text)}) Tj")
    return "\n".join([*lines, "ET"])


def _pdf_rectangle(x0: float, y0: float, x1: float, y1: float) -> str:
    return f"{decimal(x0)} {decimal(y0)} {decimal(x1 - x0)} {decimal(y1 - y0)} re"


def _pdf_circle(x: float, y: float, radius: float) -> str:
    reach = _ROUND * radius
    cos, sin = (1, 0, -1, 0, 1), (0, 1, 0, -1, 0)
    words = [f"{decimal(x + radius)} {decimal(y)} m"]
    for k in range(4):
        points = [
            (radius * cos[k] - reach * sin[k], radius * sin[k] + reach * cos[k]),
            (radius * cos[k + 1] + reach * sin[k + 1], radius * sin[k + 1] - reach * cos[k + 1]),
            (radius * cos[k + 1], radius * sin[k + 1]),
        ]
        words.append(" ".join(f"{decimal(x + a)} {decimal(y + b)}" for a, b in points) + " c")
    return " ".join(words)


def _escaped(text: str) -> str:
    for sign in "\\()":
        text = text.replace(sign, f"\\{sign}")
    return text.encode("cp1252", "replace").decode("cp1252")
