"""Picture of the marks: the wall in the coloured cloud, the centres, and histograms of the distances."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import jaxscan
from experiments.paper.drawing import plt, save
from experiments.paper.figures.marks import finder


PAPER_MM = (299.84, 0.87)
"""The paper's mean and standard deviation."""
_CELL_M = 0.0025


class WallPicture(NamedTuple):
    """A cloud of a wall, as seen from the front."""

    grey: np.ndarray
    """[rows, columns], DN; NaN where there is no point."""
    extent: tuple[float, float, float, float]
    """Left, right, bottom and top [m]."""
    centres: np.ndarray
    """[marks, 2], m."""
    pairs: np.ndarray
    """Both ends of each pair [pairs, 2, 2], m."""


def wall_picture(cloud: jaxscan.PointCloud, measured: Any) -> WallPicture:
    """The cloud's colours on a raster in the plane of the wall."""
    xyz, valid = np.asarray(cloud.xyz, np.float64), np.asarray(cloud.valid)
    plane = finder.fit_wall(xyz, valid, np.array([0.0, 0.0, 1.0]))
    # Profiles are farther apart than the raster is fine: neighbours are joined by straight lines.
    both = valid[:-1] & valid[1:]
    grey = np.asarray(cloud.rgb, np.float64)[..., 0]
    places, greys = [], []
    for share in (0.0, 0.25, 0.5, 0.75):
        places.append(((1 - share) * xyz[:-1] + share * xyz[1:])[both])
        greys.append(((1 - share) * grey[:-1] + share * grey[1:])[both])
    at = (np.concatenate(places) - plane.middle) @ plane.axes[:2].T
    low, high = at.min(0), at.max(0)
    shape = tuple(np.ceil((high - low) / _CELL_M).astype(int))
    ends = [(low[0], high[0]), (low[1], high[1])]
    count, *_ = np.histogram2d(*at.T, bins=shape, range=ends)
    total, *_ = np.histogram2d(*at.T, bins=shape, range=ends, weights=np.concatenate(greys))
    raster = np.where(count > 0, total / np.maximum(count, 1), np.nan).T
    place = measured.centres.place[:, :2]
    return WallPicture(raster, (low[0], high[0], low[1], high[1]), place, place[measured.numbers])


def draw_marks(path: Path, title: str, wall: WallPicture, measured: dict[str, list[Any]]) -> None:
    """Write the picture; `measured` holds the clouds of each method by its name."""
    figure = plt.figure(figsize=(13, 9.5), dpi=110, layout="constrained")
    grid = figure.add_gridspec(2, len(measured), height_ratios=(1.75, 1))
    axes = figure.add_subplot(grid[0, :])
    axes.imshow(wall.grey, cmap="gray", origin="lower", extent=wall.extent, interpolation="nearest", vmin=0)
    for start, end in wall.pairs:
        axes.plot(*np.transpose([start, end]), color="tab:cyan", lw=0.6, alpha=0.5)
    axes.plot(*wall.centres.T, "+", color="tab:red", ms=9, mew=1.4)
    axes.set(xlabel="along the wall [m]", ylabel="height on the wall [m]", aspect="equal")
    axes.set_title(
        "The wall in our coloured cloud: centres found by colour (red), pairs 300 mm apart (blue)", fontsize=11
    )
    for column, (name, clouds) in enumerate(measured.items()):
        _histogram(figure.add_subplot(grid[1, column]), name, clouds)
    figure.suptitle(title, fontsize=13)
    save(figure, path, 110)


def _histogram(axes: Any, name: str, clouds: list[Any]) -> None:
    beside = np.concatenate([one.distances[one.beside] for one in clouds])
    above = np.concatenate([one.distances[~one.beside] for one in clouds])
    every = np.concatenate([beside, above])
    bins = np.linspace(297, 303, 61)
    axes.hist(
        [np.clip(above, 297, 303), np.clip(beside, 297, 303)],
        bins,
        stacked=True,
        density=True,
        label=["vertical pairs", "horizontal pairs"],
        color=["tab:blue", "tab:orange"],
    )
    x = np.linspace(297, 303, 400)
    mean, std = PAPER_MM
    axes.plot(
        x,
        np.exp(-0.5 * ((x - mean) / std) ** 2) / (std * np.sqrt(2 * np.pi)),
        "k--",
        lw=1.2,
        label=f"paper: {mean} ± {std} mm",
    )
    axes.axvline(300, color="0.4", lw=0.8)
    spread = np.median([one.distances.std(ddof=1) for one in clouds])
    axes.set(xlabel="distance [mm]", ylabel="density [1/mm]", xlim=(297, 303))
    axes.set_title(f"{name}: {every.mean():.2f} ± {spread:.2f} mm\n({len(clouds)} calibrations)", fontsize=11)
    # Room for the legend.
    axes.set_ylim(0, 1.45 * axes.get_ylim()[1])
    axes.legend(fontsize=8)
