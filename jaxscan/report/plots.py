"""Plots of a calibration: residuals, views, uncertainty and board."""

from collections.abc import Sequence
from statistics import NormalDist
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxscan.calibration import BoardMap, Direction, Fit, is_held_by_priors
from jaxscan.observation import Observations
from jaxscan.report.drawing import (
    BLUE,
    INK,
    LINE,
    RED,
    ROUND,
    SERIES,
    SOFT,
    add_bar,
    add_legend,
    arrows,
    new_axes,
    new_figure,
    new_plot,
    no_frame,
    plain,
    round_up,
)


if TYPE_CHECKING:
    from matplotlib.figure import Figure


_BINS = 28
_LIMIT = 5.0
_QUANTILES = 400


def along_stripe(observations: Observations, fit: Fit) -> "Figure":
    """Stripe residuals along the stripe, with the means of short pieces."""
    axis = stripe_direction(observations)
    figure, axes = new_plot(xlabel=f"image {'row' if axis else 'column'}, px", ylabel="stripe residual, px")
    for laser, mine in _by_laser(observations):
        kept = fit.stripe_inlier[mine]
        along, error = np.asarray(observations.stripes.q)[mine][kept][:, axis], fit.stripe_error[mine][kept]
        if not error.size:
            continue
        colour = SERIES[(1 + laser) % len(SERIES)]
        axes.plot(along, error, ".", color=colour, alpha=0.5, markersize=1.6, markeredgewidth=0, rasterized=True)
        middle, mean, noise = binned(along, error)
        _means(axes, middle, mean, noise, INK if laser == 0 else colour, plain(observations.laser_names[laser]))
    axes.axhline(0, color=SOFT, linewidth=0.7)
    _bounded(axes, fit.stripe_error[fit.stripe_inlier])
    if len(observations.laser_names) > 1:
        add_legend(axes)
    return figure


def stripes_against_angle(observations: Observations, fit: Fit) -> "Figure":
    """Mean stripe residual of every view against the table's angle."""
    figure, axes = new_plot(xlabel="table angle, degrees", ylabel="mean stripe residual of a view, px")
    view = np.asarray(observations.stripes.view)
    turned = turned_views(observations)[view]
    angle = np.degrees(np.asarray(observations.corners.angle))[view]
    placement = np.asarray(observations.corners.placement)[view]
    for laser, mine in _by_laser(observations):
        kept = fit.stripe_inlier[mine]
        count = kept.sum(1)
        some = (count > 1) & turned[mine]
        if not some.any():
            continue
        error = np.where(kept, fit.stripe_error[mine], 0.0)[some]
        mean = error.sum(1) / count[some]
        # The bars assume independent points. Points that share errors scatter more, which the figure shows.
        spread = np.sqrt(np.where(kept[some], (error - mean[:, None]) ** 2, 0.0).sum(1) / (count[some] - 1))
        place = _beside(angle[mine][some], placement[mine][some])
        colour, name = SERIES[laser % len(SERIES)], plain(observations.laser_names[laser])
        _means(axes, place, mean, spread / np.sqrt(count[some]), colour, name)
    axes.axhline(0, color=SOFT, linewidth=0.7)
    if len(observations.laser_names) > 1:
        add_legend(axes)
    return figure


def corners_against_angle(observations: Observations, fit: Fit) -> "Figure":
    """Mean corner residual of every view of a placement against the table's angle. A curve means that the table
    turns unevenly or wobbles."""
    figure, axes = new_plot(xlabel="table angle, degrees", ylabel="mean corner residual of a view, px")
    views = turned_views(observations) & fit.corner_inlier.any(1)
    angle = np.degrees(np.asarray(observations.corners.angle))
    place = np.asarray(observations.corners.placement)[views]
    for direction, label, colour in ((0, "to the right", BLUE), (1, "down", RED)):
        kept = fit.corner_inlier[views]
        count = np.maximum(kept.sum(1), 1)
        mean = np.where(kept, fit.corner_error[views][..., direction], 0.0).sum(1) / count
        noise = np.sqrt(np.where(kept, fit.corner_sigma[views] ** 2, 0.0).sum(1)) / count
        _means(axes, _beside(angle[views], 2 * place + direction), mean, noise, colour, label)
    axes.axhline(0, color=SOFT, linewidth=0.7)
    add_legend(axes)
    return figure


