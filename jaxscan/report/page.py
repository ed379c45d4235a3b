"""The calibration report: one HTML page without external parts, drawn from a `Calibration`."""

import base64
from collections.abc import Mapping, Sequence

import numpy as np

from jaxscan.calibration import (
    Calibration,
    Fit,
    JudgedView,
    is_held_by_priors,
    judge_views,
    stripe_depths,
    stripe_pixels,
)
from jaxscan.geometry import Turntable
from jaxscan.observation import Observations
from jaxscan.report import plots, tables, words
from jaxscan.report.drawing import as_svg, drawn
from jaxscan.report.html import (
    Html,
    beside,
    bullets,
    captioned,
    element,
    joined,
    minus,
    page,
    provenance,
    section,
    table,
    tiles,
    verdict,
)
from jaxscan.report.rig import rig_figure, rig_lengths, sheet_slopes_deg
from jaxscan.stripes import PixelFormat
from jaxscan.vision import encode_jpeg, to_grey


WIDE_PX = 240
_QUALITY = 70
OPEN_PANELS = 11
"""Number of views that are drawn openly: with the scale they fill whole rows."""
MAX_PANELS = 59
"""Number of views that are drawn, including those in the part that unfolds. The table lists all views."""


def thumbnail(frame: np.ndarray, pixel_format: PixelFormat) -> bytes:
    """An image of a camera, uint8 [rows, columns(, 3)], as a small JPEG; mosaics become grey."""
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
    # If the solve did not converge, only the residuals are shown; they tell which views disagree.
    concluded = calibration.quality.converged is not False
    parts: list[Html | None] = [_verdict(calibration), _remarks(calibration)]
    if concluded:
        parts += [_rig(calibration), _tests(calibration), _parameters(calibration), _uncertainty(calibration)]
    if observations is not None and fit is not None:
        parts += [_over_image(observations, fit), _along_and_angle(calibration, observations, fit)]
        parts += [_distributions(fit)] if concluded else []
    parts.append(_views(calibration, photographs or {}))
    if concluded:
        parts += [_board(calibration), _correlations(calibration), _spectrum(calibration)]
    parts += [_quality(calibration), provenance(calibration.provenance)]
    names = words.capture_names(calibration)
    heading = f"Calibration report: {', '.join(names)}" if names else "Calibration report"
    return page("Calibration report", heading, _about(calibration, date), notes, *parts)


def _about(calibration: Calibration, date: str) -> str:
    camera, observations, quality = calibration.camera, calibration.observations, calibration.quality
    lines = [date] if date else []
    lines.append(f"{type(camera).__name__} camera, {camera.width} × {camera.height} px")
    if observations is not None:
        lines.append(observations.board.describe())
    if quality.views is not None and quality.corners is not None:
        lines.append(f"{quality.views} views, {quality.corners:,} corners")
    if calibration.scanner is None:
        lines.append("camera alone, without laser and turntable")
    elif not calibration.scanner.laser_names:
        lines.append("camera and axis, without laser")
    elif quality.stripe_points is not None:
        lines.append(f"{quality.stripe_points:,} stripe points")
    return " · ".join(lines)


def _verdict(calibration: Calibration) -> Html:
    first, lines = words.headline(calibration), words.lengths(calibration)
    # The squares of the parts add up to the square of the figure in the headline.
    parts = [f"{words.millimetres(line.sigma_mm)} {line.what}" for line in lines if line.part]
    card = verdict(first.kind, first.headline, element("p", first.explanation), bullets(parts) if parts else "")
    scale = (
        "They include the uncertainty of the board's size."
        if calibration.quality.board_pitch_sigma
        else "So does the error of the board's size, which is taken as exact: its scale is the scale of all lengths."
    )
    values = [(f"± {words.millimetres(line.sigma_mm)}", line.what) for line in lines if not line.part]
    return joined([card, tiles(values, f"{words.OF_LENGTHS} {scale}")])


def _remarks(calibration: Calibration) -> Html:
    lines = [*words.board_lines(calibration), *words.noise_lines(calibration), *words.second_look(calibration)]
    parts = [bullets(map(minus, lines))]
    bad = [
        joined(["Record", _linked(calibration, view.record), f": {words.sentence(view.why)}"])
        for view in words.bad_views(calibration)
    ]
    for title, told in (
        ("Warnings", [*map(words.sentence, words.warnings(calibration))]),
        ("Records that stand out", bad),
        ("Next captures", [*map(words.sentence, words.advice(calibration))]),
    ):
        parts += [element("h3", title), bullets(told)] if told else []
    return section("In words", *parts)


