"""The report of a recalibration: one HTML page without external parts, drawn from a `Recalibration`."""

import numpy as np

from jaxscan.recalibration import PanoramaOfWalls, Recalibration
from jaxscan.report.drawing import drawn
from jaxscan.report.html import Html, beside, bullets, element, joined, page, provenance, section, table, tiles, verdict
from jaxscan.report.recalibration import plots, words
from jaxscan.report.words import OF_LENGTHS, length_words, millimetres, sentence


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
    calibration = result.calibration
    foot = None
    if calibration is not None:
        foot = provenance(calibration.provenance, calibration.provenance.get("calibration"))
    return page(
        "Recalibration report",
        "Recalibration report",
        title,
        notes,
        _verdict(result),
        _remarks(result),
        _walls(result),
        _gained(result),
        _moved(result),
        _stations(result),
        foot,
    )


def _verdict(result: Recalibration) -> Html:
    first = words.headline(result)
    values = [
        (
            f"± {millimetres(one.after_mm)}",
            f"{length_words(one.name, one.length_m, one.depth_m)}; before ± {millimetres(one.before_mm)}",
        )
        for one in result.lengths
    ]
    return joined([verdict(first.kind, first.headline, element("p", first.explanation)), tiles(values, OF_LENGTHS)])


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
    seen = [one for one in result.panoramas if np.asarray(one.seen).any()]
    text = (
        "The distance of every point on a wall from the wall's plane, over the whole turn, with the stored calibration "
        "and with the new one, in one scale of colours. An error of the calibration bends walls, so it shows as bands "
        "and patches; the noise of the stripe and the roughness of the wall are grain. Cells without a point on a wall "
        "are grey."
    )
    figures = [_panorama(panorama, number) for number, panorama in enumerate(seen[:MAX_PANORAMAS])]
    left = len(seen) - MAX_PANORAMAS
    if left > 0:
        figures.append(element("p", f"{left} more sweeps are not drawn.", class_="note"))
    return section("Flatness of the walls", element("p", text), *figures) if seen else None


def _panorama(panorama: PanoramaOfWalls, number: int) -> Html:
    before, after = map(millimetres, words.flatness_mm(panorama))
    return drawn(
        plots.panorama_figure(*plots.panorama_rows(panorama)),
        f"panorama-{number}",
        f"Distance of points from the walls' planes over azimuth and line, before and after: {before} and {after}",
        element("b", panorama.sweep),
        f". Root mean square distance {before} before, {after} now.",
        class_="wide",
    )


def _gained(result: Recalibration) -> Html | None:
    if not result.gains:
        return None
    caption = (
        "Old over new standard deviation of independent directions in the space of the parameters. Flat walls leave "
        "two directions open, the radial scale and the height scale; the stored calibration holds them."
    )
    shown = drawn(plots.gain_figure(result.gains), "gain", "Gain of each direction", caption)
    return section("What was gained", beside(shown, bullets(words.gain_lines(result.gains))))


def _moved(result: Recalibration) -> Html | None:
    moved = words.by_sigmas(result.moved)
    if not moved:
        return None
    caption = (
        "The change of each parameter, in standard deviations that a change would have by chance. Changes within the "
        "grey band are no surprise. Parameters are correlated: the verdict above takes all of them together."
    )
    shown = drawn(plots.moved_figure(moved), "moved", "Change of each parameter in standard deviations", caption)
    rows = table(_MOVED, words.moved_rows(result.moved), kind="tall", worse=[abs(one.sigmas) > 3 for one in moved])
    return section("What moved", beside(shown, rows))


def _stations(result: Recalibration) -> Html | None:
    rows = words.station_rows(result)
    return section("Stations", table(_STATIONS, rows)) if rows else None