def histogram(whitened: np.ndarray) -> "Figure":
    """Histogram of the whitened residuals, with the unit Gaussian."""
    figure, axes = new_plot(5.4, 2.9, xlabel="residual / its standard deviation", ylabel="density")
    axes.hist(whitened, bins=np.arange(-_LIMIT, _LIMIT + 0.1, 0.2), density=True, color=BLUE, alpha=0.55, linewidth=0)
    x = np.linspace(-_LIMIT, _LIMIT, 201)
    axes.plot(x, np.exp(-0.5 * x**2) / np.sqrt(2 * np.pi), color=INK, linewidth=1.4, label="unit Gaussian")
    axes.set_xlim(-_LIMIT, _LIMIT)
    add_legend(axes)
    return figure


def quantiles(whitened: np.ndarray) -> "Figure":
    """Quantiles of the whitened residuals against quantiles of the unit Gaussian."""
    figure, axes = new_plot(5.4, 2.9, xlabel="quantile of the unit Gaussian", ylabel="quantile of the residuals")
    count = min(len(whitened), _QUANTILES)
    level = (np.arange(count) + 0.5) / count
    expected = np.array([NormalDist().inv_cdf(value) for value in level])
    axes.plot([-4, 4], [-4, 4], color=SOFT, linewidth=0.8)
    axes.plot(expected, np.quantile(whitened, level), ".", color=BLUE, markersize=3.5, markeredgewidth=0)
    axes.set_xlim(-3.6, 3.6)
    axes.set_ylim(-_LIMIT, _LIMIT)
    return figure


def whitened_residuals(fit: Fit) -> dict[str, np.ndarray]:
    """Kept residuals over their expected standard deviations, by group. Empty groups are left out."""

    def group(error: np.ndarray, sigma: np.ndarray, leverage: np.ndarray) -> np.ndarray:
        # The fit absorbs a part of each residual. Residuals that it absorbs almost wholly are left out.
        free = leverage < 0.99
        return (error / (sigma * np.sqrt(np.clip(1.0 - leverage, 0.01, 1.0))))[free]

    kept, sigma = fit.corner_inlier, fit.corner_sigma[..., None]
    seen = fit.stripe_inlier
    groups = {
        "corners": group(fit.corner_error[kept], sigma[kept], fit.corner_leverage[kept]),
        "stripes": group(fit.stripe_error[seen], fit.stripe_sigma[seen], fit.stripe_leverage[seen]),
    }
    return {name: values for name, values in groups.items() if values.size}


def has_stripes(observations: Observations, fit: Fit) -> bool:
    """Whether any stripe was used. A calibration of the camera alone ignores stripes."""
    return fit.stripe_inlier.shape == np.shape(observations.stripes.valid) and bool(fit.stripe_inlier.any())


def stripe_direction(observations: Observations) -> int:
    """The image axis along which stripes run: 1 with a centre per row, 0 with a centre per column."""
    valid = np.asarray(observations.stripes.valid)
    spread = np.zeros(2)
    for q, seen in zip(np.asarray(observations.stripes.q), valid, strict=True):
        if seen.any():
            spread += np.ptp(q[seen], axis=0)
    return int(spread[1] >= spread[0])


def turned_views(observations: Observations) -> np.ndarray:
    """Whether the placement of a view was seen at more than one table angle [views]."""
    placement, angle = np.asarray(observations.corners.placement), np.asarray(observations.corners.angle)
    return np.array([np.ptp(angle[placement == number]) > 0 for number in placement], bool)


