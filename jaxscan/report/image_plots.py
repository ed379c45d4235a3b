"""Residuals and coverage over the image."""

from typing import TYPE_CHECKING, Any

import numpy as np

from jaxscan.calibration import Fit
from jaxscan.observation import Observations
from jaxscan.report.drawing import BLUE, INK, LINE, RED, SERIES, SOFT, arrows, new_axes, new_figure
from jaxscan.report.residual_plots import has_stripes


if TYPE_CHECKING:
    from matplotlib.figure import Figure


ARROW_SHARE = 0.075
"""Length of the arrow of a residual as large as the scale, as a share of the image's width."""
_CELLS_ACROSS = 12


def residual_scale(fit: Fit) -> float:
    """A round length [px] that scales all arrows of a report: about the 90 % quantile of the kept residuals."""
    length = np.linalg.norm(fit.corner_error, axis=-1)[fit.corner_inlier]
    usual = float(np.percentile(length, 90)) if length.size else 0.0
    return _round_number(usual) if usual > 0 else 1.0


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
    bar = figure.colorbar(drawn, ax=axes, ticks=[-180, -90, 0, 90, 180], shrink=0.75, aspect=26, pad=0.015)
    bar.ax.set_yticklabels(["left", "up", "right", "down", "left"])
    bar.ax.tick_params(length=0, labelsize=8)
    bar.outline.set_visible(False)
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
    """Mean residual in the cells of a grid over the image.

    Args:
        q: Pixels [n, 2].
        error: Residuals [n, 2], px.
        sigma: Standard deviation of each [n], px.
        width: Of the image [px].
        height: Of the image [px].

    Returns:
        The centre of each cell that is not empty [cells, 2], px, the mean residual in it [cells, 2], px, and whether
        the mean is larger than noise [cells]; by chance that is so for one cell in about a hundred.
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


def _round_number(value: float) -> float:
    """The next larger number that is 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * next(step for step in (1.0, 2.0, 5.0, 10.0) if step * power >= value * 0.999))
