"""The calibration report: one page that stands alone, drawn from a `Calibration`."""

from typing import TYPE_CHECKING, Any

import numpy as np

from jaxscan.calibration import Calibration
from jaxscan.calibration.result import Fit
from jaxscan.calibration.verdict.lengths import stripe_depths, stripe_pixels
from jaxscan.geometry import Charuco, Scanner
from jaxscan.observation import Observations
from jaxscan.report import calibration as words
from jaxscan.report import calibration_tables as tables
from jaxscan.report import image_plots, residual_plots, uncertainty_plots
from jaxscan.report.drawing import as_svg
from jaxscan.report.html import Html, bullets, element, joined, page, section, table


if TYPE_CHECKING:
    from matplotlib.figure import Figure


OPEN_PANELS = 11
"""Views that are drawn for all to see ..."""
MAX_PANELS = 59
"""... and with those that unfold; the table lists all."""


def calibration_page(calibration: Calibration, *, notes: tuple[str, ...] = ()) -> str:
    """A calibration as an HTML page.

    Args:
        calibration: With `fit` and `observations`, where residuals are to be drawn; what is not there is left out.
        notes: Remarks to put first, in plain text.

    Returns:
        The document: nothing in it is fetched from anywhere, and nothing runs.
    """
    parts = [
        _head(calibration),
        *(element("p", note, class_="note") for note in notes),
        _verdict(calibration),
        _remarks(calibration),
        _tests(calibration),
        _parameters(calibration),
        _uncertainty(calibration),
        _residuals_over_image(calibration),
        _stripes(calibration),
        _distributions(calibration),
        _views(calibration),
        _correlations(calibration),
        _spectrum(calibration),
        _quality(calibration),
        _provenance(calibration),
    ]
    return page("Calibration report", *(part for part in parts if part))


def _head(calibration: Calibration) -> Html:
    camera, observations = calibration.camera, calibration.observations
    lines = [f"{type(camera).__name__} camera, {camera.width} × {camera.height} px"]
    if observations is not None:
        columns, rows = observations.board.grid()
        kind = "ChArUco board" if isinstance(observations.board, Charuco) else "chessboard"
        lines.append(f"{kind}, {columns} × {rows} inner corners of {1e3 * observations.board.square:g} mm")
    views, corners = (words.number(calibration.quality, key) for key in ("views", "corners"))
    if views is not None and corners is not None:
        lines.append(f"{views:.0f} views, {corners:.0f} corners")
    points = words.number(calibration.quality, "stripe_points")
    if calibration.scanner is None:
        lines.append("camera alone, without laser and table")
    elif points is not None:
        lines.append(f"{points:.0f} stripe points")
    names = [str(capture.get("name")) for capture in words.records(calibration.provenance, "captures")]
    title = f"Calibration report: {', '.join(names)}" if names else "Calibration report"
    return element("header", element("h1", title), element("p", " · ".join(lines)))


def _verdict(calibration: Calibration) -> Html:
    verdict = words.verdict(calibration)
    tiles = [
        element("div", element("b", f"± {words.millimetres(line.sigma_mm)}"), element("span", line.what), class_="tile")
        for line in words.lengths(calibration)
    ]
    card = element(
        "div", element("strong", verdict.headline), element("p", verdict.explanation), class_=f"verdict {verdict.kind}"
    )
    if not tiles:
        return card
    scale = (
        "The uncertainty of the board's size is in them."
        if words.number(calibration.quality, "board_pitch_sigma")
        else "So does any error of the board's size, which is taken as exact: its scale is the scale of everything."
    )
    note = (
        "Standard deviations that the calibration alone causes in lengths measured with this rig. The noise of the "
        f"stripe itself comes on top. {scale}"
    )
    return joined([card, element("div", *tiles, class_="tiles"), element("p", note, class_="note")])