def binned(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Means of y in bins of x of equal width: centres of the bins, means, standard deviations of the means."""
    edges = np.linspace(x.min(), x.max() + 1e-9, _BINS + 1)
    piece = np.clip(np.digitize(x, edges) - 1, 0, _BINS - 1)
    count = np.bincount(piece, minlength=_BINS)
    mean = np.bincount(piece, y, _BINS) / np.maximum(count, 1)
    square = np.bincount(piece, y**2, _BINS) / np.maximum(count, 1)
    noise = np.sqrt(np.maximum(square - mean**2, 0.0) / np.maximum(count - 1, 1))
    used = count >= 8
    return (0.5 * (edges[1:] + edges[:-1]))[used], mean[used], noise[used]


def _by_laser(observations: Observations) -> list[tuple[int, np.ndarray]]:
    laser = np.asarray(observations.stripes.laser)
    return [(index, laser == index) for index in range(len(observations.laser_names))]


def _means(axes: Any, x: np.ndarray, mean: np.ndarray, noise: np.ndarray, colour: str, label: str) -> None:
    """Draw means with error bars of two standard deviations."""
    style = {"fmt": "o", "markersize": 3.4, "markeredgewidth": 0, "elinewidth": 0.8}
    axes.errorbar(x, mean, yerr=2 * noise, color=colour, ecolor=(colour, 0.45), label=label, **style)


def _beside(x: np.ndarray, number: np.ndarray) -> np.ndarray:
    """x with a small offset by number, so that marks at the same place stand side by side."""
    places = np.unique(x)
    room = float(np.diff(places).min()) if len(places) > 1 else 1.0
    _, rank = np.unique(number, return_inverse=True)
    rank = rank.reshape(-1)
    return x + 0.5 * room * (rank / max(rank.max(initial=0), 1) - 0.5)


def _bounded(axes: Any, values: np.ndarray) -> None:
    if values.size:
        reach = 4.5 * float(np.std(values)) or 1.0
        axes.set_ylim(-reach, reach)


ARROW_SHARE = 0.075
"""Length of the arrow of a residual as large as the scale, as a share of the image's width."""
_CELLS_ACROSS = 12


def residual_scale(fit: Fit) -> float:
    """A round length [px] that scales all arrows of a report: about the 90 % quantile of the kept residuals."""
    length = np.linalg.norm(fit.corner_error, axis=-1)[fit.corner_inlier]
    usual = float(np.percentile(length, 90)) if length.size else 0.0
    return round_up(usual) if usual > 0 else 1.0


def view_residuals(observations: Observations, fit: Fit, view: int, scale: float) -> "Figure":
    """The residuals of the corners of one view; rejected corners are crosses."""
    figure = new_figure(2.15, 2.15 * observations.height / observations.width, fitted=False)
    axes = _image_axes(figure, observations, bare=True)
    axes.set_position((0.01, 0.01, 0.98, 0.98))
    q, error = np.asarray(observations.corners.q)[view], fit.corner_error[view]
    kept = fit.corner_inlier[view]
    rejected = np.asarray(observations.corners.valid)[view] & ~kept
    long = ARROW_SHARE * observations.width / scale
    _draw(axes, arrows(q[kept], long * error[kept]), BLUE, 0.8)
    axes.plot(*q[rejected].T, "x", color=RED, markersize=4, markeredgewidth=1)
    return figure


def scale_bar(scale: float, image_width: int) -> "Figure":
    """An arrow as long as the scale, drawn as in `view_residuals`."""
    figure = new_figure(2.15, 0.32, fitted=False)
    axes = figure.add_axes((0.01, 0, 0.98, 1))
    axes.set_axis_off()
    axes.set_xlim(0, image_width)
    axes.set_ylim(0, image_width * 0.32 / 2.15)
    middle = 0.5 * axes.get_ylim()[1]
    length = ARROW_SHARE * image_width
    _draw(axes, arrows(np.array([[0.05 * image_width, middle]]), np.array([[length, 0.0]])), BLUE, 1.2)
    axes.text(0.05 * image_width + 1.3 * length, middle, f"{scale:g} px", va="center", color=INK)
    return figure


def direction_map(observations: Observations, fit: Fit) -> "Figure":
    """Corners coloured by the direction of their residual, and the mean of each cell where it is significant."""
    figure, axes = _whole_image(observations)
    kept = fit.corner_inlier
    q, error = np.asarray(observations.corners.q)[kept], fit.corner_error[kept]
    direction = np.degrees(np.arctan2(error[:, 1], error[:, 0]))
    drawn = axes.scatter(
        *q.T, c=direction, cmap=_round_colours(), vmin=-180, vmax=180, s=9, linewidths=0, rasterized=True
    )
    bar = add_bar(figure, drawn, axes, ticks=[-180, -90, 0, 90, 180], shrink=0.75, aspect=26, pad=0.015)
    bar.ax.set_yticklabels(["left", "up", "right", "down", "left"])
    middle, mean, clear = cell_means(q, error, fit.corner_sigma[kept], observations.width, observations.height)
    if clear.any():
        largest = np.linalg.norm(mean[clear], axis=-1).max()
        size = observations.width / _CELLS_ACROSS
        _draw(axes, arrows(middle[clear], mean[clear] * size / largest), "white", 3.2)
        _draw(axes, arrows(middle[clear], mean[clear] * size / largest), INK, 1.3)
    return figure


def cell_means(
    q: np.ndarray, error: np.ndarray, sigma: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean residual in the cells of a grid over an image of a width and a height, by pixels and residuals [n, 2], px.

    Returns:
        The centre of each cell that is not empty [cells, 2], px, the mean residual in it [cells, 2], px, and whether
        the mean is larger than noise of the standard deviations [cells]; by chance one cell in about a hundred is.
    """
    size = width / _CELLS_ACROSS
    cell = np.stack([q[:, 0] // size, q[:, 1] // size], -1)
    cells, member = np.unique(cell, axis=0, return_inverse=True)
    member = member.reshape(-1)
    count = np.bincount(member, minlength=len(cells))
    mean = np.stack([np.bincount(member, error[:, i], len(cells)) for i in range(2)], -1) / count[:, None]
    noise = np.sqrt(np.bincount(member, sigma**2, len(cells))) / count
    # Chi-squared with two degrees of freedom: the probability exp(-x / 2) is one in a hundred at 9.2.
    clear = (np.sum(mean**2, -1) > 9.2 * noise**2) & (count >= 5)
    return (cells + 0.5) * size, mean, clear


def coverage_map(observations: Observations, fit: Fit) -> "Figure":
    """The corners and stripe points in the image that were used."""
    figure, axes = _whole_image(observations)
    corners, stripes = observations.corners, observations.stripes
    for laser in range(len(observations.laser_names) if has_stripes(observations, fit) else 0):
        mine = np.asarray(stripes.laser) == laser
        q = np.asarray(stripes.q)[mine][fit.stripe_inlier[mine]]
        axes.plot(*q.T, ".", color=SERIES[1 + laser % 5], markersize=1.3, markeredgewidth=0, rasterized=True)
    used = np.asarray(corners.q)[fit.corner_inlier]
    axes.plot(*used.T, ".", color=BLUE, markersize=2.6, markeredgewidth=0, rasterized=True)
    return figure


def _whole_image(observations: Observations) -> tuple["Figure", Any]:
    """A figure of the image with room for labels; the figure of a portrait image is narrower, not taller."""
    width = 5.4 * min(1.0, observations.width / observations.height)
    figure = new_figure(width, (width - 0.4) * observations.height / observations.width + 0.35)
    return figure, _image_axes(figure, observations)


def _image_axes(figure: "Figure", observations: Observations, *, bare: bool = False) -> Any:
    """Axes of the image, with its first row on top."""
    axes = new_axes(figure, grid=False)
    axes.set_xlim(-0.5, observations.width - 0.5)
    axes.set_ylim(observations.height - 0.5, -0.5)
    axes.set_aspect("equal")
    for spine in axes.spines.values():
        spine.set_visible(True)
        spine.set_color(LINE if bare else SOFT)
    if bare:
        axes.set_xticks([])
        axes.set_yticks([])
    return axes


def _draw(axes: Any, path: Any, colour: str, width: float) -> None:
    from matplotlib.patches import PathPatch

    axes.add_patch(PathPatch(path, fill=False, edgecolor=colour, linewidth=width, capstyle="round"))


def _round_colours() -> Any:
    """A cyclic colour map in which people with any colour vision can tell opposite directions apart."""
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("round", ["#0072b2", "#8fd3e8", "#f2a100", "#6b1f3a", "#0072b2"])


_SHOWN_CORRELATION = 0.5


def depth_against_distance(lasers: Sequence[tuple[str, np.ndarray, np.ndarray]], noise_mm: np.ndarray) -> "Figure":
    """Standard deviation of the depth [mm] against the depth itself [m], both on logarithmic scales.

    Of each laser its name, depths and standard deviations; `noise_mm` is that of one point from the noise of its own
    stripe, at the depths of the first laser, and 0 where it is unknown.
    """
    figure, axes = new_plot(xlabel="depth, m", ylabel="standard deviation of the depth, mm")
    for index, (name, depth, sigma) in enumerate(lasers):
        label = "calibration" if len(lasers) == 1 else f"calibration, {plain(name)}"
        axes.plot(depth, sigma, "o-", color=SERIES[2 * index % len(SERIES)], markersize=4.5, label=label)
    if noise_mm.any():
        axes.plot(lasers[0][1], noise_mm, "s--", color=RED, markersize=4, label="one point's own stripe noise")
    axes.set_xscale("log")
    axes.set_yscale("log")
    _plain_ticks(axes.xaxis)
    _plain_ticks(axes.yaxis)
    axes.grid(True, which="both")
    add_legend(axes, inside=True)
    return figure


def correlations(names: Sequence[str], covariance: np.ndarray) -> "Figure":
    """Correlations of the estimated parameters. Held parameters are left out."""
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    free = np.flatnonzero(sigma > 0)
    correlation = covariance[np.ix_(free, free)] / np.outer(sigma[free], sigma[free])
    side = min(3.0 + 0.24 * len(free), 11.0)
    figure, axes = new_plot(side, side - 0.4, grid=False)
    drawn = axes.imshow(correlation, cmap="RdBu_r", vmin=-1, vmax=1, interpolation="nearest")
    labels = [plain(names[index], 18) for index in free.tolist()]
    axes.set_xticks(range(len(free)), labels, rotation=90, parse_math=False)
    axes.set_yticks(range(len(free)), labels, parse_math=False)
    axes.tick_params(length=0, labelsize=8)
    no_frame(axes)
    for i, j in zip(*np.nonzero(np.abs(np.tril(correlation, -1)) > _SHOWN_CORRELATION), strict=True):
        value = correlation[i, j]
        text = f"{value:+.2f}".replace("0.", ".")
        axes.text(j, i, text, ha="center", va="center", fontsize=5.5, color="white" if abs(value) > 0.7 else INK)
    add_bar(figure, drawn, axes, shrink=0.6, aspect=28, pad=0.02, ticks=[-1, -0.5, 0, 0.5, 1])
    return figure


def spectrum(directions: Sequence[Direction]) -> "Figure":
    """Standard deviation over the prior's, for each independent combination of parameters, worst first."""
    figure, axes = new_plot(5.4, min(0.9 + 0.27 * len(directions), 8.0), xlabel="standard deviation over the prior's")
    value = np.array([max(row.sigma_over_prior, 1e-12) for row in directions])
    place = np.arange(len(directions))
    left = 10.0 ** (np.floor(np.log10(value.min())) - 0.15)
    colours = [RED if is_held_by_priors(row.sigma_over_prior) else BLUE for row in directions]
    axes.hlines(place, left, value, color=colours, linewidth=1.2)
    axes.scatter(value, place, color=colours, s=20, zorder=3)
    axes.set_xscale("log")
    axes.set_xlim(left, max(1.6, 1.4 * value.max()))
    axes.axvline(1.0, color=SOFT, linewidth=0.9)
    axes.set_yticks(place, [combination(row.direction) for row in directions], parse_math=False)
    axes.tick_params(axis="y", length=0, labelsize=8)
    axes.set_ylim(len(directions) - 0.4, -0.6)
    axes.grid(False)
    axes.grid(True, axis="x", color=LINE)
    return figure


def combination(direction: dict[str, float], most: int = 3) -> str:
    """A combination of parameters as text: its largest components, by name."""
    largest = sorted(direction.items(), key=lambda item: -abs(item[1]))[:most]
    kept = [(name, part) for name, part in largest if abs(part) > 0.3 * abs(largest[0][1])]
    # The sign of a combination has no meaning; the first component is made positive.
    sense = 1.0 if not kept or kept[0][1] >= 0 else -1.0
    words = [f"{'+' if sense * part > 0 else '−'} {plain(name, 18)}" for name, part in kept]
    return " ".join(words).removeprefix("+ ") or "—"


def _plain_ticks(axis: Any) -> None:
    """Ticks at round numbers, written without exponents."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter, NullLocator

    axis.set_major_locator(FixedLocator(ROUND))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())
    axis.set_minor_formatter(NullFormatter())


# The longest arrow, in squares.
_LONGEST = 0.9
# The colour scale spans at least this many standard deviations, so that noise stays pale.
_SIGMAS = 3.0
# Up to this height numbers are in micrometres [mm].
_SMALL_MM = 0.02


def board_map(found: BoardMap, corners: np.ndarray, square_m: float) -> "Figure":
    """Heights over the best plane in colour and in numbers at the corners [m], and shifts in the plane as arrows."""
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import PathPatch

    x, y = 1e3 * corners[:, 0], 1e3 * corners[:, 1]
    shift = 1e3 * np.array(found.shift_m)
    noise = np.sqrt(np.mean(np.square(found.height_sigma_m))) if found.height_sigma_m else 0.0
    limit_mm = 1e3 * max(float(np.abs(found.height_m).max()), _SIGMAS * float(noise), 1e-6)
    unit, per_m = ("µm", 1e6) if limit_mm < _SMALL_MM else ("mm", 1e3)
    height, limit = per_m * np.array(found.height_m), 1e-3 * per_m * limit_mm
    decimals = 2 if limit < 1 else 1 if limit < 100 else 0
    wide, high = np.ptp(x), np.ptp(y)
    figure = new_figure(6.4, float(np.clip(6.0 * high / max(wide, 1e-9), 2.2, 7.5)) + 0.6)
    axes = new_axes(figure, grid=False, xlabel="x on the board, mm", ylabel="y, mm", aspect="equal")
    size = 0.44 * 1e3 * square_m
    half = 0.5e3 * square_m
    # Each corner gets its own square, since the corners of some boards are not on a plain grid.
    squares = np.stack([x, y], 1)[:, None] + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    drawn = PolyCollection(list(squares), array=height, cmap="RdBu_r", clim=(-limit, limit), alpha=0.75, linewidths=0)
    axes.add_collection(drawn)
    axes.set(xlim=(x.min() - half, x.max() + half), ylim=(y.max() + half, y.min() - half))
    if len(height) <= 150:
        for px, py, value in zip(x, y, height, strict=True):
            # 0 has no sign.
            text = f"{value:+.{decimals}f}" if round(value, decimals) else f"{0:.{decimals}f}"
            axes.text(px, py + size, text, ha="center", va="bottom", fontsize=6, color=INK)
    longest = float(np.linalg.norm(shift, axis=1).max()) if len(shift) else 0.0
    if longest > 0:
        scale = _LONGEST * 1e3 * square_m / longest
        path = arrows(np.column_stack([x, y]), scale * shift)
        axes.add_patch(PathPatch(path, fill=False, edgecolor=INK, linewidth=0.8, clip_on=False))
        axes.set_title(f"arrows: place in the plane, the longest {longest:.3f} mm", color=SOFT, loc="left")
    add_bar(figure, drawn, axes, shrink=0.8, aspect=24, pad=0.02).set_label(f"height into the board, {unit}")
    return figure
