"""Figures of the uncertainty: depth, correlations, weak combinations of parameters."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxscan.calibration import Direction, is_held_by_priors
from jaxscan.report.drawing import BLUE, INK, LINE, RED, SERIES, SOFT, add_legend, new_axes, new_figure, plain


if TYPE_CHECKING:
    from matplotlib.figure import Figure


_SHOWN_CORRELATION = 0.5


def depth_against_distance(lasers: Sequence[tuple[str, np.ndarray, np.ndarray]], noise_mm: np.ndarray) -> "Figure":
    """Standard deviation of the depth against the depth itself, both on logarithmic scales.

    Args:
        lasers: For each laser its name, depths [n], m, and standard deviations from the calibration there [n], mm.
        noise_mm: Standard deviation of one point from the noise of its own stripe, at the depths of the first laser
            [n], mm; 0 where it is unknown.
    """
    figure = new_figure()
    axes = new_axes(figure, xlabel="depth, m", ylabel="standard deviation of the depth, mm")
    for index, (name, depth, sigma) in enumerate(lasers):
        label = "calibration" if len(lasers) == 1 else f"calibration, {plain(name)}"
        axes.plot(depth, sigma, "o-", color=SERIES[2 * index % len(SERIES)], markersize=4.5, label=label)
    if noise_mm.any():
        axes.plot(lasers[0][1], noise_mm, "s--", color=RED, markersize=4, label="one point's own stripe noise")
    axes.set_xscale("log")
    axes.set_yscale("log")
    _plain_ticks(axes.xaxis, np.concatenate([depth for _, depth, _ in lasers]))
    _plain_ticks(axes.yaxis, np.array(axes.get_ylim()))
    axes.grid(True, which="both")
    add_legend(axes, inside=True)
    return figure


def correlations(names: Sequence[str], covariance: np.ndarray) -> "Figure":
    """Correlations of the estimated parameters. Held parameters are left out."""
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    free = np.flatnonzero(sigma > 0)
    correlation = covariance[np.ix_(free, free)] / np.outer(sigma[free], sigma[free])
    side = min(3.0 + 0.24 * len(free), 11.0)
    figure = new_figure(side, side - 0.4)
    axes = new_axes(figure, grid=False)
    drawn = axes.imshow(correlation, cmap="RdBu_r", vmin=-1, vmax=1, interpolation="nearest")
    labels = [plain(names[index], 18) for index in free.tolist()]
    axes.set_xticks(range(len(free)), labels, rotation=90, parse_math=False)
    axes.set_yticks(range(len(free)), labels, parse_math=False)
    axes.tick_params(length=0, labelsize=8)
    for spine in axes.spines.values():
        spine.set_visible(False)
    for i, j in zip(*np.nonzero(np.abs(np.tril(correlation, -1)) > _SHOWN_CORRELATION), strict=True):
        value = correlation[i, j]
        text = f"{value:+.2f}".replace("0.", ".")
        axes.text(j, i, text, ha="center", va="center", fontsize=5.5, color="white" if abs(value) > 0.7 else INK)
    bar = figure.colorbar(drawn, ax=axes, shrink=0.6, aspect=28, pad=0.02, ticks=[-1, -0.5, 0, 0.5, 1])
    bar.outline.set_visible(False)
    bar.ax.tick_params(length=0, labelsize=8)
    return figure


def spectrum(directions: Sequence[Direction]) -> "Figure":
    """Standard deviation over the prior's standard deviation, for each independent combination of parameters.

    Args:
        directions: The combinations, worst first.
    """
    figure = new_figure(5.4, min(0.9 + 0.27 * len(directions), 8.0))
    axes = new_axes(figure, xlabel="standard deviation over the prior's")
    value = np.array([max(row.sigma_over_prior, 1e-12) for row in directions])
    place = np.arange(len(directions))
    left = 10.0 ** (np.floor(np.log10(value.min())) - 0.15)
    colours = [RED if is_held_by_priors(row.sigma_over_prior) else BLUE for row in directions]
    axes.hlines(place, left, value, color=colours, linewidth=1.2)
    axes.scatter(value, place, color=colours, s=20, zorder=3)
    axes.set_xscale("log")
    axes.set_xlim(left, max(1.6, 1.4 * value.max()))
    axes.axvline(1.0, color=SOFT, linewidth=0.9)
    axes.set_yticks(place, [combination(row.direction) for row in directions], parse_math=False)
    axes.tick_params(axis="y", length=0, labelsize=8)
    axes.set_ylim(len(directions) - 0.4, -0.6)
    axes.grid(False)
    axes.grid(True, axis="x", color=LINE)
    return figure


def combination(direction: dict[str, float], most: int = 3) -> str:
    """A combination of parameters as text: its largest components, by name."""
    largest = sorted(direction.items(), key=lambda item: -abs(item[1]))[:most]
    kept = [(name, part) for name, part in largest if abs(part) > 0.3 * abs(largest[0][1])]
    # The sign of a combination has no meaning; the first component is made positive.
    sense = 1.0 if not kept or kept[0][1] >= 0 else -1.0
    words = [f"{'+' if sense * part > 0 else '−'} {plain(name, 18)}" for name, part in kept]
    return " ".join(words).removeprefix("+ ") or "—"


def _plain_ticks(axis: Any, values: np.ndarray) -> None:
    """Ticks at 1, 2 and 5 times powers of ten, as plain numbers."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter, NullLocator

    positive = values[values > 0]
    if not positive.size:
        return
    low, high = np.floor(np.log10(positive.min())) - 1, np.ceil(np.log10(positive.max())) + 1
    ticks = [step * 10.0**power for power in np.arange(low, high + 1) for step in (1, 2, 5)]
    axis.set_major_locator(FixedLocator(ticks))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())
    axis.set_minor_formatter(NullFormatter())
