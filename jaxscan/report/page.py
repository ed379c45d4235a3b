"""The calibration report: one HTML page without external parts, drawn from a `Calibration`."""

import base64
from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxscan.calibration import Calibration, Fit, JudgedView, judge_views
from jaxscan.geometry import Turntable
from jaxscan.observation import Observations
from jaxscan.report import figures, plots, tables, words
from jaxscan.report.drawing import as_svg
from jaxscan.report.figures import rig
from jaxscan.report.html import Html, bullets, element, joined, minus, page, section, table
from jaxscan.report.tables import view_columns, view_rows
from jaxscan.stripes import PixelFormat
from jaxscan.vision import encode_jpeg, to_grey


WIDE_PX = 240
_QUALITY = 70


def thumbnail(frame: np.ndarray, pixel_format: PixelFormat) -> bytes:
    """An image of a camera as a small JPEG.

    Args:
        frame: uint8 [rows, columns(, 3)], as the camera gave it.
        pixel_format: How it is to be read; mosaics become grey.
    """
    image = frame if frame.ndim == 3 else to_grey(frame, pixel_format)
    rows, columns = image.shape[:2]
    step = -(-columns // WIDE_PX)
    whole = image[: rows // step * step, : columns // step * step]
    # The mean of squares of pixels: fine patterns would alias otherwise.
    shape = whole.shape[0] // step, step, whole.shape[1] // step, step, -1
    mean = whole.reshape(shape).astype(np.float32).mean((1, 3))
    brightest = max(float(np.percentile(mean, 99.5)), 1.0)
    shown = np.clip(mean * min(235.0 / brightest, 4.0), 0, 255).astype(np.uint8)
    return encode_jpeg(np.repeat(shown, 3 // shown.shape[2], axis=2), quality=_QUALITY)


OPEN_PANELS = 11
"""Number of views that are drawn openly: with the scale they fill whole rows."""
MAX_PANELS = 59
"""Number of views that are drawn, including those in the part that unfolds. The table lists all views."""


def views(calibration: Calibration, photographs: Mapping[int, bytes]) -> Html | None:
    """All views, worst first: a table, and the residual vectors of each with its photograph.

    Args:
        photographs: JPEGs by record; views without one have none.
    """
    rows = view_rows(calibration)
    if not rows:
        return None
    judged = judge_views(calibration.quality, calibration.fit, calibration.observations)
    drawn = {view.row for view in _drawn(calibration)}
    bad = {str(view.record) for view in words.bad_views(calibration)}
    linked = [
        (element("a", row[0], href=f"#panel-{view.row}") if view.row in drawn else row[0], *row[1:])
        for row, view in zip(rows, judged, strict=True)
    ]
    parts = [table(view_columns(calibration), linked, kind="tall", worse=[row[0] in bad for row in rows])]
    observations, fit = calibration.observations, calibration.fit
    if observations is not None and fit is not None:
        parts.append(_panels(_drawn(calibration), len(judged), observations, fit, photographs))
    return section("Views, worst first", *parts)


def drawn_records(calibration: Calibration) -> list[int]:
    """Records whose views are drawn, worst first; of a number that several captures have, none."""
    records = [view.quality.record for view in _drawn(calibration)]
    every = [view.record for view in calibration.quality.per_view]
    return [record for record in records if every.count(record) == 1]


def _drawn(calibration: Calibration) -> list[JudgedView]:
    if calibration.observations is None or calibration.fit is None:
        return []
    judged = judge_views(calibration.quality, calibration.fit, calibration.observations)
    return [view for view in judged if view.row is not None][:MAX_PANELS]


def linked_record(calibration: Calibration, record: int) -> Html:
    """The number of a record, which leads to its view where that is drawn."""
    rows = [view.row for view in _drawn(calibration) if view.quality.record == record]
    return element("a", str(record), href=f"#panel-{rows[0]}") if rows else element("span", str(record))


def _panels(
    drawn: list[JudgedView], views_in_all: int, observations: Observations, fit: Fit, photographs: Mapping[int, bytes]
) -> Html:
    scale = plots.residual_scale(fit)

    def panel(view: JudgedView) -> Html:
        row, record, rejected = view.row or 0, view.quality.record, view.quality.corners_rejected
        figure = plots.view_residuals(observations, fit, row, scale)
        size = f" {view.rms_px:.3f} px" + (f", {rejected} rejected" if rejected else "")
        parts = [
            as_svg(figure, f"view-{row}", f"Corner residuals of record {record}"),
            *_photograph(photographs.get(record), record),
            element("figcaption", element("b", f"record {record}"), size),
        ]
        return element("figure", *parts, id=f"panel-{row}")

    bar = as_svg(plots.scale_bar(scale, observations.width), "scale", f"An arrow of {scale:g} px")
    first = [panel(view) for view in drawn[:OPEN_PANELS]]
    more = [panel(view) for view in drawn[OPEN_PANELS:]]
    arrows = "Each arrow leads from the detected corner to the predicted corner. Crosses are rejected corners."
    parts = [
        element("p", arrows),
        element("div", element("figure", bar, element("figcaption", "scale of all arrows")), *first, class_="panels"),
    ]
    if more:
        left = views_in_all - len(drawn)
        title = f"{len(more)} more views" + (f"; {left} better ones are not drawn" if left > 0 else "")
        parts.append(element("details", element("summary", title), element("div", *more, class_="panels")))
    return joined(parts)


def _photograph(jpeg: bytes | None, record: int) -> list[Html]:
    if jpeg is None:
        return []
    data = base64.b64encode(jpeg).decode()
    return [element("img", src=f"data:image/jpeg;base64,{data}", alt=f"Photograph of record {record}")]


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
    lines = words.lengths(calibration)
    tiles = [
        element("div", element("b", f"± {words.millimetres(line.sigma_mm)}"), element("span", line.what), class_="tile")
        for line in lines
        if not line.part
    ]
    parts = [element("li", f"{words.millimetres(line.sigma_mm)} {line.what}") for line in lines if line.part]
    said = [element("strong", first.headline), element("p", first.explanation)]
    # The squares of the parts add up to the square of the figure in the headline.
    card = element("div", *said, *([element("ul", *parts)] if parts else []), class_=f"verdict {first.kind}")
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
        joined(["Record", linked_record(calibration, view.record), f": {words.sentence(view.why)}"])
        for view in words.bad_views(calibration)
    ]
    for title, lines in (
        ("Warnings", [*map(words.sentence, words.warnings(calibration))]),
        ("Records that stand out", bad),
        ("Next captures", [*map(words.sentence, words.advice(calibration))]),
    ):
        if lines:
            parts += [element("h3", title), bullets(lines)]
    return section("In words", *parts)


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