def _remarks(calibration: Calibration) -> Html:
    parts = [bullets([*words.noise_lines(calibration), *words.second_look(calibration)])]
    bad = [f"Record {view.record}: {view.why}" for view in words.bad_views(calibration)]
    for title, lines in (
        ("Warnings", words.warnings(calibration)),
        ("Records that stand out", bad),
        ("What to capture next", words.advice(calibration)),
    ):
        if lines:
            parts += [element("h3", title), bullets(map(_sentence, lines))]
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
            "Each statistic is about as large as its degrees of freedom where the model suffices. p says how often "
            "chance alone gives a larger one, with the noise that the detectors promise; p of structure takes the "
            "noise that is there. Where only p is small, the residuals are noisy but have no structure.",
        ),
        table(tables.OUTCOME_COLUMNS, rows, kind="words", worse=[row[6] != "passes" for row in rows]),
    )


def _parameters(calibration: Calibration) -> Html:
    rows = [parameter.row() for parameter in tables.parameters(calibration)]
    return section("Parameters", table(("parameter", "value", "standard deviation"), rows, kind="wrap"))


def _uncertainty(calibration: Calibration) -> Html | None:
    curves = []
    for name, laser in words.lasers_of(calibration):
        pairs = [
            (words.number(row, "depth_m"), words.number(row, "sigma_depth_mm"))
            for row in words.records(laser, "depths")
        ]
        known = np.array([pair for pair in pairs if pair[0] and pair[1] and min(pair[0], pair[1]) > 0], np.float64)
        if len(known):
            curves.append((name, known[:, 0], known[:, 1]))
    if not curves or calibration.scanner is None:
        return None
    noise = _stripe_noise_mm(calibration, curves[0][0], curves[0][1])
    figure = uncertainty_plots.depth_against_distance(curves, noise)
    caption = (
        "What the calibration leaves uncertain in the depth, as root mean square over the lit lines of the image. It "
        "is shared by neighbouring points and does not average out; the noise of a point's own stripe does."
    )
    rows = [
        (
            name,
            f"{words.number(row, 'depth_m') or 0:g}",
            *(
                words.millimetres(sigma) if (sigma := words.number(row, key)) is not None else "–"
                for key in ("sigma_depth_mm", "sigma_range_mm", "sigma_point_mm")
            ),
        )
        for name, laser in words.lasers_of(calibration)
        for row in words.records(laser, "depths")
    ]
    columns = ("laser", "depth, m", "depth", "distance from the camera", "points of a full turn")
    drawn = _figure(figure, "depth", "Depth uncertainty against depth", caption)
    return section(
        "Uncertainty against distance", element("div", drawn, element("div", table(columns, rows)), class_="figures")
    )


