"""Pictures of the room: plans and elevations with the measured dimensions."""

from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from scipy.ndimage import distance_transform_edt  # type: ignore[import-untyped]

import jaxscan
from experiments.paper.drawing import plt, save
from jaxscan.measurement.room import RoomBox


PLAN_M, FRONT_M = 0.01, 0.005
"""Pixels of plans and of elevations [m]."""
FAR_M = 3.5
"""Distance at which neighbouring profiles of an elevation still touch [m]."""
MARGIN_M = 0.15
IN_FRONT_M = 0.75
"""Points so far before a wall belong to its elevation [m]."""
_INK = "0.15"


class Survey(NamedTuple):
    """Points in the frame of the room: x along its width, y along its length, its middle at zero."""

    xyz: np.ndarray
    """[n, 3], m; heights from the scanner's origin."""
    rgb: np.ndarray
    """[n, 3], uint8."""
    width_m: float
    length_m: float
    rig_m: np.ndarray
    """Where the scanner stands [2]."""


def survey_of(xyz: np.ndarray, rgb: np.ndarray | None, box: RoomBox) -> Survey:
    """Turn points so that the measured walls run along the axes.

    Args:
        xyz: [n, 3], m, scanner frame.
        rgb: Their colours, uint8 [n, 3]; without them all are grey.
        box: The measured room.
    """
    width, length = box.width, box.length
    assert width is not None and length is not None
    across = width.direction[:2] / np.linalg.norm(width.direction[:2])
    along = np.array([-across[1], across[0]])
    if along @ length.direction[:2] < 0:
        along = -along
    turn = np.stack([across, along])
    middle = box.centre_m[:2]
    flat = (xyz[:, :2] - middle) @ turn.T
    colour = np.full((len(xyz), 3), 128, np.uint8) if rgb is None else rgb
    return Survey(np.column_stack([flat, xyz[:, 2]]), colour, width.value_m, length.value_m, -turn @ middle)


def draw_plans(path: Path, ours: Survey, paper: Survey | None, paper_azimuth: np.ndarray, title: str) -> None:
    """Draw top views: ours without and with colour, and that of the paper's method.

    Args:
        path: Of the picture.
        ours: Our points.
        paper: Those of the paper's method; None if it found no walls.
        paper_azimuth: The table's angle of each of them [deg].
        title: Of the picture.
    """
    figure, axes = plt.subplots(1, 3, figsize=(17, 9.2), constrained_layout=True)
    figure.suptitle(title, fontsize=15)
    half = ours.width_m / 2 + MARGIN_M, ours.length_m / 2 + MARGIN_M
    heights = ours.xyz[:, 2]
    low, high = np.percentile(heights, [1, 99])
    shown = _plan(axes[0], ours, half, heights, "viridis", (low, high))
    axes[0].set_title("Ours, without colour: by height")
    figure.colorbar(shown, ax=axes[0], shrink=0.4, label="height above the scanner [m]")
    _plan(axes[1], ours, half, ours.rgb, None, None)
    axes[1].set_title("Ours, with colour")
    for axis in axes[:2]:
        _dimensions(axis, ours)
    if paper is None:
        axes[2].axis("off")
        return save(figure, path, 110)
    wide = max(half[0], paper.width_m / 2 + 0.3), max(half[1], paper.length_m / 2 + 0.3)
    shown = _plan(axes[2], paper, wide, paper_azimuth, "twilight", (0, 360))
    axes[2].set_title("The paper's method, the draw of median error: by table angle")
    figure.colorbar(shown, ax=axes[2], shrink=0.4, label="angle of the table [°]")
    _dimensions(axes[2], paper)
    save(figure, path, 110)