def _rig(calibration: Calibration) -> Html | None:
    """The drawing of the rig, with the angles between its parts."""
    scanner = calibration.scanner
    if scanner is None or not (scanner.laser_names or isinstance(scanner.turntable, Turntable)):
        return None
    lengths = rig_lengths(scanner)
    if not all(np.isfinite(value) and value < 1e4 for _, value in lengths):
        return None
    rows = [(name, f"{1e3 * value:.1f} mm") for name, value in lengths]
    rows += [
        (f"sheet {name} to the camera's line of sight", f"{slope:.2f}°") for name, slope in sheet_slopes_deg(scanner)
    ]
    note = " Where a laser itself is, the calibration does not say: it is somewhere on its sheet."
    shown = drawn(rig_figure(scanner), "rig", "The rig in three dimensions", element("b", "To scale."), note)
    return section("The rig", beside(shown, table(("shortest distances, and angles", ""), rows, kind="wrap")))


def _tests(calibration: Calibration) -> Html | None:
    rows = tables.outcome_rows(calibration)
    text = (
        "If a model suffices, its statistic is about as large as its degrees of freedom. p is the probability that "
        "chance alone gives a larger statistic, with the noise that the detectors promise; p of structure is the "
        "same with the noise that was found. If only p is small, the residuals are noisy but have no structure. "
        "Harm is the part of the error that the structure causes; the sigmas include it."
    )
    found = table(tables.OUTCOME_COLUMNS, rows, kind="words", worse=[row[6] == "structure" for row in rows])
    return section("Tests of the models", element("p", text), found) if rows else None


def _parameters(calibration: Calibration) -> Html:
    rows = [parameter.row() for parameter in tables.parameters(calibration)]
    return section("Parameters", table(("parameter", "value", "standard deviation"), rows, kind="wrap"))


def _quality(calibration: Calibration) -> Html | None:
    rows = tables.quality_rows(calibration)
    return section("Numbers of the solve", table(("", ""), rows)) if rows else None


def _uncertainty(calibration: Calibration) -> Html | None:
    """Depth uncertainty against depth, as a figure and a table."""
    lasers = calibration.quality.lasers()
    curves = []
    for laser in lasers:
        # Logarithmic axes need values above 0.
        pairs = [(at.depth_m, at.sigma_depth_mm) for at in laser.depths if min(at.depth_m, at.sigma_depth_mm) > 0]
        if pairs:
            depth, sigma = np.array(pairs, np.float64).T
            curves.append((laser.name, depth, sigma))
    if not curves or calibration.scanner is None:
        return None
    noise = _stripe_noise_mm(calibration, curves[0][0], curves[0][1])
    caption = (
        "The uncertainty of the depth that the calibration causes, as root mean square over the lit lines of the "
        "image. Neighbouring points share it, so it does not average out; the noise of a point's own stripe does."
    )
    rows = [
        (
            laser.name,
            f"{at.depth_m:g}",
            *map(words.millimetres, (at.sigma_depth_mm, at.sigma_range_mm, at.sigma_point_mm)),
        )
        for laser in lasers
        for at in laser.depths
    ]
    columns = ("laser", "depth, m", "depth", "distance from the camera", "points of a full turn")
    figure = plots.depth_against_distance(curves, noise)
    shown = drawn(figure, "depth", "Depth uncertainty against depth", caption)
    return section("Uncertainty against distance", beside(shown, table(columns, rows)))


