"""Figures in the colours of the report, as SVG, as PDF and PNG, and with a scale beside them."""

import io
import re
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxscan.drawing import Drawing, lay_out, layer_of
from jaxscan.drawing.model import EM
from jaxscan.report.html import Html, captioned, element


if TYPE_CHECKING:
    from matplotlib.figure import Figure


# Colours of Okabe and Ito, which people with any colour vision can tell apart.
BLUE, ORANGE, GREEN, RED, SKY, PURPLE = "#0072b2", "#e69f00", "#009e73", "#d55e00", "#56b4e9", "#cc79a7"
SERIES = (BLUE, RED, GREEN, PURPLE, ORANGE, SKY)
INK, SOFT, LINE = "#1c2530", "#5b6672", "#dfe3e8"
ROUND = tuple(step * 10.0**power for power in range(-7, 8) for step in (1, 2, 5))
"""Round steps of a scale, in order."""
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


def new_plot(width: float = 5.4, height: float = 3.3, **options: Any) -> tuple["Figure", Any]:
    """A figure and its only axes; options as of `new_axes`."""
    figure = new_figure(width, height)
    return figure, new_axes(figure, **options)


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
    """A figure as markup, by a name that no other figure of the page has, with a description for screen readers."""
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


def drawn(figure: "Figure", name: str, description: str, *caption: object, **attributes: str) -> Html:
    """A figure as markup with its caption; arguments as of `as_svg` and `html.captioned`."""
    return captioned(as_svg(figure, name, description), *caption, **attributes)


def round_up(value: float) -> float:
    """The next larger round number; one that is smaller by less than a thousandth counts too."""
    return next((one for one in ROUND if one >= 0.999 * value), ROUND[-1])


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


def png(figure: "Figure") -> bytes:
    """A figure as a PNG."""
    written = io.BytesIO()
    figure.savefig(written, format="png", dpi=120)
    return written.getvalue()


def add_bar(figure: "Figure", shown: Any, axes: Any, **options: Any) -> Any:
    """A scale of colours beside axes, without a frame."""
    bar = figure.colorbar(shown, ax=axes, **options)
    bar.outline.set_visible(False)
    bar.ax.tick_params(length=0, labelsize=8)
    return bar


def no_frame(axes: Any) -> None:
    """Leave out the lines about axes."""
    for spine in axes.spines.values():
        spine.set_visible(False)


def _short(match: re.Match[str]) -> str:
    # 0.01 points are much less than a pixel of a screen.
    return f"{float(match[0]):.2f}".rstrip("0").rstrip(".")


MM = 1.0 / 25.4
"""A millimetre of paper [inch]."""


def pdf_of(drawing: Drawing) -> bytes:
    """The sheet of a drawing as one page of PDF, true to scale."""
    # Imported here, so that only drawing loads matplotlib.
    import matplotlib

    written = io.BytesIO()
    with matplotlib.rc_context({"pdf.fonttype": 42}):
        _sheet_figure(drawing).savefig(written, format="pdf", metadata={"Title": drawing.title, "CreationDate": None})
    return written.getvalue()


def png_of(drawing: Drawing, dpi: float = 200.0) -> bytes:
    """The sheet of a drawing as a picture of so many dots per inch, which it names."""
    written = io.BytesIO()
    _sheet_figure(drawing).savefig(written, format="png", dpi=dpi, metadata={"Title": drawing.title})
    return written.getvalue()


def _sheet_figure(drawing: Drawing) -> "Figure":
    import matplotlib
    from matplotlib.figure import Figure

    page = lay_out(drawing)
    width, height = page.size_mm
    with matplotlib.rc_context({"font.family": "DejaVu Sans"}):
        figure = Figure(figsize=(width * MM, height * MM))
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.set_xlim(0.0, width)
    axes.set_ylim(0.0, height)
    for depth, name in enumerate(page.layers):
        look = layer_of(name)
        dashes = (0, (1.6 / look.width_mm, 1.0 / look.width_mm)) if look.dashed else "-"
        for area in (one for one in page.areas if one.layer == name):
            axes.fill(*area.points.T, facecolor=look.rgb, edgecolor="none", zorder=depth)
        for line in (one for one in page.lines if one.layer == name):
            style: Any = {"linewidth": look.width_mm * MM * 72, "linestyle": dashes, "solid_capstyle": "round"}
            axes.plot(*line.points.T, color=look.rgb, zorder=depth, clip_on=False, **style)
        for text in (one for one in page.texts if one.layer == name):
            axes.text(
                float(text.at[0]),
                float(text.at[1]),
                text.words,
                color=look.rgb,
                fontsize=EM * text.height * MM * 72,
                rotation=float(np.degrees(text.angle)),
                rotation_mode="anchor",
                horizontalalignment="left" if text.align == "left" else "center",
                verticalalignment="center_baseline",
                parse_math=False,
                zorder=depth,
            )
    return figure


def with_scale(rgb: np.ndarray, pixel_m: float, words: str) -> np.ndarray:
    """A picture, uint8 [rows, columns, 3], with a strip below it: a scale by the size of a pixel [m], and words."""
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
