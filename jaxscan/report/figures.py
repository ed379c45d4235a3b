"""The sections of a calibration report that have figures. Each is None if there is nothing to draw."""

from typing import TYPE_CHECKING, Any

import numpy as np

from jaxscan.calibration import Calibration, Fit, is_held_by_priors, stripe_depths, stripe_pixels
from jaxscan.geometry import LinearStage, Scanner, Turntable
from jaxscan.observation import Observations
from jaxscan.report import plots, words
from jaxscan.report.drawing import BLUE, INK, SERIES, SOFT, as_svg, new_figure, plain
from jaxscan.report.html import Html, element, section, table
from jaxscan.report.plots import board_map


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
    figure = plots.depth_against_distance(curves, noise)
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
    if not plots.has_stripes(observations, fit):
        return noise
    laser = scanner.laser_names.index(name)
    sigma = fit.stripe_sigma[fit.stripe_inlier & (np.asarray(observations.stripes.laser) == laser)[:, None]]
    if not sigma.size:
        return noise
    across = 1 - plots.stripe_direction(observations)
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
    if not fit.corner_inlier.any():
        return None
    striped = plots.has_stripes(observations, fit)
    seen = "Corners (blue) and stripes (other colours)" if striped else "Corners"
    figures = [
        _figure(
            plots.coverage_map(observations, fit),
            "coverage",
            "Corners and stripes over the image",
            f"<b>Coverage.</b> {seen} that were used. The lens is known only where there are board corners, so the "
            "edges of the image should be covered too.",
        ),
        _figure(
            plots.direction_map(observations, fit),
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
    striped = plots.has_stripes(observations, fit)
    if striped:
        figures.append(
            _figure(
                plots.along_stripe(observations, fit),
                "along",
                "Stripe residuals along the image",
                "<b>Along the stripe.</b> All points, and means of short pieces with two standard deviations. "
                "A curve means that the sheet is not flat or the lens model is too simple.",
            )
        )
    if turns and plots.turned_views(observations).any():
        if striped:
            figures.append(
                _figure(
                    plots.stripes_against_angle(observations, fit),
                    "angle-stripes",
                    "Stripe residuals against the table's angle",
                    "<b>Stripes against the table's angle.</b> The mean of each stripe.",
                )
            )
        figures.append(
            _figure(
                plots.corners_against_angle(observations, fit),
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
    for name, whitened in plots.whitened_residuals(fit).items():
        far = float(np.mean(np.abs(whitened) > 3))
        caption = (
            f"<b>{name.capitalize()}.</b> {len(whitened):,} residuals, standard deviation {np.std(whitened):.3f}; "
            f"{100 * far:.2f} % beyond 3 (Gaussian: 0.27 %)."
        )
        figures += [
            _figure(plots.histogram(whitened), f"histogram-{name}", f"Histogram of {name}", caption),
            _figure(
                plots.quantiles(whitened),
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
    figure = plots.correlations(calibration.order, calibration.covariance)
    drawn = _figure(figure, "correlations", "Correlation matrix of the shared parameters", caption, class_="wide")
    return section("Correlations", drawn)


def spectrum(calibration: Calibration) -> Html | None:
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
    drawn = _figure(
        plots.spectrum(directions),
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


_UP = {"-v": (0.0, -1.0, 0.0), "+v": (0.0, 1.0, 0.0), "+u": (1.0, 0.0, 0.0), "-u": (-1.0, 0.0, 0.0)}
_ASIDE, _ABOVE = np.radians(np.arange(-80.0, 81.0, 10.0)), np.radians(24.0)
"""From where the rig may be looked at: so far round from behind, so far up."""
_STEPS_M = tuple(step * 10.0**power for power in range(-4, 4) for step in (1, 2, 5))


def rig(calibration: Calibration) -> Html | None:
    """The drawing of the rig, with the angles between its parts."""
    scanner = calibration.scanner
    if scanner is None or not (scanner.laser_names or isinstance(scanner.turntable, Turntable)):
        return None
    lengths = rig_lengths(scanner)
    if not all(np.isfinite(value) and value < 1e4 for _, value in lengths):
        return None
    ahead = np.array([0.0, 0.0, 1.0])
    slopes = [min(abs(float(_normal(scanner, k) @ ahead)), 1.0) for k in range(len(scanner.laser_names))]
    rows = [(name, f"{1e3 * value:.1f} mm") for name, value in lengths]
    rows += [
        (f"sheet {name} to the camera's line of sight", f"{np.degrees(np.arcsin(slope)):.2f}°")
        for name, slope in zip(scanner.laser_names, slopes, strict=True)
    ]
    note = "Where a laser itself is, the calibration does not say: it is somewhere on its sheet."
    drawn = element(
        "figure",
        as_svg(rig_figure(scanner), "rig", "The rig in three dimensions"),
        element("figcaption", element("b", "To scale. "), note),
    )
    listed = element("div", table(("shortest distances, and angles", ""), rows, kind="wrap"))
    return section("The rig", element("div", drawn, listed, class_="figures"))


def rig_lengths(scanner: Scanner) -> list[tuple[str, float]]:
    """The distances of the camera's centre from the axis and from the sheets, with their names [m]."""
    table = scanner.turntable
    found = []
    if isinstance(table, Turntable):
        found.append(("camera to axis", float(np.linalg.norm(_axis_foot(table)))))
    return found + [
        (f"camera to sheet {name}", abs(float(scanner.laser(k).distance))) for k, name in enumerate(scanner.laser_names)
    ]


def rig_figure(scanner: Scanner) -> "Figure":
    """Camera, sheets and axis in one scale, seen from aside, behind and above."""
    up, ahead, right = _directions(scanner)
    size = max([value for _, value in rig_lengths(scanner)] + [0.02])
    feet = [_sheet_foot(scanner, k) for k in range(len(scanner.laser_names))]
    feet += [_axis_foot(scanner.turntable)] if isinstance(scanner.turntable, Turntable) else []
    canvas = _Canvas(up, ahead, right, np.array(feet))
    for number in range(len(scanner.laser_names)):
        _draw_sheet(canvas, scanner, number, size)
    if isinstance(scanner.turntable, Turntable):
        _draw_axis(canvas, scanner.turntable, size)
    elif isinstance(scanner.turntable, LinearStage):
        way = np.asarray(scanner.turntable.direction, np.float64)
        canvas.arrow(np.zeros(3), 0.9 * size * way, INK)
        canvas.words(1.0 * size * way, "travel", INK)
    _draw_camera(canvas, scanner, size)
    away = feet[0] / max(float(np.linalg.norm(feet[0])), 1e-9)
    canvas.words(-0.2 * size * away - 0.12 * size * up, "camera", INK)
    return canvas.finished(size)


def _normal(scanner: Scanner, number: int) -> np.ndarray:
    return np.asarray(scanner.laser(number).normal, np.float64)


def _sheet_foot(scanner: Scanner, number: int) -> np.ndarray:
    """The point of a sheet nearest the camera's centre [3], m."""
    return float(scanner.laser(number).distance) * _normal(scanner, number)


def _axis_foot(table: Turntable) -> np.ndarray:
    """The point of the axis nearest the camera's centre [3], m."""
    direction, point = (np.asarray(part, np.float64) for part in (table.direction, table.point))
    direction = direction / np.linalg.norm(direction)
    return point - (point @ direction) * direction


def _directions(scanner: Scanner) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    up = np.array(_UP[scanner.up])
    if isinstance(scanner.turntable, Turntable):
        up = np.asarray(scanner.turntable.direction, np.float64)
    up = up / np.linalg.norm(up)
    ahead = np.array([0.0, 0.0, 1.0])
    # A camera that looks along the axis has no horizontal direction ahead.
    ahead = np.array([1.0, 0.0, 0.0]) if abs(ahead @ up) > 0.99 else ahead
    ahead = ahead - (ahead @ up) * up
    ahead = ahead / np.linalg.norm(ahead)
    return up, ahead, np.cross(ahead, up)


class _Canvas:
    """Draws places of the camera frame [m] as millimetres of a picture."""

    def __init__(self, up: np.ndarray, ahead: np.ndarray, right: np.ndarray, lengths: np.ndarray) -> None:
        """
        Args:
            up: Unit vector [3].
            ahead: Horizontal unit vector of the camera's line of sight [3].
            right: Across both [3].
            lengths: Vectors [n, 3] that are to be seen: none of them from its end.
        """

        def onto(aside: float) -> np.ndarray:
            level = np.cos(aside) * right + np.sin(aside) * ahead
            away = -np.sin(aside) * right + np.cos(aside) * ahead
            return np.stack([level, np.cos(_ABOVE) * up + np.sin(_ABOVE) * away])

        def seen(aside: float) -> float:
            shares = np.linalg.norm(lengths @ onto(aside).T, axis=1) / np.maximum(np.linalg.norm(lengths, axis=1), 1e-9)
            # Ahead should not point at the eye either.
            return float(min([*shares, 1.3 * abs(onto(aside)[0] @ ahead)]))

        self.to_picture = 1e3 * onto(max(_ASIDE.tolist(), key=seen))
        self.up, self.ahead = up, ahead
        self.figure = new_figure(5.4, 3.9, fitted=False)
        self.axes: Any = self.figure.add_axes((0.02, 0.02, 0.96, 0.96))
        self.axes.set_axis_off()
        self.axes.set_aspect("equal", adjustable="datalim")

    def at(self, places: np.ndarray) -> np.ndarray:
        return np.asarray(places, np.float64) @ self.to_picture.T

    def line(self, places: np.ndarray, colour: str, *, width: float = 1.4, style: str = "-") -> None:
        self.axes.plot(*self.at(places).T, style, color=colour, linewidth=width)

    def area(self, places: np.ndarray, colour: str, alpha: float) -> None:
        self.axes.fill(*self.at(places).T, facecolor=colour, alpha=alpha, edgecolor=colour, linewidth=1.0)

    def arrow(self, start: np.ndarray, end: np.ndarray, colour: str) -> None:
        look = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.4}
        self.axes.annotate("", tuple(self.at(end)), tuple(self.at(start)), arrowprops=look)

    def words(self, place: np.ndarray, text: str, colour: str, **how: Any) -> None:
        halo = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0}
        style = {"ha": "center", "va": "center", "fontsize": 9, "bbox": halo} | how
        self.axes.text(*self.at(place), text, color=colour, parse_math=False, **style)

    def finished(self, size: float) -> "Figure":
        """With a scale."""
        length = max(step for step in _STEPS_M if step <= 0.5 * size or step == _STEPS_M[0])
        low, high = np.array(self.axes.get_xlim()), np.array(self.axes.get_ylim())
        y, x = high[0] - 0.04 * np.ptp(high), low[0]
        for part in range(2):
            ends = x + 1e3 * length * 0.5 * np.array([part, part + 1])
            filled = INK if part == 0 else "white"
            self.axes.fill_between(ends, y, y + 0.02 * np.ptp(high), facecolor=filled, edgecolor=INK, linewidth=0.8)
        self.axes.text(x + 1.06e3 * length, y + 0.01 * np.ptp(high), f"{1e3 * length:g} mm", va="center", color=INK)
        return self.figure


def _draw_sheet(canvas: _Canvas, scanner: Scanner, number: int, size: float) -> None:
    normal, foot = _normal(scanner, number), _sheet_foot(scanner, number)
    colour = SERIES[(1 + number) % len(SERIES)]
    along = canvas.ahead - (canvas.ahead @ normal) * normal
    along = canvas.up if np.linalg.norm(along) < 1e-6 else along / np.linalg.norm(along)
    across = np.cross(normal, along)
    # A fan that widens ahead, as from a line laser near the foot.
    fan = [foot - 0.12 * size * across, foot + 0.12 * size * across]
    fan += [foot + 1.7 * size * along + side * 0.6 * size * across for side in (1.0, -1.0)]
    canvas.area(np.array(fan), colour, 0.22)
    name = plain(scanner.laser_names[number], 18)
    canvas.line(np.array([np.zeros(3), foot]), colour, style="--")
    canvas.words(0.55 * foot, f"{1e3 * np.linalg.norm(foot):.1f} mm", colour)
    canvas.words(foot + 1.25 * size * along, f"sheet {name}", colour)


def _draw_axis(canvas: _Canvas, table: Turntable, size: float) -> None:
    foot = _axis_foot(table)
    direction = np.asarray(table.direction, np.float64)
    turns = np.linspace(0.3, 2.0 * np.pi - 0.3, 60)
    side = np.cross(direction, canvas.ahead)
    ahead = np.cross(side, direction)
    ring = (
        foot - 0.75 * size * direction + 0.22 * size * (np.outer(np.cos(turns), side) + np.outer(np.sin(turns), ahead))
    )
    canvas.line(np.array([foot - 0.9 * size * direction, foot + 0.75 * size * direction]), BLUE, style="-.", width=1.6)
    canvas.line(ring, BLUE)
    canvas.arrow(ring[-2], ring[-1], BLUE)
    canvas.words(foot + 0.85 * size * direction, "axis", BLUE)
    canvas.line(np.array([np.zeros(3), foot]), SOFT, style="--")
    canvas.words(0.5 * foot - 0.08 * size * canvas.up, f"{1e3 * np.linalg.norm(foot):.1f} mm", SOFT)


def _draw_camera(canvas: _Canvas, scanner: Scanner, size: float) -> None:
    camera = scanner.camera
    corners = np.array([[0, 0], [camera.width - 1, 0], [camera.width - 1, camera.height - 1], [0, camera.height - 1]])
    rays = np.asarray(camera.unproject(corners.astype(np.float64)))
    ends = 0.55 * size * rays
    if np.isfinite(ends).all():
        for end in ends:
            canvas.line(np.array([np.zeros(3), end]), INK, width=1.0)
        canvas.area(ends, INK, 0.06)
    canvas.axes.plot(*canvas.at(np.zeros(3)), "o", color=INK, markersize=6)
