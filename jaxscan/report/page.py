"""The calibration report: one HTML page without external parts, drawn from a `Calibration`."""

from collections.abc import Mapping
from typing import Any

from jaxscan.calibration import Calibration
from jaxscan.geometry import Turntable
from jaxscan.report import figures, tables, words
from jaxscan.report.html import Html, bullets, element, joined, minus, page, section, table
from jaxscan.report.rig_plots import rig
from jaxscan.report.views import linked_record, views


def calibration_page(
    calibration: Calibration,
    *,
    notes: tuple[str, ...] = (),
    date: str = "",
    photographs: Mapping[int, bytes] | None = None,
) -> str:
    """The report of a calibration.

    Args:
        calibration: Residuals are drawn if it has `fit` and `observations`. Sections without data are left out.
        notes: Remarks that come first, as plain text.
        date: When it was made, as plain text.
        photographs: Small JPEGs by record, for the views of these records.

    Returns:
        An HTML document that fetches nothing and runs no scripts.
    """
    observations, fit = calibration.observations, calibration.fit
    # Of a solve that did not converge only the residuals are shown; they tell which views disagree.
    concluded = calibration.quality.converged is not False
    parts: list[Html | None] = [
        _head(calibration, date),
        *(element("p", note, class_="note") for note in notes),
        _verdict(calibration),
        _remarks(calibration),
    ]
    if concluded:
        parts += [rig(calibration), _tests(calibration), _parameters(calibration), figures.uncertainty(calibration)]
    if observations is not None and fit is not None:
        parts.append(figures.residuals_over_image(observations, fit))
        parts.append(figures.along_stripe_and_angle(observations, fit, turns=_turns(calibration)))
        if concluded:
            parts.append(figures.distributions(fit))
    parts.append(views(calibration, photographs or {}))
    if concluded:
        parts += [figures.board(calibration), figures.correlations(calibration), figures.spectrum(calibration)]
    parts += [_quality(calibration), _provenance(calibration)]
    return page("Calibration report", *(part for part in parts if part))


def _head(calibration: Calibration, date: str) -> Html:
    camera, observations = calibration.camera, calibration.observations
    lines = [f"{type(camera).__name__} camera, {camera.width} × {camera.height} px"]
    if observations is not None:
        lines.append(observations.board.describe())
    quality = calibration.quality
    if quality.views is not None and quality.corners is not None:
        lines.append(f"{quality.views} views, {quality.corners:,} corners")
    if calibration.scanner is None:
        lines.append("camera alone, without laser and turntable")
    elif not calibration.scanner.laser_names:
        lines.append("camera and axis, without laser")
    elif quality.stripe_points is not None:
        lines.append(f"{quality.stripe_points:,} stripe points")
    names = [str(capture.get("name")) for capture in _captures(calibration)]
    title = f"Calibration report: {', '.join(names)}" if names else "Calibration report"
    return element("header", element("h1", title), element("p", " · ".join([*([date] if date else []), *lines])))


def _turns(calibration: Calibration) -> bool:
    return calibration.scanner is not None and isinstance(calibration.scanner.turntable, Turntable)


def _verdict(calibration: Calibration) -> Html:
    first = words.headline(calibration)
    tiles = [
        element("div", element("b", f"± {words.millimetres(line.sigma_mm)}"), element("span", line.what), class_="tile")
        for line in words.lengths(calibration)
    ]
    card = element(
        "div", element("strong", first.headline), element("p", first.explanation), class_=f"verdict {first.kind}"
    )
    if not tiles:
        return card
    scale = (
        "They include the uncertainty of the board's size."
        if calibration.quality.board_pitch_sigma
        else "So does the error of the board's size, which is taken as exact: its scale is the scale of all lengths."
    )
    note = (
        "Standard deviations of lengths measured with this rig, as far as the calibration causes them. The noise of "
        f"the stripes adds to them. {scale}"
    )
    return joined([card, element("div", *tiles, class_="tiles"), element("p", note, class_="note")])


def _remarks(calibration: Calibration) -> Html:
    parts = [
        bullets(
            map(
                minus,
                [*words.board_lines(calibration), *words.noise_lines(calibration), *words.second_look(calibration)],
            )
        )
    ]
    bad = [
        joined(["Record", linked_record(calibration, view.record), f": {_sentence(view.why)}"])
        for view in words.bad_views(calibration)
    ]
    for title, lines in (
        ("Warnings", [*map(_sentence, words.warnings(calibration))]),
        ("Records that stand out", bad),
        ("Next captures", [*map(_sentence, words.advice(calibration))]),
    ):
        if lines:
            parts += [element("h3", title), bullets(lines)]
    return section("In words", *parts)


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:].removesuffix('.')}."


def _tests(calibration: Calibration) -> Html | None:
    rows = tables.outcome_rows(calibration)
    if not rows:
        return None
    return section(
        "Tests of the models",
        element(
            "p",
            "If a model suffices, its statistic is about as large as its degrees of freedom. p is the probability that "
            "chance alone gives a larger statistic, with the noise that the detectors promise; p of structure is the "
            "same with the noise that was found. If only p is small, the residuals are noisy but have no structure. "
            "Harm is the part of the error that the structure causes; the sigmas include it.",
        ),
        table(tables.OUTCOME_COLUMNS, rows, kind="words", worse=[row[6] == "structure" for row in rows]),
    )


def _parameters(calibration: Calibration) -> Html:
    rows = [parameter.row() for parameter in tables.parameters(calibration)]
    return section("Parameters", table(("parameter", "value", "standard deviation"), rows, kind="wrap"))


def _quality(calibration: Calibration) -> Html | None:
    rows = tables.quality_rows(calibration)
    return section("Numbers of the solve", table(("", ""), rows)) if rows else None


def _provenance(calibration: Calibration) -> Html:
    lines = [f"{capture.get('name')}: {capture.get('digest')}" for capture in _captures(calibration)]
    versions = calibration.provenance.get("versions")
    if isinstance(versions, dict):
        lines.append(", ".join(f"{name} {version}" for name, version in versions.items()))
    return element("footer", *(element("p", line) for line in lines))


def _captures(calibration: Calibration) -> list[dict[str, Any]]:
    """Name and digest of the captures, as far as the provenance in the file is well-formed."""
    captures = calibration.provenance.get("captures")
    return [capture for capture in captures if isinstance(capture, dict)] if isinstance(captures, list) else []
