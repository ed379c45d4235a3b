"""The report of a cloud: one HTML page, with maps over all directions."""

import base64
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxscan.measurement import RoomBox
from jaxscan.report.clouds.facts import Beside, Directions, Facts, SigmaAt
from jaxscan.report.clouds.picture import dimension_text, room_picture
from jaxscan.report.drawing import BLUE, RED, ROUND, SOFT, add_bar, add_legend, drawn, new_plot
from jaxscan.report.html import Html, beside, bullets, element, page, section, table, tiles
from jaxscan.report.words import millimetres, sentence
from jaxscan.vision import encode_jpeg


if TYPE_CHECKING:
    from matplotlib.figure import Figure


NOTHING = "#c9ced4"
_MARGIN_DEG = 8.0


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
    figure, axes = new_plot(5.4, 3.0, xlabel="distance, m", ylabel="one standard deviation, mm")
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
    figure, axes = new_plot(
        9.6, 1.15 + 0.0245 * (top - bottom), grid=False, xlabel="azimuth, degrees", ylabel="elevation, degrees"
    )
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
    place: Any = {"orientation": "horizontal", "anchor": (0.0, 1.0), "shrink": 0.44, "aspect": 30, "pad": 0.02}
    bar = add_bar(figure, shown, axes, **place)
    bar.set_label(label, color=SOFT, fontsize=9)
    if not isinstance(norm, tuple):
        ticks = [value for value in ROUND if norm.vmin <= value <= norm.vmax]
        if ticks:
            bar.ax.xaxis.set_major_locator(FixedLocator(ticks))
            bar.ax.xaxis.set_major_formatter(FormatStrFormatter("%g"))
        bar.ax.xaxis.set_minor_locator(NullLocator())
    return figure


def _degrees(value: int) -> str:
    return f"{value}".replace("-", "−")


NAMED_HOLES = 8
_JPEG = 82
_NARROW_PX = 800


def cloud_page(facts: Facts, box: RoomBox | None, around: Beside) -> str:
    """The report of a reconstruction: an HTML document that fetches nothing and runs no scripts.

    Args:
        facts: Statistics of the cloud.
        box: The room's dimensions, where some were found.
        around: What is known beside the cloud's points, as plain text.
    """
    stations = f" from {facts.stations} stations" if facts.stations > 1 else ""
    return page(
        "Reconstruction report",
        f"Reconstruction report: {around.name}",
        f"{facts.points:,} points{stations}",
        around.notes,
        _tiles(facts, box),
        _picture(facts, box),
        _dimensions(box, around),
        _coverage(facts),
        _sigma(facts),
        _left_out(facts, around),
        _steps(facts, around),
        _calibration(around),
    )


def _tiles(facts: Facts, box: RoomBox | None) -> Html:
    sides = {} if box is None else box.sides
    values = [(f"{side.value_m:.4f} m", f"{name}, ± {1e3 * side.sigma_m:.2f} mm") for name, side in sides.items()]
    seen = facts.directions[0]
    values.append(
        (f"{100 * seen.share(of_band=True):.1f} %", "of the directions that the scanner looks at have points")
    )
    if facts.median_sigma_m is not None:
        values.append((f"± {millimetres(1e3 * facts.median_sigma_m)}", "median standard deviation of a point"))
    return tiles(values)


def _picture(facts: Facts, box: RoomBox | None) -> Html:
    wide = room_picture(facts.shown, box)
    labels = "; ".join(label.words for label in wide.labels)
    described = f"The room, cut open and seen from above one of its corners. {labels}"
    # On a telephone the words of the large picture would be a few pixels high.
    narrow = room_picture(facts.shown, box, width=_NARROW_PX)
    return element(
        "figure",
        element(
            "picture",
            element("source", media="(max-width:640px)", srcset=_data(narrow.rgb)),
            element("img", src=_data(wide.rgb), alt=described),
        ),
        class_="photograph",
    )


def _data(rgb: np.ndarray) -> str:
    return f"data:image/jpeg;base64,{base64.b64encode(encode_jpeg(rgb, quality=_JPEG)).decode()}"


def _dimensions(box: RoomBox | None, around: Beside) -> Html:
    if box is None:
        return section("Dimensions", element("p", f"None: {around.no_dimensions or 'they were not measured.'}"))
    rows = [
        (
            name,
            dimension_text(side),
            f"{1e3 * side.sigma_random_m:.2f} mm",
            f"{1e3 * side.sigma_systematic_m:.2f} mm" if side.sigma_systematic_m > 0 else "not known",
            f"{1e3 * side.rms_m:.2f} mm",
            f"{side.points:,}",
            f"{side.angle_deg:.3f}°",
        )
        for name, side in box.sides.items()
    ]
    columns = ("", "wall to wall", "from the points", "from the calibration", "wall RMS", "points", "not parallel by")
    text = (
        "As jaxscan measure room gives them: through the middle of the room, along the mean normal of two opposite "
        "walls. ± is one standard deviation."
    ) + "".join(f" A dimension is left out: {remark}." for remark in box.remarks)
    return section("Dimensions", element("p", text), table(columns, rows))