def _stripe_noise_mm(calibration: Calibration, name: str, depths: np.ndarray) -> np.ndarray:
    """Sigma of a point's depth from the noise of its own stripe, in the middle of the stripe [mm]; 0 where unknown."""
    scanner, fit, observations = calibration.scanner, calibration.fit, calibration.observations
    noise = np.zeros(len(depths))
    if fit is None or observations is None or scanner is None or name not in scanner.laser_names:
        return noise
    if not plots.has_stripes(observations, fit):
        return noise
    laser = scanner.laser_names.index(name)
    sigma = fit.stripe_sigma[fit.stripe_inlier & (np.asarray(observations.stripes.laser) == laser)[:, None]]
    if not sigma.size:
        return noise
    half = 0.5 * np.eye(2)[1 - plots.stripe_direction(observations)]
    for index, depth in enumerate(depths):
        q = stripe_pixels(scanner, laser, float(depth))
        if len(q):
            middle = q[len(q) // 2]
            near, far = stripe_depths(scanner, laser, np.stack([middle - half, middle + half]))
            noise[index] = 1e3 * abs(far - near) * float(np.median(sigma))
    return noise


def _over_image(observations: Observations, fit: Fit) -> Html | None:
    """Coverage of the image by corners and stripes, and the directions of the residuals."""
    if not fit.corner_inlier.any():
        return None
    seen = "Corners (blue) and stripes (other colours)" if plots.has_stripes(observations, fit) else "Corners"
    coverage = drawn(
        plots.coverage_map(observations, fit),
        "coverage",
        "Corners and stripes over the image",
        element("b", "Coverage."),
        f" {seen} that were used. The lens is known only where there are board corners, so the edges of the image "
        "should be covered too.",
    )
    directions = drawn(
        plots.direction_map(observations, fit),
        "directions",
        "Direction of the corner residuals over the image",
        element("b", "Directions."),
        " The colour of each corner is the direction of its residual. Colours should be mixed everywhere: patches of "
        "one colour are errors of a model. Arrows show the mean of a cell if it is larger than noise (one cell in a "
        "hundred by chance).",
    )
    return section("Residuals over the image", beside(coverage, directions))


def _along_and_angle(calibration: Calibration, observations: Observations, fit: Fit) -> Html | None:
    """Residuals along the stripe and, where the table turns, against its angle."""
    striped, shown = plots.has_stripes(observations, fit), []
    if striped:
        caption = (
            " All points, and means of short pieces with two standard deviations. A curve means that the sheet is not "
            "flat or the lens model is too simple."
        )
        heading, figure = element("b", "Along the stripe."), plots.along_stripe(observations, fit)
        shown.append(drawn(figure, "along", "Stripe residuals along the image", heading, caption))
    turns = calibration.scanner is not None and isinstance(calibration.scanner.turntable, Turntable)
    if turns and plots.turned_views(observations).any():
        caption = (
            " The mean of each view of a board that stood still while the table turned. A curve means that the table "
            "turns unevenly or wobbles."
        )
        angles = [("corners", "Corner", plots.corners_against_angle, caption)]
        if striped:
            angles.insert(0, ("stripes", "Stripe", plots.stripes_against_angle, " The mean of each stripe."))
        for name, residual, plot, text in angles:
            heading = element("b", f"{name.capitalize()} against the table's angle.")
            said = f"{residual} residuals against the table's angle"
            shown.append(drawn(plot(observations, fit), f"angle-{name}", said, heading, text))
    return section("Stripe and table", beside(*shown)) if shown else None


def _distributions(fit: Fit) -> Html | None:
    """Whitened residuals compared with the Gaussian."""
    shown = []
    for name, whitened in plots.whitened_residuals(fit).items():
        far = 100 * float(np.mean(np.abs(whitened) > 3))
        count = (
            f" {len(whitened):,} residuals, standard deviation {np.std(whitened):.3f}; {far:.2f} % beyond 3 (Gaussian: "
            "0.27 %)."
        )
        line = " Gaussian residuals lie on the line; ends that bend away are outliers that were kept."
        title = name.capitalize()
        histogram, quantiles = plots.histogram(whitened), plots.quantiles(whitened)
        shown += [
            drawn(histogram, f"histogram-{name}", f"Histogram of {name}", element("b", f"{title}."), count),
            drawn(quantiles, f"quantiles-{name}", f"Quantiles of {name}", element("b", f"{title}, quantiles."), line),
        ]
    text = (
        "Residuals divided by their expected standard deviations. These are the noise, estimated from all residuals "
        "of the same group, less the part that the fit absorbs."
    )
    return section("Are the residuals noise?", element("p", text), beside(*shown)) if shown else None


def _views(calibration: Calibration, photographs: Mapping[int, bytes]) -> Html | None:
    """All views, worst first: a table, and the residual vectors of each with its photograph."""
    rows = tables.view_rows(calibration)
    if not rows:
        return None
    judged = judge_views(calibration.quality, calibration.fit, calibration.observations)
    panels = _drawn_views(calibration)
    numbers = {view.row for view in panels}
    bad = {str(view.record) for view in words.bad_views(calibration)}
    linked = [
        (element("a", row[0], href=f"#panel-{view.row}") if view.row in numbers else row[0], *row[1:])
        for row, view in zip(rows, judged, strict=True)
    ]
    parts = [table(tables.view_columns(calibration), linked, kind="tall", worse=[row[0] in bad for row in rows])]
    observations, fit = calibration.observations, calibration.fit
    if observations is not None and fit is not None:
        parts.append(_panels(panels, len(judged), observations, fit, photographs))
    return section("Views, worst first", *parts)


def drawn_records(calibration: Calibration) -> list[int]:
    """Records whose views are drawn, worst first; without records whose number several captures have."""
    records = [view.quality.record for view in _drawn_views(calibration)]
    every = [view.record for view in calibration.quality.per_view]
    return [record for record in records if every.count(record) == 1]


def _drawn_views(calibration: Calibration) -> list[JudgedView]:
    if calibration.observations is None or calibration.fit is None:
        return []
    judged = judge_views(calibration.quality, calibration.fit, calibration.observations)
    return [view for view in judged if view.row is not None][:MAX_PANELS]


def _linked(calibration: Calibration, record: int) -> Html:
    """The number of a record, which leads to its view where that is drawn."""
    rows = [view.row for view in _drawn_views(calibration) if view.quality.record == record]
    return element("a", str(record), href=f"#panel-{rows[0]}") if rows else element("span", str(record))


def _panels(
    views: Sequence[JudgedView], in_all: int, observations: Observations, fit: Fit, photographs: Mapping[int, bytes]
) -> Html:
    scale = plots.residual_scale(fit)

    def panel(view: JudgedView) -> Html:
        row, record, rejected = view.row or 0, view.quality.record, view.quality.corners_rejected
        parts = [
            as_svg(
                plots.view_residuals(observations, fit, row, scale),
                f"view-{row}",
                f"Corner residuals of record {record}",
            )
        ]
        if record in photographs:
            data = base64.b64encode(photographs[record]).decode()
            parts.append(element("img", src=f"data:image/jpeg;base64,{data}", alt=f"Photograph of record {record}"))
        size = f" {view.rms_px:.3f} px" + (f", {rejected} rejected" if rejected else "")
        return captioned(joined(parts), element("b", f"record {record}"), size, id=f"panel-{row}")

    bar = drawn(plots.scale_bar(scale, observations.width), "scale", f"An arrow of {scale:g} px", "scale of all arrows")
    more = [panel(view) for view in views[OPEN_PANELS:]]
    parts = [
        element(
            "p", "Each arrow leads from the detected corner to the predicted corner. Crosses are rejected corners."
        ),
        element("div", bar, *map(panel, views[:OPEN_PANELS]), class_="panels"),
    ]
    if more:
        left = in_all - len(views)
        title = f"{len(more)} more views" + (f"; {left} better ones are not drawn" if left > 0 else "")
        parts.append(element("details", element("summary", title), element("div", *more, class_="panels")))
    return joined(parts)


_SHAPES = {
    "parabola": "a bow along x and along y",
    "bent": "a bow and polynomial heights",
    "smooth": "polynomial heights, and a print that is out of place by polynomials",
    "corners": "a height and a place of its own for every corner",
}


def _board(calibration: Calibration) -> Html | None:
    """The shape of the calibration board."""
    found, observations = calibration.quality.board, calibration.observations
    if found is None or observations is None or not any(found.height_m):
        return None
    corners = observations.board.corners()
    if not len(found.height_m) == len(found.shift_m) == len(found.height_sigma_m) == len(corners):
        return None
    sigma = 1e3 * float(np.sqrt(np.mean(np.square(found.height_sigma_m))))
    text = (
        f"The board is {words.millimetres(1e3 * found.rms_off_flat_m)} off its best plane (root mean square over the "
        f"corners; standard deviation of one corner {words.millimetres(sigma)}). "
        f"Its shape in the solve: {_SHAPES.get(found.free, '')}."
    )
    before, after = found.held_out_rms_parabola_px, found.held_out_rms_px
    if found.free != "parabola" and before is not None and after is not None:
        text += (
            f" With it, the corners of views that had no part in the solve are {after:.3f} px off; with a bow alone "
            f"they are {before:.3f} px off."
        )
    arrows = " Arrows lead from where a corner should be printed to where it is, enlarged."
    shown = drawn(
        plots.board_map(found, corners, observations.board.square),
        "board",
        "Map of the board's heights and of the places of its corners",
        "Heights of the corners over the best plane; colours are full at three standard deviations or more."
        f"{arrows if np.any(found.shift_m) else ''}",
    )
    return section("Shape of the board", element("p", text), beside(shown))


def _correlations(calibration: Calibration) -> Html | None:
    if not (np.diag(calibration.covariance) > 0).any():
        return None
    caption = (
        "Correlations of the estimated parameters, with numbers above one half. Strong correlations are not a fault: "
        "only a combination of the parameters is known well, and the lengths above take that into account."
    )
    figure = plots.correlations(calibration.order, calibration.covariance)
    title = "Correlation matrix of the shared parameters"
    return section("Correlations", drawn(figure, "correlations", title, caption, class_="wide"))


def _spectrum(calibration: Calibration) -> Html | None:
    """Combinations of parameters that the data determine badly."""
    directions = sorted(calibration.quality.spectrum, key=lambda row: -row.sigma_over_prior)
    if not directions:
        return None
    weak = [
        f"{plots.combination(row.direction)} ({100 * row.sigma_over_prior:.0f} % of the prior's standard deviation)"
        for row in directions
        if is_held_by_priors(row.sigma_over_prior)
    ]
    text = (
        f"Held by priors rather than by these data: {'; '.join(weak)}."
        if weak
        else "Every combination of parameters is held by the data."
    )
    shown = drawn(
        plots.spectrum(directions),
        "spectrum",
        "Standard deviation of every combination of parameters over its prior",
        "Independent combinations of parameters, named by their largest components. At 1 the data add nothing.",
    )
    return section("Combinations that the data do not determine", element("p", text), beside(shown))
