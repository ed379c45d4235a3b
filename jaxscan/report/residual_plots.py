"""Residuals along the stripe, against the table's angle, and compared with the Gaussian."""

from statistics import NormalDist
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxscan.calibration import Fit
from jaxscan.observation import Observations
from jaxscan.report.drawing import BLUE, INK, RED, SERIES, SOFT, add_legend, new_axes, new_figure, plain


if TYPE_CHECKING:
    from matplotlib.figure import Figure


_BINS = 28
_LIMIT = 5.0
_QUANTILES = 400


def along_stripe(observations: Observations, fit: Fit) -> "Figure":
    """Stripe residuals along the stripe, with the means of short pieces."""
    figure = new_figure()
    axis = stripe_direction(observations)
    axes = new_axes(figure, xlabel=f"image {'row' if axis else 'column'}, px", ylabel="stripe residual, px")
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
    figure = new_figure()
    axes = new_axes(figure, xlabel="table angle, degrees", ylabel="mean stripe residual of a view, px")
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
    figure = new_figure()
    axes = new_axes(figure, xlabel="table angle, degrees", ylabel="mean corner residual of a view, px")
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
    figure = new_figure(5.4, 2.9)
    axes = new_axes(figure, xlabel="residual / its standard deviation", ylabel="density")
    axes.hist(whitened, bins=np.arange(-_LIMIT, _LIMIT + 0.1, 0.2), density=True, color=BLUE, alpha=0.55, linewidth=0)
    x = np.linspace(-_LIMIT, _LIMIT, 201)
    axes.plot(x, np.exp(-0.5 * x**2) / np.sqrt(2 * np.pi), color=INK, linewidth=1.4, label="unit Gaussian")
    axes.set_xlim(-_LIMIT, _LIMIT)
    add_legend(axes)
    return figure


def quantiles(whitened: np.ndarray) -> "Figure":
    """Quantiles of the whitened residuals against quantiles of the unit Gaussian."""
    figure = new_figure(5.4, 2.9)
    axes = new_axes(figure, xlabel="quantile of the unit Gaussian", ylabel="quantile of the residuals")
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
    """Whether a view has the placement of a view at another table angle [views]."""
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
