"""All views of a calibration: a table, and residuals and photograph of each."""

import base64
from collections.abc import Mapping

from jaxscan.calibration import Calibration, Fit, JudgedView, judge_views
from jaxscan.observation import Observations
from jaxscan.report import image_plots, words
from jaxscan.report.drawing import as_svg
from jaxscan.report.html import Html, element, joined, section, table
from jaxscan.report.tables import view_columns, view_rows


OPEN_PANELS = 11
"""Number of views that are drawn openly: with the scale they fill whole rows."""
MAX_PANELS = 59
"""Number of views that are drawn, including those in the part that unfolds. The table lists all views."""


def views(calibration: Calibration, photographs: Mapping[int, bytes]) -> Html | None:
    """All views, worst first: a table, and the residual vectors of each with its photograph.

    Args:
        calibration: The calibration.
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
    scale = image_plots.residual_scale(fit)

    def panel(view: JudgedView) -> Html:
        row, record, rejected = view.row or 0, view.quality.record, view.quality.corners_rejected
        figure = image_plots.view_residuals(observations, fit, row, scale)
        size = f" {view.rms_px:.3f} px" + (f", {rejected} rejected" if rejected else "")
        parts = [
            as_svg(figure, f"view-{row}", f"Corner residuals of record {record}"),
            *_photograph(photographs.get(record), record),
            element("figcaption", element("b", f"record {record}"), size),
        ]
        return element("figure", *parts, id=f"panel-{row}")

    bar = as_svg(image_plots.scale_bar(scale, observations.width), "scale", f"An arrow of {scale:g} px")
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
