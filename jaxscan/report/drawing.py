"""Figures in the colours of the report, as SVG, as PDF, and with a scale beside them."""

import io
import re
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxscan.drawing import Drawing, layer_of, strokes
from jaxscan.report.html import Html, element


if TYPE_CHECKING:
    from matplotlib.figure import Figure


# Colours of Okabe and Ito, which people with any colour vision can tell apart.
BLUE, ORANGE, GREEN, RED, SKY, PURPLE = "#0072b2", "#e69f00", "#009e73", "#d55e00", "#56b4e9", "#cc79a7"
SERIES = (BLUE, RED, GREEN, PURPLE, ORANGE, SKY)
INK, SOFT, LINE = "#1c2530", "#5b6672", "#dfe3e8"
RASTER_DPI = 180
"""Resolution of figure parts with thousands of marks, which are drawn as pixels."""

_STYLE: Any = {
    "font.size": 9.0,
    "font.family": "DejaVu Sans",
    "axes.titlesize": 9.5,
    "axes.labelcolor": SOFT,
    "axes.edgecolor": SOFT,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "xtick.color": SOFT,
    "ytick.color": SOFT,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "text.color": INK,
    "grid.color": LINE,
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.6,
}
_GROUP_ID = re.compile(r' id="(?!C[0-9])[a-zA-Z][a-zA-Z0-9_.]*_[0-9]+"')
_NUMBER = re.compile(r"-?[0-9]+\.[0-9]{3,}")
_NEGATIVE = re.compile(r"(?<=>)-(?=[0-9.])")
_PATHS = re.compile(r' (?:d|x|y)="[^"]*"')


def new_figure(width: float = 5.4, height: float = 3.3, *, fitted: bool = True) -> "Figure":
    """An empty figure of a size [inch] in the report's style. Global settings of matplotlib do not change."""
    # Imported here, so that only drawing loads matplotlib.
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(_STYLE):
        return Figure(figsize=(width, height), layout="constrained" if fitted else None)


def new_axes(figure: "Figure", place: int = 111, *, grid: bool = True, **options: Any) -> Any:
    """The axes at a place of a figure, the only ones if not said otherwise, in the report's style."""
    import matplotlib

    with matplotlib.rc_context(_STYLE):
        axes = figure.add_subplot(place, **options)
        axes.grid(grid)
        axes.tick_params(labelsize=8)
        return axes


def add_legend(axes: Any, *, inside: bool = False) -> None:
    """A legend above the axes, or inside in their upper left. Names are not read as formulas."""
    style: Any = {"frameon": False, "fontsize": 8.5, "handletextpad": 0.5, "borderaxespad": 0.2}
    if inside:
        shown = axes.legend(loc="upper left", **style)
    else:
        count = len(axes.get_legend_handles_labels()[1])
        shown = axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=min(count, 3), **style)
    for text in shown.get_texts():
        text.set_parse_math(False)


def as_svg(figure: "Figure", name: str, description: str) -> Html:
    """A figure as markup.

    Args:
        name: A name that no other figure of the page has.
        description: Text for screen readers.
    """
    import matplotlib

    # "none" keeps text as text; the fixed salt gives the same bytes for the same figure.
    style = _STYLE | {"svg.fonttype": "none", "svg.hashsalt": name}
    written = io.StringIO()
    with matplotlib.rc_context(style):
        figure.savefig(written, format="svg", dpi=RASTER_DPI, transparent=True, metadata={"Date": None})
    text = written.getvalue()
    text = text[text.index("<svg") :]
    view = re.search(r'viewBox="([^"]*)"', text)
    body = text[text.index(">") + 1 : text.rindex("</svg>")]
    body = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->", "", body, flags=re.DOTALL)
    # Ids of groups are not referred to, and they repeat in every figure.
    body = _GROUP_ID.sub("", body)
    body = _PATHS.sub(lambda match: _NUMBER.sub(_short, match[0]), body)
    body = _NEGATIVE.sub("−", body)
    body = re.sub(r"\s*\n\s*", "\n", body).replace('style="stroke-linejoin: miter"', "")
    box = view[1] if view else "0 0 1 1"
    # At most 1.6 pixels per point: slightly larger than the size of the drawing.
    width = f"max-width:{1.6 * float(box.split()[2]):.0f}px"
    return element("svg", Html(body.strip()), viewBox=box, style=width, role="img", aria_label=description)


