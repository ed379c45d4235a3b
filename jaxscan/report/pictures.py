"""Pictures of deviations between clouds, and of rigs that are yet to be built."""

from typing import Any

import numpy as np

from jaxscan.design import RigChoice, RigDesign, spread_at
from jaxscan.measurement import DeviationMap
from jaxscan.report.drawing import GREEN, INK, LINE, ORANGE, ROUND, SERIES, SOFT, new_axes, new_figure, png


ROBUST = 5.0
"""The colour scale ends at this many robust standard deviations: what lies farther is not the surface's own scatter."""


def deviation_reach(found: DeviationMap) -> float:
    """Where the colours of a map of deviations end [m].

    The scale is that of the median absolute deviation, which a recess does not change before it fills half the map. It
    ends with the largest deviation where nothing lies beyond.

    Source: Rousseeuw and Croux, Alternatives to the median absolute deviation, 1993.
    """
    size = np.abs(found.deviation_m[found.seen])
    scatter = 1.4826 * float(np.median(size))
    return max(min(ROBUST * scatter, float(size.max())), 1e-5)


def deviation_picture(found: DeviationMap) -> bytes:
    """A PNG of two maps in millimetres: deviations, towards the scanner positive, and one standard deviation.

    Cells beyond the scale of the deviations have colours of their own, and the legend counts them.
    """
    import matplotlib
    from matplotlib.patches import Patch

    figure = new_figure(9.6, 4.8)
    half = 0.5 * found.cell_m * np.array(found.seen.shape)
    reach = deviation_reach(found)
    largest = max(float(np.percentile(found.sigma_m[found.seen], 99)), 1e-5)
    diverging = matplotlib.colormaps["RdBu_r"].with_extremes(under=GREEN, over=ORANGE)
    panels = (
        ("deviation from the plane, mm", found.deviation_m, diverging, (-1e3 * reach, 1e3 * reach)),
        ("one standard deviation, mm", found.sigma_m, "viridis", (0.0, 1e3 * largest)),
    )
    for place, (title, values, colours, (low, high)) in enumerate(panels):
        axes = new_axes(figure, 121 + place, grid=False)
        shown = np.ma.masked_where(~found.seen, 1e3 * values)
        extent = (-half[1], half[1], -half[0], half[0])
        image = axes.imshow(shown, origin="lower", extent=extent, cmap=colours, vmin=low, vmax=high)
        axes.set_facecolor(LINE)
        axes.set_title(title)
        axes.set_xlabel("to the right, m")
        if place == 0:
            axes.set_ylabel("up, m")
        figure.colorbar(image, ax=axes, shrink=0.85, extend="neither" if place == 0 else "max")
    said = _beyond_words(found, reach)
    marks = [Patch(facecolor=colour, label=words) for colour, words in said]
    marks += [Patch(facecolor=LINE, label="no points")] * bool((~found.seen).any())
    if marks:
        figure.legend(handles=marks, loc="outside lower left", ncols=len(marks), frameon=False, fontsize=8.5)
    return png(figure)


def _beyond_words(found: DeviationMap, reach: float) -> list[tuple[str, str]]:
    """Colours of the cells beyond the scale, and what the legend says of them."""
    values = found.deviation_m[found.seen]
    said = []
    for colour, far, where in ((GREEN, values[values < -reach], "deeper"), (ORANGE, values[values > reach], "raised")):
        if len(far):
            low, high = f"{1e3 * far.min():.1f}", f"{1e3 * far.max():.1f}"
            size = f"{low} mm" if low == high else f"{low} to {high} mm"
            share = 100 * len(far) / len(values)
            said.append((colour, f"{where}, {size}: {len(far)} of {len(values)} cells, {share:.1f} %"))
    return said


_SHOWN = 4
_SAMPLES = 60


def design_picture(choice: RigChoice) -> bytes:
    """A PNG: standard deviation of a point's depth by its distance, and the alternatives as a map."""
    figure = new_figure(10.4, 4.6)
    _curves(new_axes(figure, 121, xlabel="depth, m", ylabel="standard deviation of a point's depth, mm"), choice)
    _map(new_axes(figure, 122, grid=False, xlabel="baseline, m", ylabel="lens, mm"), choice)
    return png(figure)