def _stripe_noise_mm(calibration: Calibration, name: str, depths: np.ndarray) -> np.ndarray:
    """Standard deviation of a point's depth from the noise of its own stripe, mid-stripe [mm]; 0 where unknown."""
    scanner, fit, observations = calibration.scanner, calibration.fit, calibration.observations
    noise = np.zeros(len(depths))
    if fit is None or observations is None or scanner is None or name not in scanner.laser_names:
        return noise
    if not residual_plots.has_stripes(observations, fit):
        return noise
    laser = scanner.laser_names.index(name)
    sigma = fit.stripe_sigma[fit.stripe_kept & (np.asarray(observations.stripes.laser) == laser)[:, None]]
    if not sigma.size:
        return noise
    across = 1 - residual_plots.stripe_direction(observations)
    # Without names, of which every other one would compile anew.
    scanner = Scanner(scanner.camera, scanner.lasers, scanner.turntable, laser_names=_numbers(scanner))
    half = 0.5 * np.eye(2)[across]
    for index, depth in enumerate(depths):
        q = stripe_pixels(scanner, laser, float(depth))
        if len(q):
            middle = q[len(q) // 2]
            near, far = stripe_depths(scanner, laser, np.stack([middle - half, middle + half]))
            noise[index] = 1e3 * abs(far - near) * float(np.median(sigma))
    return noise


def _numbers(scanner: Scanner) -> tuple[str, ...]:
    return tuple(str(index) for index in range(len(scanner.laser_names)))


def _residuals_over_image(calibration: Calibration) -> Html | None:
    observations, fit = calibration.observations, calibration.fit
    if observations is None or fit is None or not fit.corner_kept.any():
        return None
    striped = residual_plots.has_stripes(observations, fit)
    seen = "Corners (blue) and stripes (other colours)" if striped else "Corners"
    figures = [
        _figure(
            image_plots.coverage_map(observations, fit),
            "coverage",
            "Corners and stripes over the image",
            f"<b>Coverage.</b> {seen} that were used. The lens is known only where there are corners: the edges and "
            "corners of the image should be full too.",
        ),
        _figure(
            image_plots.direction_map(observations, fit),
            "directions",
            "Direction of the corner residuals over the image",
            "<b>Directions.</b> Each corner has the colour of its residual's direction. Colours should be mixed "
            "everywhere: patches of one colour are errors of a model. Arrows: the mean of a cell, where it is more "
            "than noise (of a hundred cells, one by chance).",
        ),
    ]
    return section("Residuals over the image", element("div", *figures, class_="figures"))


def _stripes(calibration: Calibration) -> Html | None:
    observations, fit = calibration.observations, calibration.fit
    if observations is None or fit is None:
        return None
    figures = []
    striped = residual_plots.has_stripes(observations, fit)
    if striped:
        figures.append(
            _figure(
                residual_plots.along_stripe(observations, fit),
                "along",
                "Stripe residuals along the image",
                "<b>Along the stripe.</b> Every point, and the mean of pieces with two standard deviations. "
                "A curve means a sheet that is not flat, or a lens model that is too simple.",
            )
        )
    if residual_plots.turned_views(observations).any() and calibration.scanner is not None:
        if striped:
            figures.append(
                _figure(
                    residual_plots.stripes_against_angle(observations, fit),
                    "angle-stripes",
                    "Stripe residuals against the table's angle",
                    "<b>Stripes against the table's angle.</b> Mean of every stripe.",
                )
            )
        figures.append(
            _figure(
                residual_plots.corners_against_angle(observations, fit),
                "angle-corners",
                "Corner residuals against the table's angle",
                "<b>Corners against the table's angle.</b> Mean of every view of a board that stood still while the "
                "table turned. A curve means a table that turns unevenly or wobbles.",
            )
        )
    return section("Stripe and table", element("div", *figures, class_="figures")) if figures else None


def _distributions(calibration: Calibration) -> Html | None:
    if calibration.fit is None:
        return None
    figures = []
    for name, whitened in residual_plots.whitened_residuals(calibration.fit).items():
        far = float(np.mean(np.abs(whitened) > 3))
        caption = (
            f"<b>{name.capitalize()}.</b> {len(whitened)} residuals, standard deviation {np.std(whitened):.3f}; "
            f"{100 * far:.2f} % beyond 3 (Gaussian: 0.27 %)."
        )
        figures += [
            _figure(residual_plots.histogram(whitened), f"histogram-{name}", f"Histogram of {name}", caption),
            _figure(
                residual_plots.quantiles(whitened),
                f"quantiles-{name}",
                f"Quantiles of {name}",
                f"<b>{name.capitalize()}, quantiles.</b> On the line where they are Gaussian; ends that bend away are "
                "outliers that were kept.",
            ),
        ]
    if not figures:
        return None
    text = (
        "Residuals divided by the standard deviation that each should have: its own noise, as estimated from all of "
        "its group, less what the fit takes up."
    )
    return section("Are the residuals noise?", element("p", text), element("div", *figures, class_="figures"))


def _views(calibration: Calibration) -> Html | None:
    rows = tables.view_rows(calibration)
    if not rows:
        return None
    bad = {str(view.record) for view in words.bad_views(calibration)}
    parts = [
        table(
            [title for title, _ in tables.VIEW_COLUMNS.values()],
            rows,
            kind="tall",
            worse=[row[0] in bad for row in rows],
        )
    ]
    observations, fit = calibration.observations, calibration.fit
    if observations is not None and fit is not None:
        parts.append(_panels(calibration, observations, fit))
    return section("Views, worst first", *parts)


def _panels(calibration: Calibration, observations: Observations, fit: Fit) -> Html:
    every = [view for view in words.views(calibration) if "view" in view]
    scale = image_plots.residual_scale(fit)

    def panel(view: dict[str, Any]) -> Html:
        record, rejected = int(view["record"]), words.number(view, "corners_rejected")
        drawn = image_plots.view_residuals(observations, fit, view["view"], scale)
        size = words.number(view, "kept_rms_px") or words.number(view, "corner_rms_px") or 0.0
        return element(
            "figure",
            as_svg(drawn, f"view-{view['view']}", f"Corner residuals of record {record}"),
            element(
                "figcaption",
                element("b", f"record {record}"),
                f" {size:.3f} px" + (f", {rejected:.0f} rejected" if rejected else ""),
            ),
        )

    bar = as_svg(image_plots.scale_bar(scale, observations.width), "scale", f"An arrow of {scale:g} px")
    first = [panel(view) for view in every[:OPEN_PANELS]]
    more = [panel(view) for view in every[OPEN_PANELS:MAX_PANELS]]
    parts = [
        element(
            "p",
            "Arrows lead from the corner that was found to where the calibration expects it; crosses were rejected.",
        ),
        element("div", element("figure", bar, element("figcaption", "scale of all arrows")), *first, class_="panels"),
    ]
    if more:
        left = len(every) - MAX_PANELS
        title = f"{len(more)} more views" + (f"; {left} better ones are not drawn" if left > 0 else "")
        parts.append(element("details", element("summary", title), element("div", *more, class_="panels")))
    return joined(parts)


def _correlations(calibration: Calibration) -> Html | None:
    if not (np.diag(calibration.covariance) > 0).any():
        return None
    caption = (
        "Of what was estimated; numbers where the correlation exceeds one half. Strong ones are no fault: they say "
        "that only a combination is known, which is what the lengths above take into account."
    )
    figure = uncertainty_plots.correlations(calibration.order, calibration.covariance)
    drawn = _figure(figure, "correlations", "Correlation matrix of the shared parameters", caption, class_="wide")
    return section("Correlations", drawn)


def _spectrum(calibration: Calibration) -> Html | None:
    directions = [
        (sigma, {str(name): float(part) for name, part in row["direction"].items() if isinstance(part, int | float)})
        for row in words.records(calibration.quality, "spectrum")
        if (sigma := words.number(row, "sigma_over_prior")) is not None and isinstance(row.get("direction"), dict)
    ]
    if not directions:
        return None
    directions.sort(key=lambda item: -item[0])
    weak = [
        f"{uncertainty_plots.combination(parts)} ({100 * sigma:.0f} % of the prior's standard deviation)"
        for sigma, parts in directions
        if sigma > uncertainty_plots.WEAK
    ]
    text = (
        f"Held by what was known beforehand rather than by these data: {'; '.join(weak)}."
        if weak
        else "Every combination of parameters is held by the data."
    )
    return section(
        "What the data say nothing about",
        element("p", text),
        element(
            "div",
            _figure(
                uncertainty_plots.spectrum(directions),
                "spectrum",
                "Standard deviation of every combination of parameters over its prior",
                "Independent combinations of parameters, named by their largest parts. At 1 the data add nothing.",
            ),
            class_="figures",
        ),
    )


def _quality(calibration: Calibration) -> Html | None:
    rows = tables.quality_rows(calibration)
    return section("Numbers of the solve", table(("", ""), rows)) if rows else None


def _provenance(calibration: Calibration) -> Html:
    lines = [
        f"{capture.get('name')}: {capture.get('digest')}"
        for capture in words.records(calibration.provenance, "captures")
    ]
    versions = calibration.provenance.get("versions")
    if isinstance(versions, dict):
        lines.append(", ".join(f"{name} {version}" for name, version in versions.items()))
    return element("footer", *(element("p", line) for line in lines))


def _figure(figure: "Figure", name: str, description: str, caption: str, **attributes: str) -> Html:
    """A figure with its caption, which is markup of this module's own."""
    drawn = as_svg(figure, name, description)
    return element("figure", drawn, element("figcaption", Html(caption)), **attributes)