def plain(text: str, longest: int = 28) -> str:
    """A name for figures: letters that are not in every font become "?", and long names are cut."""
    shown = "".join(letter if " " <= letter <= "~" or "\xa1" <= letter <= "\xff" else "?" for letter in text)
    return shown if len(shown) <= longest else shown[: longest - 1] + "…"


def arrows(start: np.ndarray, vector: np.ndarray) -> Any:
    """Arrows from `start` along `vector` [n, 2] as one path, which is much smaller than the polygons of a quiver."""
    from matplotlib.path import Path

    tip = start + vector
    side = np.stack([-vector[:, 1], vector[:, 0]], -1)
    barbs = [tip - 0.32 * vector + turn * 0.2 * side for turn in (1.0, -1.0)]
    points = np.stack([start, tip, barbs[0], tip, barbs[1]], 1).reshape(-1, 2)
    codes = np.tile([Path.MOVETO, Path.LINETO, Path.MOVETO, Path.LINETO, Path.LINETO], len(start))
    return Path(points, codes) if len(points) else Path(np.zeros((0, 2)))


def _short(match: re.Match[str]) -> str:
    # 0.01 points are much less than a pixel of a screen.
    return f"{float(match[0]):.2f}".rstrip("0").rstrip(".")


INCH_PER_M = 20.0 / 25.4
"""1 : 50."""
MARGIN_M = 0.25


def pdf_of(drawing: Drawing) -> bytes:
    """A drawing as one page of PDF, 1 : 50."""
    # Imported here, so that only drawing loads matplotlib.
    import matplotlib
    from matplotlib.figure import Figure

    low, high = drawing.bounds()
    low, high = low - MARGIN_M, high + MARGIN_M
    figure = Figure(figsize=tuple(INCH_PER_M * (high - low)))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    lines, texts = strokes(drawing)
    for line in lines:
        look = layer_of(line.layer)
        style = (0, (8, 5)) if look.dashed else "-"
        axes.plot(*line.points.T, color=look.rgb, linewidth=look.width_mm * 72 / 25.4, linestyle=style)
    for text in texts:
        axes.text(
            float(text.at[0]),
            float(text.at[1]),
            text.words,
            color=layer_of(text.layer).rgb,
            fontsize=1.2 * text.height_m * INCH_PER_M * 72,
            rotation=float(text.angle * 180 / 3.141592653589793),
            rotation_mode="anchor",
            horizontalalignment="center",
            verticalalignment="center",
            parse_math=False,
        )
    written = io.BytesIO()
    with matplotlib.rc_context({"pdf.fonttype": 42}):
        figure.savefig(written, format="pdf", metadata={"Title": drawing.title, "CreationDate": None})
    return written.getvalue()


def with_scale(rgb: np.ndarray, pixel_m: float, words: str) -> np.ndarray:
    """A picture with a strip below it: a scale in metres and words.

    Args:
        rgb: [rows, columns, 3], uint8.
        pixel_m: Size of a pixel [m].
        words: What is said beside the scale.

    Returns:
        [rows + strip, columns, 3], uint8; the picture itself is not changed.
    """
    # Imported here, so that only drawing loads matplotlib.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = rgb.shape[1]
    high = max(40, columns // 14)
    dpi = 100
    figure = Figure(figsize=(columns / dpi, high / dpi), dpi=dpi)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.set_xlim(0.0, columns)
    axes.set_ylim(0.0, high)
    # Half of the width at most, in a round number of parts.
    part = max(size for size in (0.001, 0.01, 0.1, 0.5, 1.0) if 4 * size < 0.5 * columns * pixel_m or size == 0.001)
    left = 0.02 * columns
    for number in range(4):
        start = left + number * part / pixel_m
        filled = INK if number % 2 == 0 else "white"
        axes.fill_between([start, start + part / pixel_m], 0.55 * high, 0.75 * high, facecolor=filled, edgecolor=INK)
    size = 0.24 * high * 72 / dpi
    for number in (0, 2, 4):
        axes.text(left + number * part / pixel_m, 0.2 * high, f"{number * part:g}", fontsize=size, ha="center")
    axes.text(left + 4.35 * part / pixel_m, 0.5 * high, f"m.  {words}", fontsize=size, va="center", parse_math=False)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    strip = np.asarray(canvas.buffer_rgba())[:, :columns, :3]
    strip = np.pad(strip, ((0, 0), (0, columns - strip.shape[1]), (0, 0)), constant_values=255)
    return np.concatenate([rgb, strip])
