"""A drawing: layers of lines, texts and dimensions, in metres, x to the right and y up."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from jaxscan.measurement.checked import LEAST_KNOWN
from jaxscan.measurement.outline import Estimate


TEXT_M = 0.09
"""Height of the letters of dimensions [m]."""


@dataclass(frozen=True)
class Layer:
    """How the lines of a layer look."""

    means: str
    colour: int
    """Colour index of DXF; 7 is black on white paper."""
    rgb: str
    """The same for SVG and PDF."""
    width_mm: float
    dashed: bool = False


LAYERS = {
    "A-WALL": Layer("walls", 7, "#1c2530", 0.5),
    "A-WALL-OPEN": Layer("openings, and sides on which no wall was seen", 8, "#8a939e", 0.25, True),
    "A-WALL-PANL": Layer("panels on walls: windows, pictures, boards", 30, "#e69f00", 0.25),
    "A-DOOR": Layer("doors", 3, "#009e73", 0.35),
    "A-GLAZ": Layer("windows", 4, "#56b4e9", 0.35),
    "A-FURN": Layer("furniture", 6, "#cc79a7", 0.18),
    "A-FLOR": Layer("floor", 7, "#1c2530", 0.5),
    "A-CLNG": Layer("ceiling", 7, "#1c2530", 0.5),
    "A-ANNO-DIMS": Layer("dimensions, with one standard deviation", 5, "#0072b2", 0.13),
    "A-ANNO-TEXT": Layer("texts", 7, "#1c2530", 0.13),
    "A-ANNO-SYMB": Layer("origin, axes and scale bar", 1, "#d55e00", 0.35),
}
"""Layers by the names that architects use."""


@dataclass(frozen=True)
class Line:
    """A line through points."""

    layer: str
    points: np.ndarray
    """[n, 2], m."""


@dataclass(frozen=True)
class Text:
    """A line of text, its middle at a point."""

    layer: str
    at: np.ndarray
    """[2], m."""
    words: str
    height_m: float = TEXT_M
    angle: float = 0.0
    """Of the line of text to x, anticlockwise [rad]."""


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
    words: str

    @property
    def length_m(self) -> float:
        """The distance of the points as they are drawn [m]."""
        return float(np.linalg.norm(self.end - self.start))


@dataclass(frozen=True)
class Drawing:
    """A drawing and the numbers in it."""

    title: str
    lines: tuple[Line, ...]
    texts: tuple[Text, ...]
    dimensions: tuple[DimensionLine, ...]
    remarks: tuple[str, ...] = ()
    """What differs from what was asked for, and what is left out: a sentence each."""

    @property
    def layers(self) -> list[str]:
        """Names of the layers that are used, in the order of `LAYERS`."""
        used = {line.layer for line in self.lines} | {text.layer for text in self.texts}
        used |= {one.layer for one in self.dimensions}
        return sorted(used, key=lambda name: (list(LAYERS).index(_group(name)), name))

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """The lower left and the upper right corner of all that is drawn [2], m."""
        lines, texts = strokes(self)
        points = [line.points for line in lines]
        for text in texts:
            # Letters are about 0.6 times as wide as high.
            half = 0.5 * text.height_m * np.array([0.6 * len(text.words), 1.2])
            c, s = abs(np.cos(text.angle)), abs(np.sin(text.angle))
            half = np.array([[c, s], [s, c]]) @ half
            points.append(np.stack([text.at - half, text.at + half]))
        every = np.concatenate(points)
        return every.min(0), every.max(0)


def layer_of(name: str) -> Layer:
    """The look of a layer; "A-FURN-150" looks like "A-FURN"."""
    return LAYERS[_group(name)]


def _group(name: str) -> str:
    while name not in LAYERS:
        name = name.rpartition("-")[0]
    return name


def strokes(drawing: Drawing) -> tuple[list[Line], list[Text]]:
    """The drawing with every dimension as lines and a text, for formats that know no dimensions."""
    lines, texts = list(drawing.lines), list(drawing.texts)
    for one in drawing.dimensions:
        along = (one.end - one.start) / one.length_m
        across = np.array([-along[1], along[0]])
        side = float(np.sign(one.offset_m) or 1.0)
        ends = [one.start + one.offset_m * across, one.end + one.offset_m * across]
        lines.append(Line(one.layer, np.stack(ends)))
        tick = 0.04 * (along + across)
        for at, end in zip((one.start, one.end), ends, strict=True):
            lines.append(Line(one.layer, np.stack([end - tick, end + tick])))
            if abs(one.offset_m) > 0.05:
                lines.append(Line(one.layer, np.stack([at + side * 0.04 * across, end + side * 0.04 * across])))
        angle = float(np.arctan2(along[1], along[0]))
        # Texts are read from below or from the right; walls are never quite upright in the drawing.
        turned = angle > np.pi / 2 + 0.1 or angle < -np.pi / 2 + 0.1
        above = -across if turned else across
        middle = 0.5 * (ends[0] + ends[1]) + 0.8 * TEXT_M * above
        texts.append(Text(one.layer, middle, one.words, TEXT_M, angle + np.pi * turned))
    return lines, texts


AXIS_M, BAR_M, BELOW_M = 0.4, 1.0, 0.3
"""Length of an axis and of the scale bar, and the distance of the bar from what is above it [m]."""


def with_origin(drawing: Drawing, across: str, up: str) -> Drawing:
    """The drawing with its origin, the names of its two axes, and a scale bar of 1 m below it.

    Sections and measurements are chosen in these axes, so they are drawn.
    """
    low, _ = drawing.bounds()
    layer, lines, texts = "A-ANNO-SYMB", [], [Text("A-ANNO-SYMB", np.array([-0.1, -0.1]), "0")]
    for axis, name in ((np.array([1.0, 0.0]), across), (np.array([0.0, 1.0]), up)):
        tip, side = AXIS_M * axis, 0.03 * axis[::-1]
        lines.append(Line(layer, np.stack([np.zeros(2), tip])))
        lines.append(Line(layer, np.stack([tip - 0.06 * axis + side, tip, tip - 0.06 * axis - side])))
        # Beside the walls, which often lie on the axes.
        texts.append(Text(layer, tip - 0.1 * axis[::-1], name))
    left = np.array([max(low[0], 0.0), low[1] - BELOW_M])
    lines.append(Line(layer, np.stack([left, left + [BAR_M, 0.0]])))
    for along in (0.0, 0.5 * BAR_M, BAR_M):
        at = left + [along, 0.0]
        lines.append(Line(layer, np.stack([at, at + [0.0, 0.05]])))
        words = f"{along:g} m" if along == BAR_M else f"{along:g}"
        texts.append(Text(layer, at + [0.0, 0.05 + TEXT_M], words))
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


def with_sigma(found: Estimate) -> str:
    """A length in words: metres, and one standard deviation in millimetres."""
    return f"{found.value:.3f} m ±{digits(1e3 * found.sigma)} mm"


def digits(sigma: float) -> str:
    """A standard deviation with about two digits."""
    return f"{sigma:.0f}" if sigma >= 10 else f"{sigma:.1f}" if sigma >= 0.95 else f"{sigma:.2f}"