def _curves(axes: Any, choice: RigChoice) -> None:
    wish, chosen = choice.wish, choice.design
    same_lens = sorted(
        (one for one, _ in choice.alternatives if one.lens_mm == chosen.lens_mm and one != chosen),
        key=lambda one: abs(np.log(one.baseline_m / chosen.baseline_m)),
    )[:_SHOWN]
    for number, design in enumerate(sorted((*same_lens, chosen), key=lambda one: one.baseline_m)):
        depths = _depths(design, wish.range_m)
        sigma = 1e3 * spread_at(design, depths.tolist(), wish.noise_px).depth
        width, name = (2.8, " (chosen)") if design == chosen else (1.2, "")
        colour = INK if design == chosen else SERIES[number % len(SERIES)]
        axes.plot(depths, sigma, color=colour, linewidth=width, label=f"baseline {design.baseline_m:g} m{name}")
    axes.axhline(1e3 * wish.sigma_m, color=GREEN, linestyle="--", linewidth=1.2)
    axes.axvline(wish.range_m, color=GREEN, linestyle="--", linewidth=1.2)
    axes.plot([wish.range_m], [1e3 * wish.sigma_m], "o", color=GREEN, label="wished")
    axes.plot([wish.range_m], [1e3 * choice.sigma_m], "s", color=INK, markersize=5)
    axes.set_xscale("log")
    axes.set_yscale("log")
    for axis, values in ((axes.xaxis, _within(axes.get_xlim())), (axes.yaxis, _within(axes.get_ylim()))):
        axis.set_ticks(values, [f"{value:g}" for value in values])
        axis.set_ticks([], minor=True)
    across, along = chosen.fields_deg
    axes.set_title(
        f"{chosen.lens_mm:g} mm lens, {across:.0f}° x {along:.0f}°, {chosen.sensor.width} x "
        f"{chosen.sensor.height} px; curves begin where the stripe enters the image",
        fontsize=8,
        color=SOFT,
    )
    axes.legend(loc="upper left", frameon=False, fontsize=8.5)


def _map(axes: Any, choice: RigChoice) -> None:
    """Every lens with every baseline: its sigma, and whether it reaches the wish."""
    baselines = sorted({one.baseline_m for one, _ in choice.alternatives})
    lenses = sorted({one.lens_mm for one, _ in choice.alternatives})
    ratio = np.full((len(lenses), len(baselines)), np.nan)
    for design, sigma in choice.alternatives:
        row, column = lenses.index(design.lens_mm), baselines.index(design.baseline_m)
        ratio[row, column] = np.log2(sigma / choice.wish.sigma_m)
        text = f"{1e3 * sigma:.3g}" if sigma < 0.1 else f"{1e3 * sigma:.0f}"
        reaches = choice.reaches(design, sigma)
        weight = "bold" if reaches else "normal"
        axes.text(
            column, row, text, ha="center", va="center", fontsize=7.5, weight=weight, color=INK if reaches else SOFT
        )
        if design == choice.design:
            axes.plot([column], [row], "s", color=INK, markersize=21, fillstyle="none", markeredgewidth=1.6)
    axes.imshow(np.ma.masked_invalid(ratio), cmap="RdYlGn_r", vmin=-3, vmax=3, aspect="auto", alpha=0.45)
    axes.set_xticks(range(len(baselines)), [f"{value:g}" for value in baselines])
    fields = {one.lens_mm: one.fields_deg[1] for one, _ in choice.alternatives}
    axes.set_yticks(range(len(lenses)), [f"{lens:g} ({fields[lens]:.0f}°)" for lens in lenses])
    axes.set_title(
        f"sigma at {choice.wish.range_m:g} m, mm; bold reaches {1e3 * choice.wish.sigma_m:g} mm and "
        f"{choice.wish.field_deg:g}° along the stripe",
        fontsize=8,
        color=SOFT,
    )


def _depths(design: RigDesign, range_m: float) -> np.ndarray:
    near, far = design.view_m
    return np.geomspace(max(near, 0.1 * range_m), min(far, 2.0 * range_m), _SAMPLES)


def _within(limits: tuple[float, float]) -> list[float]:
    return [value for value in ROUND if limits[0] <= value <= limits[1]]
