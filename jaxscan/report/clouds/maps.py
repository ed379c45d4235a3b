"""Maps of a cloud over all directions, and its sigmas against distance, as figures."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxscan.report.clouds.directions import Directions
from jaxscan.report.clouds.facts import SigmaAt
from jaxscan.report.drawing import BLUE, RED, SOFT, add_legend, new_axes, new_figure


if TYPE_CHECKING:
    from matplotlib.figure import Figure


NOTHING = "#c9ced4"
"""Of directions without points."""
_MARGIN_DEG = 8.0
"""Shown beyond the highest and the lowest point."""
_ROUND_MM = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)


def distance_map(seen: Directions) -> "Figure":
    """Distance in each direction; directions without points are grey."""
    return _panorama(seen, seen.distance_m, "distance, m", "viridis_r", _limits(seen.distance_m))


def sigma_map(seen: Directions) -> "Figure":
    """One standard deviation of a point in each direction, on a logarithmic scale of colours."""
    from matplotlib.colors import LogNorm

    values = 1e3 * seen.sigma_m
    low, high = _limits(values)
    norm = LogNorm(max(low, 1e-4), max(high, 1.2 * low, 2e-4))
    return _panorama(seen, values, "one standard deviation, mm", "magma_r", norm)


def sigma_against_distance(rows: Sequence[SigmaAt]) -> "Figure":
    """Median and 95 % quantile of the sigmas of points, by distance."""
    figure = new_figure(5.4, 3.0)
    axes = new_axes(figure, xlabel="distance, m", ylabel="one standard deviation, mm")
    middle = [0.5 * (row.nearest_m + min(row.farthest_m, 1.5 * row.nearest_m + 1)) for row in rows]
    axes.plot(middle, [1e3 * row.median_m for row in rows], "o-", color=BLUE, markersize=4.5, label="median")
    axes.plot(middle, [1e3 * row.p95_m for row in rows], "s--", color=RED, markersize=4, label="95 % of the points")
    axes.set_ylim(bottom=0.0)
    axes.set_xlim(left=0.0)
    add_legend(axes, inside=True)
    return figure


def _limits(values: np.ndarray) -> tuple[float, float]:
    known = values[np.isfinite(values)]
    low, high = np.percentile(known, [1, 99]) if known.size else (0.0, 1.0)
    return float(low), float(max(high, low + 1e-9))


def _panorama(seen: Directions, values: np.ndarray, label: str, colours: str, norm: Any) -> "Figure":
    from matplotlib import colormaps
    from matplotlib.ticker import FixedLocator, FormatStrFormatter, NullLocator

    band = seen.elevation_deg[seen.band]
    bottom, top = max(float(band[-1]) - _MARGIN_DEG, -90.0), min(float(band[0]) + _MARGIN_DEG, 90.0)
    figure = new_figure(9.6, 1.15 + 0.0245 * (top - bottom))
    axes = new_axes(figure, grid=False, xlabel="azimuth, degrees", ylabel="elevation, degrees")
    scaled = {"vmin": norm[0], "vmax": norm[1]} if isinstance(norm, tuple) else {"norm": norm}
    shown = axes.imshow(
        np.ma.masked_invalid(values),
        extent=(180, -180, -90, 90),
        cmap=colormaps[colours].with_extremes(bad=NOTHING),
        interpolation="nearest",
        aspect="equal",
        **scaled,
    )
    axes.set_xticks(range(180, -181, -45), [_degrees(value) for value in range(180, -181, -45)])
    axes.set_yticks(range(-90, 91, 30), [_degrees(value) for value in range(-90, 91, 30)])
    # Where the scanner does not look there is nothing to see.
    axes.set_ylim(bottom, top)
    bar = figure.colorbar(shown, ax=axes, orientation="horizontal", shrink=0.44, aspect=30, pad=0.02, anchor=(0.0, 1.0))
    bar.set_label(label, color=SOFT, fontsize=9)
    bar.outline.set_visible(False)
    bar.ax.tick_params(length=0, labelsize=8)
    if not isinstance(norm, tuple):
        ticks = [value for value in _ROUND_MM if norm.vmin <= value <= norm.vmax]
        if ticks:
            bar.ax.xaxis.set_major_locator(FixedLocator(ticks))
            bar.ax.xaxis.set_major_formatter(FormatStrFormatter("%g"))
        bar.ax.xaxis.set_minor_locator(NullLocator())
    return figure


def _degrees(value: int) -> str:
    return f"{value}".replace("-", "−")