def _coverage(facts: Facts) -> Html:
    parts = [
        drawn(
            distance_map(seen),
            f"coverage-{number}",
            f"coverage {number}",
            *_coverage_words(seen, facts, number),
            class_="wide",
        )
        for number, seen in enumerate(facts.directions)
    ]
    lines = []
    if facts.cells is not None:
        lines.append(f"{100 * facts.cells:.1f} % of the lines of all profiles have a point.")
    if not facts.placed:
        lines.append("Nobody knows where the scanner stood: directions are those from the middle of the points.")
    if facts.far_off:
        lines.append(f"{facts.far_off:,} stray points are too far away to be drawn.")
    if facts.stations > len(facts.directions):
        lines.append(f"{facts.stations - len(facts.directions)} more stations are not drawn.")
    return section("Coverage", bullets(lines) if lines else "", *parts)


def _coverage_words(seen: Directions, facts: Facts, number: int) -> list[str]:
    elevation = seen.elevation_deg[seen.band]
    half = 0.5 * seen.side_deg
    station = f"Station {number}. " if facts.stations > 1 else ""
    first = (
        f"{station}{100 * seen.share(of_band=True):.1f} % of the directions between {_signed(elevation[-1] - half)} "
        f"and {_signed(elevation[0] + half)} of elevation have points, in cells of {seen.side_deg:g}°; "
        f"{100 * seen.share(of_band=False):.1f} % of all directions."
    )
    holes = seen.holes()
    where = [
        f"{hole.wide_deg:g}° wide, {hole.high_deg:g}° high at azimuth {_signed(hole.azimuth_deg)}, elevation "
        f"{_signed(hole.elevation_deg)}"
        for hole in holes[:NAMED_HOLES]
    ]
    more = f" and {len(holes) - NAMED_HOLES} smaller ones" if len(holes) > NAMED_HOLES else ""
    second = f" Holes (grey), the largest first: {'; '.join(where)}{more}." if where else " No holes."
    return [element("b", "Distance by direction. "), first, second]


def _signed(value: float) -> str:
    return f"{value:.0f}°".replace("-0°", "0°").replace("-", "−")


def _sigma(facts: Facts) -> Html:
    if not facts.sigma:
        return section("Uncertainty", element("p", "The cloud holds no standard deviations of its points."))
    title = element("b", "Sigma by direction. ")
    caption = (
        "Median standard deviation of the points of each cell along their rays: noise of the stripe and calibration "
        "together. Grey: no points, or none whose standard deviation is known."
    )
    parts = [
        drawn(sigma_map(seen), f"sigma-{number}", f"sigma {number}", title, caption, class_="wide")
        for number, seen in enumerate(facts.directions)
    ]
    rows = [
        (
            f"{row.nearest_m:g} to {row.farthest_m:g}" if row.farthest_m < 1e9 else f"over {row.nearest_m:g}",
            f"{row.points:,}",
            millimetres(1e3 * row.median_m),
            millimetres(1e3 * row.p95_m),
        )
        for row in facts.sigma
    ]
    figure, said = (
        sigma_against_distance(facts.sigma),
        "Standard deviation of a point along its ray against its distance.",
    )
    shown = drawn(figure, "sigma-distance", "Sigma against distance", said)
    parts.append(beside(shown, table(("distance, m", "points", "median sigma", "95 % below"), rows)))
    return section("Uncertainty", *parts)


def _left_out(facts: Facts, around: Beside) -> Html:
    lines = []
    if facts.beyond_walls is not None:
        count = "No point lies" if facts.beyond_walls == 0 else f"{facts.beyond_walls:,} points lie"
        lines.append(f"{count} outside the walls by more than 50 mm, where windows, doors and mirrors would put them.")
    lines.append(
        around.left_out
        or "How many stripes were left out is not known: a cloud does not hold them; --capture and -c find them again."
    )
    return section("Reflections left out", bullets(lines))


def _steps(facts: Facts, around: Beside) -> Html:
    lines = list(around.doubts or ())
    if around.doubts is None:
        lines += [f"By the points alone, {doubt}." for doubt in facts.doubts]
        lines.append(
            "The frames were not looked at: --capture and -c do so."
            if facts.turned
            else "Not known: the cloud does not say at which angles it was taken."
        )
    elif not lines:
        lines = ["None: frames, angles and points of all steps agree with those around them."]
    return section("Suspicious steps", bullets(map(sentence, lines)))


def _calibration(around: Beside) -> Html:
    if not around.calibration:
        return section("Calibration", element("p", "Not known: the cloud does not name it; -c gives it."))
    return section("Calibration", table(("", ""), around.calibration, kind="wrap words"))