def draw_elevations(path: Path, ours: Survey, steps: int, title: str) -> None:
    """Side views of all four walls, from within: without colour, by the distance before the wall, and with colour."""
    low, high = np.percentile(ours.xyz[:, 2], [0.2, 99.8])
    reach = max(ours.length_m, ours.width_m) / 2 + 0.1
    gap = FAR_M * 2 * np.pi / steps
    figure, axes = plt.subplots(4, 2, figsize=(18, 12.5), sharex=True, sharey=True, constrained_layout=True)
    figure.suptitle(title, fontsize=15)
    walls = (("x", 1.0), ("y", 1.0), ("x", -1.0), ("y", -1.0))
    shown = None
    for row, (name, side) in zip(axes, walls, strict=True):
        across = "xy".index(name)
        depth = (ours.width_m if name == "x" else ours.length_m) / 2 - side * ours.xyz[:, across]
        # Seen from within, with the wall ahead: to the right is -y before +x, and +x before +y.
        right = ours.xyz[:, 1 - across] * (-side if name == "x" else side)
        half = (ours.length_m if name == "x" else ours.width_m) / 2
        kept = (np.abs(depth) < IN_FRONT_M) & (np.abs(right) < half + 0.05)
        at = np.column_stack([right[kept], ours.xyz[kept, 2]])
        extent = (-half - 0.05, half + 0.05, low, high)
        shown = _front(row[0], at, 1e3 * depth[kept], extent, ("cividis", -10, 250), gap)
        _front(row[1], at, ours.rgb[kept], extent, None, gap)
        row[0].set_ylabel(f"wall at {'+' if side > 0 else '-'}{name}: height [m]")
    figure.colorbar(shown, ax=axes, location="bottom", shrink=0.35, aspect=40, label="before the wall [mm]")
    axes[0, 0].set_xlim(-reach, reach)
    axes[0, 0].set_title("Without colour: by distance before the wall")
    axes[0, 1].set_title("With colour")
    for axis in axes[-1]:
        axis.set_xlabel("along the wall [m]")
    save(figure, path, 110)


def draw_view(path: Path, cloud: jaxscan.PointCloud, rgb: np.ndarray, every: int) -> None:
    """The room from above one of its corners: without colour on the left, with it on the right."""
    from jaxscan.report import draw_cloud

    xyz, rgb, normals = (np.asarray(field)[::every] for field in (cloud.xyz, rgb, cloud.normals))
    size = (1500, 1000)
    light = np.abs(normals @ np.array([0.5, 0.62, 0.6], np.float32))
    grey = np.repeat(np.where(cloud.valid[::every], 70 + 170 * light, 0)[..., None], 3, -1).astype(np.uint8)
    both = [draw_cloud(xyz, colours, normals=normals, size=size) for colours in (grey, rgb)]
    figure, axes = plt.subplots(1, 2, figsize=(18, 6.4), constrained_layout=True)
    for axis, picture, name in zip(axes, both, ("without colour: by the normals", "with colour"), strict=True):
        axis.imshow(picture)
        axis.set_title(f"The cloud of the room, {name}")
        axis.axis("off")
    save(figure, path, 110)


