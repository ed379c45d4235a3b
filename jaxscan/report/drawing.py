"""Figures as small SVG elements, with text as text and without external references."""

import io
import re
from typing import TYPE_CHECKING, Any

import numpy as np

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
        figure: The figure.
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
