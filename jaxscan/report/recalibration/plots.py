"""Figures of a recalibration: flatness of walls as a panorama, motions of the parts, gains, closure."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from jaxscan.recalibration import Gain, Moved, PanoramaOfWalls
from jaxscan.report.drawing import (
    BLUE,
    GREEN,
    LINE,
    ORANGE,
    RED,
    SOFT,
    add_bar,
    new_axes,
    new_figure,
    new_plot,
    no_frame,
    plain,
    round_up,
)


if TYPE_CHECKING:
    from matplotlib.figure import Figure


COLUMNS, ROWS = 1080, 320
"""Largest size of a panorama [px]: more than a page shows."""
UNSEEN = "#d3d8dd"


def panorama_rows(panorama: PanoramaOfWalls) -> tuple[np.ndarray, np.ndarray]:
    """Residuals of one sweep over azimuth and line, before and after: the mean of the cells of a pixel.

    Two pictures [rows, columns], mm; NaN where there is no point. The first column is azimuth 0.
    """
    profiles, lines = panorama.seen.shape
    angle = 2 * np.pi * np.arange(profiles) / max(profiles, 1) if panorama.angle is None else panorama.angle
    turn = np.mod(np.asarray(angle, np.float64), 2 * np.pi) / (2 * np.pi)
    # No more columns than places: gaps between profiles are no gaps in the walls.
    columns = max(1, min(COLUMNS, len(np.unique(np.round(turn, 6)))))
    rows = max(1, min(ROWS, lines))
    column = np.minimum((turn * columns + 1e-6).astype(int), columns - 1)
    row = np.arange(lines) * rows // lines
    place = column[:, None] + columns * row[None, :]
    seen = np.asarray(panorama.seen)
    count = np.bincount(place[seen], minlength=rows * columns)
    pictures = []
    for field in (panorama.before, panorama.after):
        total = np.bincount(place[seen], np.asarray(field)[seen], minlength=rows * columns)
        picture = np.where(count > 0, 1e3 * total / np.maximum(count, 1), np.nan)
        pictures.append(picture.reshape(rows, columns))
    return pictures[0], pictures[1]


def colour_limit(pictures: Sequence[np.ndarray]) -> float:
    """Limit of the colour scale [mm]: 98 % of all pixels are within it; 1, 2 or 5 times a power of ten."""
    sizes = np.concatenate([np.abs(picture[np.isfinite(picture)]) for picture in pictures])
    largest = float(np.percentile(sizes, 98)) if sizes.size else 0.0
    return round_up(largest) if largest > 0 else 1.0


def panorama_figure(before: np.ndarray, after: np.ndarray) -> "Figure":
    """Both pictures, one above the other, in one scale of colours."""
    from matplotlib import colormaps

    limit = colour_limit([before, after])
    figure = new_figure(10.4, 5.4)
    colours = colormaps["RdBu_r"].with_extremes(bad=UNSEEN)
    drawn: Any = None
    both = []
    for place, (title, picture) in enumerate((("before", before), ("after", after))):
        axes = new_axes(figure, 211 + place, grid=False)
        no_frame(axes)
        axes.tick_params(length=2)
        drawn = axes.imshow(
            np.ma.masked_invalid(picture),
            cmap=colours,
            vmin=-limit,
            vmax=limit,
            extent=(0.0, 360.0, len(picture), 0.0),
            aspect="auto",
            interpolation="nearest",
            rasterized=True,
        )
        axes.set_title(title, loc="left")
        axes.set_xticks(range(0, 361, 45))
        axes.set_yticks([])
        axes.set_ylabel("line")
        both.append(axes)
    both[1].set_xlabel("azimuth, degrees")
    bar = add_bar(figure, drawn, both, shrink=0.8, aspect=30, pad=0.015, extend="both")
    bar.set_label("distance from the wall's plane, mm", color=SOFT)
    return figure


def moved_figure(moved: Sequence[Moved], most: int = 24) -> "Figure":
    """Bars of the change of each parameter, in standard deviations that it would have by chance."""
    shown = list(moved[:most])
    figure, axes = new_plot(5.4, 0.9 + 0.21 * len(shown), xlabel="change, in standard deviations by chance")
    value = np.array([one.sigmas for one in shown])
    place = np.arange(len(shown))
    axes.axvspan(-2, 2, color=LINE, alpha=0.55, linewidth=0)
    axes.barh(place, value, height=0.62, color=[RED if abs(v) > 3 else BLUE for v in value])
    axes.axvline(0.0, color=SOFT, linewidth=0.8)
    axes.set_yticks(place, [plain(one.name, 22) for one in shown], parse_math=False)
    axes.set_ylim(len(shown) - 0.4, -0.6)
    axes.set_xlim(*_around(value, 3.2))
    axes.tick_params(axis="y", length=0)
    axes.grid(False, axis="y")
    return figure


def gain_figure(gains: Sequence[Gain], most: int = 16) -> "Figure":
    """Old over new standard deviation of each direction, on a logarithmic scale."""
    shown = list(gains[:most])
    figure, axes = new_plot(5.4, 0.9 + 0.24 * len(shown), xlabel="how many times better known than before")
    value = np.array([min(max(gain.factor, 1.0), 1e4) for gain in shown])
    place = np.arange(len(shown))
    colours = [ORANGE if v < 1.05 else GREEN for v in value]
    axes.hlines(place, 1.0, value, color=colours, linewidth=1.6)
    axes.scatter(value, place, color=colours, s=24, zorder=3)
    axes.set_xscale("log")
    axes.set_xlim(0.93, max(12.0, 1.5 * value.max(initial=1.0)))
    axes.xaxis.set_major_formatter(lambda v, _: f"{v:g}")
    axes.set_yticks(place, [plain(gain.name, 34) for gain in shown], parse_math=False)
    axes.set_ylim(len(shown) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.grid(False, axis="y")
    return figure


def _around(values: Float[np.ndarray, " n"], least: float) -> tuple[float, float]:
    """Limits of an axis that show all values and at least this much on either side of 0."""
    low, high = float(values.min(initial=0.0)), float(values.max(initial=0.0))
    return min(1.08 * low, -least), max(1.08 * high, least)
