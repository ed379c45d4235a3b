"""The sections of a calibration report that have figures. Each is None if there is nothing to draw."""

from typing import TYPE_CHECKING

import numpy as np

from jaxscan.calibration import Calibration, Fit, is_held_by_priors, stripe_depths, stripe_pixels
from jaxscan.observation import Observations
from jaxscan.report import image_plots, residual_plots, uncertainty_plots, words
from jaxscan.report.board_plots import board_map
from jaxscan.report.drawing import as_svg
from jaxscan.report.html import Html, element, section, table


if TYPE_CHECKING:
    from matplotlib.figure import Figure


def uncertainty(calibration: Calibration) -> Html | None:
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
    figure = uncertainty_plots.depth_against_distance(curves, noise)
    caption = (
        "The uncertainty of the depth that the calibration causes, as root mean square over the lit lines of the "
        "image. Neighbouring points share it, so it does not average out; the noise of a point's own stripe does."
    )
    rows = [
        (
            laser.name,
            f"{at.depth_m:g}",
            *(words.millimetres(sigma) for sigma in (at.sigma_depth_mm, at.sigma_range_mm, at.sigma_point_mm)),
        )
        for laser in lasers
        for at in laser.depths
    ]
    columns = ("laser", "depth, m", "depth", "distance from the camera", "points of a full turn")
    drawn = _figure(figure, "depth", "Depth uncertainty against depth", caption)
    return section(
        "Uncertainty against distance", element("div", drawn, element("div", table(columns, rows)), class_="figures")
    )


