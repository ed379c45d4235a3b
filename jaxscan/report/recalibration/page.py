"""The report of a recalibration: one HTML page without external parts, drawn from a `Recalibration`."""

import numpy as np

from jaxscan.recalibration import PanoramaOfWalls, Recalibration
from jaxscan.report.drawing import as_svg
from jaxscan.report.html import Html, bullets, element, joined, page, section, table
from jaxscan.report.recalibration import plots, words
from jaxscan.report.words import length_words, millimetres, sentence


MAX_PANORAMAS = 6
"""Sweeps whose panoramas are drawn; the numbers of all are listed."""
_MOVED = ("parameter", "before", "now", "sigma before", "sigma now", "change, sigmas")
_STATIONS = ("station", "x, m", "y, m", "z, m", "turned, degrees", "sigma of its place, mm", "sigma of its turn, mrad")


def recalibration_page(result: Recalibration, *, title: str = "", notes: tuple[str, ...] = ()) -> str:
    """The report of a recalibration.

    Args:
        result: Sections without data are left out.
        title: The calibration and the captures, as plain text.
        notes: Remarks that come first, as plain text.

    Returns:
        An HTML document that fetches nothing and runs no scripts.
    """
    parts: list[Html | None] = [
        element("header", element("h1", "Recalibration report"), element("p", title)),
        *(element("p", note, class_="note") for note in notes),
        _verdict(result),
        _remarks(result),
        _walls(result),
        _gained(result),
        _moved(result),
        _closure(result),
        _stations(result),
        _provenance(result),
    ]
    return page("Recalibration report", *(part for part in parts if part))


def _verdict(result: Recalibration) -> Html:
    first = words.headline(result)
    card = element(
        "div", element("strong", first.headline), element("p", first.explanation), class_=f"verdict {first.kind}"
    )
    tiles = [
        _tile(
            f"± {millimetres(one.after_mm)}",
            f"{length_words(one.name, one.length_m, one.depth_m)}; before ± {millimetres(one.before_mm)}",
        )
        for one in result.lengths
    ]
    if not tiles:
        return card
    note = (
        "Standard deviations of lengths measured with this rig, as far as the calibration causes them. The noise of "
        "the stripes adds to them."
    )
    return joined([card, element("div", *tiles, class_="tiles"), element("p", note, class_="note")])


def _tile(value: str, text: str) -> Html:
    return element("div", element("b", value), element("span", text), class_="tile")


def _remarks(result: Recalibration) -> Html | None:
    parts = []
    walls = [*words.wall_lines(result), *words.hold_out_lines(result), *words.closure_lines(result)]
    for title, lines in (
        ("", [*words.known_lines(result), *walls]),
        ("The table", words.table_lines(result)),
        ("Of this these captures tell nothing", result.unobserved),
        ("Notes", result.notes),
    ):
        if lines:
            parts += [element("h3", title)] * bool(title) + [bullets(map(sentence, lines))]
    return section("In words", *parts) if parts else None


def _walls(result: Recalibration) -> Html | None:
    drawn = [one for one in result.panoramas if np.asarray(one.seen).any()]
    if not drawn:
        return None
    text = (
        "The distance of every point on a wall from the wall's plane, over the whole turn, with the stored calibration "
        "and with the new one, in one scale of colours. An error of the calibration bends walls, so it shows as bands "
        "and patches; the noise of the stripe and the roughness of the wall are grain. Cells without a point on a wall "
        "are grey."
    )
    figures = [_panorama(panorama, number) for number, panorama in enumerate(drawn[:MAX_PANORAMAS])]
    left = len(drawn) - MAX_PANORAMAS
    if left > 0:
        figures.append(element("p", f"{left} more sweeps are not drawn.", class_="note"))
    return section("Flatness of the walls", element("p", text), *figures)


def _panorama(panorama: PanoramaOfWalls, number: int) -> Html:
    before, after = words.flatness_mm(panorama)
    drawn = as_svg(
        plots.panorama_figure(*plots.panorama_rows(panorama)),
        f"panorama-{number}",
        f"Distance of points from the walls' planes over azimuth and line, before and after: {millimetres(before)} and "
        f"{millimetres(after)}",
    )
    caption = f". Root mean square distance {millimetres(before)} before, {millimetres(after)} now."
    return element("figure", drawn, element("figcaption", element("b", panorama.sweep), caption), class_="wide")


def _gained(result: Recalibration) -> Html | None:
    if not result.gains:
        return None
    caption = (
        "Old over new standard deviation of independent directions in the space of the parameters. Flat walls leave "
        "two directions open, the radial scale and the height scale; the stored calibration holds them."
    )
    drawn = _figure(plots.gain_figure(result.gains), "gain", "Gain of each direction", caption)
    listed = bullets(words.gain_lines(result.gains))
    return section("What was gained", element("div", drawn, element("div", listed), class_="figures"))


def _moved(result: Recalibration) -> Html | None:
    moved = words.by_sigmas(result.moved)
    if not moved:
        return None
    caption = (
        "The change of each parameter, in standard deviations that a change would have by chance. Changes within the "
        "grey band are no surprise. Parameters are correlated: the verdict above takes all of them together."
    )
    drawn = _figure(plots.moved_figure(moved), "moved", "Change of each parameter in standard deviations", caption)
    rows = table(_MOVED, words.moved_rows(result.moved), kind="tall", worse=[abs(one.sigmas) > 3 for one in moved])
    return section("What moved", element("div", drawn, element("div", rows), class_="figures"))


def _closure(result: Recalibration) -> Html | None:
    if result.closure is None or result.closure.before_mm is None:
        return None
    caption = "The distance between the ends of one full turn, with one standard deviation."
    drawn = _figure(plots.closure_figure(result.closure), "closure", "Closure before and after", caption)
    return section("Closure", element("div", drawn, class_="figures"))


def _stations(result: Recalibration) -> Html | None:
    rows = words.station_rows(result)
    return section("Stations", table(_STATIONS, rows)) if rows else None


def _provenance(result: Recalibration) -> Html | None:
    calibration = result.calibration
    if calibration is None:
        return None
    origin, captures = calibration.provenance.get("calibration") or {}, calibration.provenance.get("captures") or []
    lines = [f"{one.get('name')}: {one.get('digest')}" for one in (origin, *captures) if one]
    versions = calibration.provenance.get("versions") or {}
    lines.append(", ".join(f"{name} {version}" for name, version in versions.items()))
    return element("footer", *(element("p", line) for line in lines))


def _figure(figure: object, name: str, description: str, caption: str) -> Html:
    return element("figure", as_svg(figure, name, description), element("figcaption", caption))  # type: ignore[arg-type]
