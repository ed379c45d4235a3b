"""A drawing: layers of lines, areas, texts and dimensions, in metres, x to the right and y up."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from jaxscan.drawing.sheet import Sheet
from jaxscan.measurement.outline import Estimate
from jaxscan.measurement.samples import LEAST_KNOWN


TEXT_MM, SMALL_MM = 2.5, 1.8
"""Height of capital letters on paper: of dimensions and texts (ISO 3098), and of their standard deviations."""
WIDE = 0.82
"""Width of a letter over the height of capitals, on average [1]; those of `_WIDTHS` differ most from it."""
_WIDTHS = dict.fromkeys("WMmw", 1.35) | dict.fromkeys("0123456789", 0.88)
_WIDTHS |= dict.fromkeys(" .,:;il'|", 0.45)
EM = 1.37
"""Size of a font over the height of its capitals [1]."""
GAP_MM = 1.0
TICK_MM = 1.2
"""Half of the tick at the end of a dimension, along each axis."""


@dataclass(frozen=True)
class Layer:
    """How the lines and areas of a layer look."""

    means: str
    """For the legend; empty where another layer says it."""
    colour: int
    """Colour index of DXF; 7 is black on white paper, 9 and 254 are greys."""
    rgb: str
    width_mm: float
    dashed: bool = False


LAYERS = {
    "A-WALL-PATT": Layer("", 254, "#d3d8dd", 0.0),
    "A-FURN-PATT": Layer("", 254, "#e6e9ec", 0.0),
    "A-FURN-OTLN": Layer("", 9, "#a9b1b9", 0.13),
    "A-FURN": Layer("furniture: line where the cut meets it, grey where seen below the cut", 9, "#7b8590", 0.25),
    "A-WALL": Layer("inner face of a wall; its thickness is not known from within", 7, "#1c2530", 0.5),
    "A-WALL-OPEN": Layer("opening, or side on which no wall was seen", 8, "#8a939e", 0.25, True),
    "A-WALL-PANL": Layer("panel on a wall: window, picture or board", 30, "#c97b00", 0.35),
    "A-DOOR": Layer("door; hinge and swing are drawn by convention, not measured", 3, "#00735c", 0.35),
    "A-DOOR-SWNG": Layer("", 3, "#00735c", 0.18),
    "A-GLAZ": Layer("window", 4, "#0072b2", 0.35),
    "A-FLOR": Layer("floor", 7, "#1c2530", 0.5),
    "A-CLNG": Layer("ceiling", 7, "#1c2530", 0.5),
    "A-ANNO-DIMS": Layer("distance, and below it one standard deviation", 5, "#3d4854", 0.13),
    "A-ANNO-TEXT": Layer("", 7, "#1c2530", 0.18),
    "A-ANNO-SYMB": Layer("origin and axes, by which sections are chosen", 1, "#d55e00", 0.3),
    "A-ANNO-TTLB": Layer("", 7, "#1c2530", 0.25),
    "A-ANNO-NOTE": Layer("", 8, "#5b6672", 0.13),
}
"""Layers by the names that architects use, in the order in which they are drawn."""


@dataclass(frozen=True)
class Line:
    """A line through points."""

    layer: str
    points: np.ndarray
    """[n, 2], m; on paper mm."""


@dataclass(frozen=True)
class Area:
    """A filled polygon without holes."""

    layer: str
    points: np.ndarray
    """[n, 2], m; on paper mm."""


@dataclass(frozen=True)
class Text:
    """A line of text."""

    layer: str
    at: np.ndarray
    """Its middle, or the middle of its left end [2], m; on paper mm."""
    words: str
    height: float
    """Height of its capital letters, in the unit of `at`."""
    angle: float = 0.0
    """Angle from x to the line of text, anticlockwise [rad]."""
    align: Literal["middle", "left"] = "middle"

    def box(self, margin: float = 0.0) -> np.ndarray:
        """Its four corners in order, with a margin around [4, 2], about: fonts differ."""
        half = 0.5 * self.height * np.array([sum(_WIDTHS.get(each, WIDE) for each in self.words), 1.2]) + margin
        corners = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        if self.align == "left":
            corners = corners + [half[0] - margin, 0.0]
        c, s = np.cos(self.angle), np.sin(self.angle)
        return self.at + corners @ np.array([[c, s], [-s, c]])


@dataclass(frozen=True)
class DimensionLine:
    """The distance of two points, written beside them."""

    layer: str
    start: np.ndarray
    """[2], m."""
    end: np.ndarray
    """[2], m."""
    offset_m: float
    """How far to the left of the way from start to end it is drawn [m]; to the right where negative."""
    value: str
    sigma: str
    shift: np.ndarray = field(default_factory=lambda: np.zeros(2))
    """Shift of the texts from the middle of the line, as it is read: to the right and upwards [2], m."""

    @property
    def words(self) -> str:
        """Distance and standard deviation."""
        return f"{self.value} {self.sigma}"

    @property
    def length_m(self) -> float:
        """The distance of the points as they are drawn [m]."""
        return float(np.linalg.norm(self.end - self.start))

    @property
    def ends(self) -> np.ndarray:
        """Both ends of the dimension line [2, 2], m."""
        along = (self.end - self.start) / self.length_m
        return np.stack([self.start, self.end]) + self.offset_m * np.array([-along[1], along[0]])

    @property
    def angle(self) -> float:
        """Angle of its texts [rad]; they are read from below or from the right, and walls are never quite upright."""
        along = self.end - self.start
        angle = float(np.arctan2(along[1], along[0]))
        return angle + np.pi * (angle > np.pi / 2 + 0.1 or angle < -np.pi / 2 + 0.1)

    def texts(self, paper_m: float) -> tuple[Text, Text]:
        """Distance and standard deviation; a millimetre of the paper is so long [m]."""
        c, s = np.cos(self.angle), np.sin(self.angle)
        right, up = np.array([c, s]), np.array([-s, c])
        middle = self.ends.mean(0) + self.shift[0] * right + self.shift[1] * up
        above, below = (paper_m * (GAP_MM + 0.5 * height) for height in (TEXT_MM, SMALL_MM))
        return (
            Text(self.layer, middle + above * up, self.value, paper_m * TEXT_MM, self.angle),
            Text(self.layer, middle - below * up, self.sigma, paper_m * SMALL_MM, self.angle),
        )


@dataclass(frozen=True)
class Drawing:
    """A drawing and the numbers in it."""

    title: str
    sheet: Sheet
    lines: tuple[Line, ...] = ()
    areas: tuple[Area, ...] = ()
    texts: tuple[Text, ...] = ()
    dimensions: tuple[DimensionLine, ...] = ()
    remarks: tuple[str, ...] = ()
    """Departures from the request, and omissions: a sentence each."""
    facts: tuple[str, ...] = ()
    """What else was measured: a sentence each."""
    frame: str = ""
    level: bool = True
    """Whether it is seen from above, so that north is a direction of it."""

    @property
    def layers(self) -> list[str]:
        """Names of the layers that are used, in the order of `LAYERS`."""
        return layers_of([*self.lines, *self.areas, *self.texts, *self.dimensions])

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """The lower left and the upper right corner of all that is drawn [2], m."""
        lines, texts = strokes(self)
        shapes = [*(line.points for line in lines), *(area.points for area in self.areas)]
        every = np.concatenate([*shapes, *(text.box() for text in texts)])
        return every.min(0), every.max(0)


def layers_of(drawn: "Iterable[Line | Area | Text | DimensionLine]") -> list[str]:
    """Names of the layers of shapes, in the order in which they are drawn."""
    return sorted({one.layer for one in drawn}, key=lambda name: (list(LAYERS).index(group_of(name)), name))


def layer_of(name: str) -> Layer:
    """The look of a layer; "A-FURN-150" looks like "A-FURN"."""
    return LAYERS[group_of(name)]


def group_of(name: str) -> str:
    """The layer of `LAYERS` to which a layer belongs."""
    while name not in LAYERS:
        name = name.rpartition("-")[0]
    return name


def strokes(drawing: Drawing) -> tuple[list[Line], list[Text]]:
    """The drawing with every dimension as lines and texts, for formats that know no dimensions."""
    paper = drawing.sheet.paper_m
    lines, texts = list(drawing.lines), list(drawing.texts)
    for one in drawing.dimensions:
        along = (one.end - one.start) / one.length_m
        across = float(np.sign(one.offset_m) or 1.0) * np.array([-along[1], along[0]])
        lines.append(Line(one.layer, one.ends))
        tick = TICK_MM * paper * (along + np.array([-along[1], along[0]]))
        for at, end in zip((one.start, one.end), one.ends, strict=True):
            lines.append(Line(one.layer, np.stack([end - tick, end + tick])))
            if abs(one.offset_m) > 4.0 * paper:
                lines.append(Line(one.layer, np.stack([at + 3.0 * paper * across, end + 1.5 * paper * across])))
        texts += one.texts(paper)
    return lines, texts


AXIS_MM = 8.0


def with_origin(drawing: Drawing, across: str, up: str) -> Drawing:
    """The drawing with its origin and the names of its two axes, by which sections are chosen."""
    layer, paper = "A-ANNO-SYMB", drawing.sheet.paper_m
    texts = [Text(layer, paper * np.array([-3.3, -3.3]), "0", paper * SMALL_MM)]
    lines = []
    for axis, name in ((np.array([1.0, 0.0]), across), (np.array([0.0, 1.0]), up)):
        tip, side = paper * AXIS_MM * axis, 0.7 * paper * axis[::-1]
        lines.append(Line(layer, np.stack([np.zeros(2), tip])))
        lines.append(Line(layer, np.stack([tip - 1.6 * paper * axis + side, tip, tip - 1.6 * paper * axis - side])))
        # Beside the walls, which often lie on the axes.
        texts.append(Text(layer, tip - 3.3 * paper * axis[::-1], name, paper * SMALL_MM))
    return replace(drawing, lines=(*drawing.lines, *lines), texts=(*drawing.texts, *texts))


def known_dimensions(
    found: Iterable[tuple[Estimate, DimensionLine]],
) -> tuple[list[DimensionLine], list[str]]:
    """The dimensions of lengths that are known, and a remark about those that are left out."""
    drawn, left = [], 0
    for length, line in found:
        if length.known:
            drawn.append(line)
        else:
            left += 1
    return drawn, [unknown_words(left, "dimension")] if left else []


def unknown_words(count: int, what: str) -> str:
    """The sentence about numbers that are left out."""
    share = f"standard deviation{'s are' if count > 1 else ' is'} above {100 * LEAST_KNOWN:.0f} % of"
    whose, of = ("their", "themselves") if count > 1 else ("its", "itself")
    return f"{count} {what}{'s' if count > 1 else ''} left out: {whose} {share} {of}."


def dimension(start: np.ndarray, end: np.ndarray, offset_m: float, found: Estimate) -> DimensionLine:
    """The dimension of a length between two points [2], m."""
    return DimensionLine("A-ANNO-DIMS", start, end, offset_m, *words_of(found))


def words_of(found: Estimate) -> tuple[str, str]:
    """A length in metres, and one standard deviation in millimetres."""
    return f"{found.value:.3f} m", f"±{digits(1e3 * found.sigma)} mm"


def with_sigma(found: Estimate) -> str:
    """A length in words: metres, and one standard deviation in millimetres."""
    return " ".join(words_of(found))


def digits(sigma: float) -> str:
    """A standard deviation with about two digits."""
    return f"{sigma:.0f}" if sigma >= 10 else f"{sigma:.1f}" if sigma >= 0.95 else f"{sigma:.2f}"