def _raster(
    at: np.ndarray, values: np.ndarray, extent: tuple[float, float, float, float], pixel_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """Mean of values [n] or [n, 3] and number of points in each pixel [rows, columns]; NaN where there is none."""
    shape = round((extent[3] - extent[2]) / pixel_m), round((extent[1] - extent[0]) / pixel_m)
    column = np.floor((at[:, 0] - extent[0]) / pixel_m).astype(int)
    row = np.floor((at[:, 1] - extent[2]) / pixel_m).astype(int)
    inside = (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
    pixel = row[inside] * shape[1] + column[inside]
    count = np.bincount(pixel, minlength=shape[0] * shape[1])
    columns = values[inside].reshape(len(pixel), -1).T
    sums = [np.bincount(pixel, weights=each, minlength=len(count)) for each in columns]
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.stack(sums, -1) / count[:, None]
    return mean.reshape(*shape, -1), count.reshape(shape)


def _plan(
    axis: Axes,
    survey: Survey,
    half: tuple[float, float],
    values: np.ndarray,
    colours: str | None,
    limits: tuple[float, float] | None,
) -> object:
    """Points from above, the denser the darker."""
    extent = (-half[0], half[0], -half[1], half[1])
    mean, count = _raster(survey.xyz[:, :2], values, extent, PLAN_M)
    strength = np.clip(np.log1p(count) / np.log1p(np.percentile(count[count > 0], 90)), 0, 1)
    axis.set_facecolor("white")
    axis.plot(*survey.rig_m, "+", color="crimson", markersize=11)
    axis.annotate("scanner", survey.rig_m, xytext=(6, 6), textcoords="offset points", color="crimson", fontsize=9)
    axis.set_aspect("equal")
    axis.set_xlabel("across the room [m]")
    axis.set_ylabel("along the room [m]")
    if colours is None:
        picture = np.dstack([_brightened(mean), 0.15 + 0.85 * strength])
        picture[count == 0] = 0
        return axis.imshow(picture, extent=extent, origin="lower", interpolation="nearest")
    assert limits is not None
    alpha = np.where(count > 0, 0.15 + 0.85 * strength, 0)
    image = np.where(count > 0, mean[..., 0], limits[0])
    axis.imshow(image, extent=extent, origin="lower", cmap=colours, vmin=limits[0], vmax=limits[1], alpha=alpha)
    return mpl.cm.ScalarMappable(mpl.colors.Normalize(*limits), colours)


def _front(
    axis: Axes,
    at: np.ndarray,
    values: np.ndarray,
    extent: tuple[float, float, float, float],
    shades: tuple[str, float, float] | None,
    gap_m: float,
) -> object:
    """Points from the front; a pixel has the mean of its points."""
    mean, count = _raster(at, values, extent, FRONT_M)
    # Gaps between profiles take the nearest points.
    distance, nearest = distance_transform_edt(count == 0, return_indices=True)
    mean, count = mean[tuple(nearest)], (distance <= 1 + gap_m / 2 / FRONT_M).astype(int)
    axis.set_facecolor("0.93")
    axis.set_aspect("equal")
    if shades is None:
        picture = np.dstack([_brightened(mean), np.where(count > 0, 1.0, 0.0)])
        picture[count == 0] = 0
        return axis.imshow(picture, extent=extent, origin="lower")
    colours, low, high = shades
    image = np.where(count > 0, mean[..., 0], np.nan)
    return axis.imshow(image, extent=extent, origin="lower", cmap=colours, vmin=low, vmax=high)


def _brightened(mean: np.ndarray) -> np.ndarray:
    """Colours [..., 3] of 0 ... 1: as bright as a print wants them."""
    seen = mean[np.isfinite(mean)]
    top = np.percentile(seen, 99.5) if len(seen) else 1.0
    return np.clip(np.nan_to_num(mean) / max(top, 1.0), 0, 1)


def _dimensions(axis: Axes, survey: Survey) -> None:
    """Lines with arrows, through the room's middle, with its measured dimensions in mm."""
    x, y = survey.width_m / 2, survey.length_m / 2
    line = {"arrowstyle": "<->", "color": _INK, "lw": 1.2, "shrinkA": 0, "shrinkB": 0}
    box = {"boxstyle": "round,pad=0.25", "fc": "white", "ec": "none", "alpha": 0.85}
    axis.annotate("", (-x, -0.3 * y), (x, -0.3 * y), arrowprops=line)
    axis.annotate("", (0.3 * x, -y), (0.3 * x, y), arrowprops=line)
    text = {"ha": "center", "va": "center", "fontsize": 12, "color": _INK, "bbox": box}
    axis.text(-0.35 * x, -0.3 * y, f"{1e3 * survey.width_m:.1f} mm", **text)
    axis.text(0.3 * x, 0.35 * y, f"{1e3 * survey.length_m:.1f} mm", rotation=90, **text)