def _stripe_noise_mm(calibration: Calibration, name: str, depths: np.ndarray) -> np.ndarray:
    """Sigma of a point's depth from the noise of its own stripe, in the middle of the stripe [mm]; 0 where unknown."""
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
    half = 0.5 * np.eye(2)[across]
    for index, depth in enumerate(depths):
        q = stripe_pixels(scanner, laser, float(depth))
        if len(q):
            middle = q[len(q) // 2]
            near, far = stripe_depths(scanner, laser, np.stack([middle - half, middle + half]))
            noise[index] = 1e3 * abs(far - near) * float(np.median(sigma))
    return noise


def residuals_over_image(observations: Observations, fit: Fit) -> Html | None:
    """Coverage of the image by corners and stripes, and the directions of the residuals."""
    if not fit.corner_kept.any():
        return None
    striped = residual_plots.has_stripes(observations, fit)
    seen = "Corners (blue) and stripes (other colours)" if striped else "Corners"
    figures = [
        _figure(
            image_plots.coverage_map(observations, fit),
            "coverage",
            "Corners and stripes over the image",
            f"<b>Coverage.</b> {seen} that were used. The lens is known only where there are board corners, so the "
            "edges of the image should be covered too.",
        ),
        _figure(
            image_plots.direction_map(observations, fit),
            "directions",
            "Direction of the corner residuals over the image",
            "<b>Directions.</b> The colour of each corner is the direction of its residual. Colours should be mixed "
            "everywhere: patches of one colour are errors of a model. Arrows show the mean of a cell if it is larger "
            "than noise (one cell in a hundred by chance).",
        ),
    ]
    return section("Residuals over the image", element("div", *figures, class_="figures"))


def along_stripe_and_angle(observations: Observations, fit: Fit, *, turns: bool) -> Html | None:
    """Residuals along the stripe and, where the table turns, against its angle."""
    figures = []
    striped = residual_plots.has_stripes(observations, fit)
    if striped:
        figures.append(
            _figure(
                residual_plots.along_stripe(observations, fit),
                "along",
                "Stripe residuals along the image",
                "<b>Along the stripe.</b> All points, and means of short pieces with two standard deviations. "
                "A curve means that the sheet is not flat or the lens model is too simple.",
            )
        )
    if turns and residual_plots.turned_views(observations).any():
        if striped:
            figures.append(
                _figure(
                    residual_plots.stripes_against_angle(observations, fit),
                    "angle-stripes",
                    "Stripe residuals against the table's angle",
                    "<b>Stripes against the table's angle.</b> The mean of each stripe.",
                )
            )
        figures.append(
            _figure(
                residual_plots.corners_against_angle(observations, fit),
                "angle-corners",
                "Corner residuals against the table's angle",
                "<b>Corners against the table's angle.</b> The mean of each view of a board that stood still while the "
                "table turned. A curve means that the table turns unevenly or wobbles.",
            )
        )
    return section("Stripe and table", element("div", *figures, class_="figures")) if figures else None


def distributions(fit: Fit) -> Html | None:
    """Whitened residuals compared with the Gaussian."""
    figures = []
    for name, whitened in residual_plots.whitened_residuals(fit).items():
        far = float(np.mean(np.abs(whitened) > 3))
        caption = (
            f"<b>{name.capitalize()}.</b> {len(whitened):,} residuals, standard deviation {np.std(whitened):.3f}; "
            f"{100 * far:.2f} % beyond 3 (Gaussian: 0.27 %)."
        )
        figures += [
            _figure(residual_plots.histogram(whitened), f"histogram-{name}", f"Histogram of {name}", caption),
            _figure(
                residual_plots.quantiles(whitened),
                f"quantiles-{name}",
                f"Quantiles of {name}",
                f"<b>{name.capitalize()}, quantiles.</b> Gaussian residuals lie on the line; ends that bend away "
                "are outliers that were kept.",
            ),
        ]
    if not figures:
        return None
    text = (
        "Residuals divided by their expected standard deviations. These are the noise, estimated from all residuals "
        "of the same group, less the part that the fit absorbs."
    )
    return section("Are the residuals noise?", element("p", text), element("div", *figures, class_="figures"))


_SHAPES = {
    "parabola": "a bow along x and along y",
    "bent": "a bow and polynomial heights",
    "smooth": "polynomial heights, and a print that is out of place by polynomials",
    "corners": "a height and a place of its own for every corner",
}


def board(calibration: Calibration) -> Html | None:
    """The shape of the calibration board."""
    found, observations = calibration.quality.board, calibration.observations
    if found is None or observations is None or not any(found.height_m):
        return None
    corners = observations.board.corners()
    if not len(found.height_m) == len(found.shift_m) == len(found.height_sigma_m) == len(corners):
        return None
    sigma = 1e3 * float(np.sqrt(np.mean(np.square(found.height_sigma_m))))
    lines = [
        f"The board is {words.millimetres(1e3 * found.rms_off_flat_m)} off its best plane (root mean square over the "
        f"corners; standard deviation of one corner {words.millimetres(sigma)}). "
        f"Its shape in the solve: {_SHAPES.get(found.free, '')}."
    ]
    before, after = found.held_out_rms_parabola_px, found.held_out_rms_px
    if found.free != "parabola" and before is not None and after is not None:
        lines.append(
            f"With it, the corners of views that had no part in the solve are {after:.3f} px off; with a bow alone "
            f"they are {before:.3f} px off."
        )
    arrows = " Arrows lead from where a corner should be printed to where it is, enlarged."
    drawn = _figure(
        board_map(found, corners, observations.board.square),
        "board",
        "Map of the board's heights and of the places of its corners",
        "Heights of the corners over the best plane; colours are full at three standard deviations or more."
        f"{arrows if np.any(found.shift_m) else ''}",
    )
    return section("Shape of the board", element("p", " ".join(lines)), element("div", drawn, class_="figures"))


def correlations(calibration: Calibration) -> Html | None:
    """Correlations of the parameters."""
    if not (np.diag(calibration.covariance) > 0).any():
        return None
    caption = (
        "Correlations of the estimated parameters, with numbers above one half. Strong correlations are not a fault: "
        "only a combination of the parameters is known well, and the lengths above take that into account."
    )
    figure = uncertainty_plots.correlations(calibration.order, calibration.covariance)
    drawn = _figure(figure, "correlations", "Correlation matrix of the shared parameters", caption, class_="wide")
    return section("Correlations", drawn)


def spectrum(calibration: Calibration) -> Html | None:
    """Combinations of parameters that the data determine badly."""
    directions = sorted(calibration.quality.spectrum, key=lambda row: -row.sigma_over_prior)
    if not directions:
        return None
    weak = [
        f"{uncertainty_plots.combination(row.direction)} ({100 * row.sigma_over_prior:.0f} % of the prior's standard "
        "deviation)"
        for row in directions
        if is_held_by_priors(row.sigma_over_prior)
    ]
    text = (
        f"Held by priors rather than by these data: {'; '.join(weak)}."
        if weak
        else "Every combination of parameters is held by the data."
    )
    drawn = _figure(
        uncertainty_plots.spectrum(directions),
        "spectrum",
        "Standard deviation of every combination of parameters over its prior",
        "Independent combinations of parameters, named by their largest components. At 1 the data add nothing.",
    )
    return section(
        "Combinations that the data do not determine", element("p", text), element("div", drawn, class_="figures")
    )


def _figure(figure: "Figure", name: str, description: str, caption: str, **attributes: str) -> Html:
    """A figure with its caption. The caption is markup of this module, and is not escaped."""
    drawn = as_svg(figure, name, description)
    return element("figure", drawn, element("figcaption", Html(caption)), **attributes)
