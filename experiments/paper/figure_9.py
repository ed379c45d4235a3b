"""Figure 9: the room of 3820 x 6150 mm, scanned all around and measured from its cloud, wall to wall by planes.

All methods measure the same sweep. Ours has calibrations from boards by our own protocol, the same refined by the walls
of the sweep, and calibrations from the paper's 23 views. The paper's method has calibrations from those same views, in
all draws of their noise. A last series takes Tr from two views that are farther apart: which turn explains the paper's
errors?
"""

from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from scipy.ndimage import distance_transform_edt  # type: ignore[import-untyped]

import jaxscan
from experiments.paper.methods import METHODS, BoardCorners, PaperWay, board_pose, find_board, pair_motion, paper_cloud
from experiments.paper.products import (
    PAIR_DEG,
    WORKING_M,
    BoardPlan,
    Draw,
    PlainStripes,
    Room,
    draws,
    expect_each,
    our_calibrations,
    room,
    room_colours,
    room_sweep,
)
from experiments.paper.stage import Metric, Stage, plt, save
from experiments.report import rms
from jaxscan import recalibration
from jaxscan.measurement.room import RoomBox
from jaxscan.reconstruction import plan_sweep, smooth_stripes
from jaxscan.simulation import Motion, Placement, SimulationConfig, make_rig, rodrigues, take_frame
from jaxscan.simulation.rig import project


PROFILES, ROWS = 360, 200
"""Of a thinned cloud, about: enough points for planes, and thirty clouds take little time."""
UPRIGHT = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""From the camera's frame (right, down, ahead) to one whose z is up."""
_SIGMA_M, _SIGMA_AT_M = 1e-3, 1.3
FARTHEST_M = 10.0
"""Points farther away than this are left out: no room is so long, and plain finders take reflections too."""


class Points(NamedTuple):
    """A cloud as `jaxscan.measure_room` takes it."""

    xyz: np.ndarray
    """[records, rows, 3], m; z up, zero where not valid."""
    sigma_random: np.ndarray
    valid: np.ndarray
    laser: np.ndarray
    angle: np.ndarray


class Size(NamedTuple):
    """Both horizontal dimensions of a room, from the cloud [mm]."""

    width: float
    length: float
    width_sigma: float = np.nan
    """Predicted standard deviation."""
    length_sigma: float = np.nan

    def errors(self, truth: "Size") -> np.ndarray:
        """Of width and length [2]."""
        return np.array(self[:2]) - np.array(truth[:2])

    def sigmas(self) -> np.ndarray:
        """Of width and length [2]."""
        return np.array(self[2:])


NOT_MEASURED = Size(np.nan, np.nan)


def true_size(stage: Stage) -> Size:
    """Of the configuration's room."""
    room = stage.config.room
    assert room is not None
    width, length = sorted(1e3 * side for side in room.size_m[:2])
    return Size(width, length)


def box_of(points: Points | jaxscan.PointCloud, scanner: jaxscan.Scanner | None = None) -> RoomBox | None:
    """Walls by planes; None where no two pairs of opposite walls are found."""
    try:
        box = jaxscan.measure_room(points, scanner=scanner)
    except jaxscan.MeasurementError:
        return None
    return None if box.width is None or box.length is None else box


def size_of(box: RoomBox | None) -> Size:
    """Wall to wall; NaN where they were not found."""
    if box is None or box.width is None or box.length is None:
        return NOT_MEASURED
    sides = box.width, box.length
    return Size(*(1e3 * side.value_m for side in sides), *(1e3 * side.sigma_m for side in sides))


def thinned(room: Room) -> Room:
    """Every n-th record, so that about `PROFILES` are left; rows are all there."""
    step = max(1, len(room.angles) // PROFILES)
    return Room(records_of(room.stripes, step), {}, room.angles[::step], room.window)


def records_of(stripes: jaxscan.Stripes, step: int) -> jaxscan.Stripes:
    """Every n-th record of stripes of one laser."""
    fields = {name: np.asarray(field)[::step] for name, field in vars(stripes).items() if field is not None}
    return jaxscan.Stripes(**fields | {"record": np.arange(len(fields["u"]), dtype=np.int32)})


def our_cloud(stage: Stage, room: Room, scanner: jaxscan.Scanner, *, normals: bool = False) -> jaxscan.PointCloud:
    """The room by one of our calibrations; no frame is read."""
    settings = jaxscan.ReconstructSettings(normals=normals)
    return jaxscan.reconstruct(room_sweep(stage, room.angles), scanner, stripes=room.stripes, settings=settings)


def recalibrated(stage: Stage, room: Room, path: str) -> jaxscan.Recalibration:
    """A calibration from boards, refined by the walls of the sweep itself.

    Features of the laser-off images could help too; here the stripes serve alone.
    """
    stored = jaxscan.load_calibration(path)
    plan = plan_sweep(room_sweep(stage, room.angles), stored.scanner, jaxscan.ReconstructSettings())
    along = smooth_stripes(plan.sweep, room.stripes)
    sweep = recalibration.SweepStripes(
        name="room",
        centre=along.u,
        sigma=along.sigma,
        shared_lines=along.shared_lines,
        valid=np.asarray(room.stripes.valid) & (along.sigma > 0),
        record=np.asarray(room.stripes.record),
        laser=plan.sheet,
        angle=room.angles,
        stripe_axis=plan.stripe_axis,
    )
    return recalibration.recalibrate([sweep], stored)


def paper_points(way: PaperWay, plain: PlainStripes, angles: np.ndarray) -> Points:
    """The room by a calibration of the paper's method, thinned."""
    records, rows = (max(1, count // wanted) for count, wanted in zip(plain.u.shape, (PROFILES, ROWS), strict=True))
    # Rows are masked, not cut out: their number is their place in the image.
    some = np.zeros(plain.u.shape[1], bool)
    some[::rows] = True
    xyz = paper_cloud(way, plain.u[::records], plain.valid[::records] & some, angles[::records])[:, some]
    return points_of(xyz @ UPRIGHT.T, angles[::records])


def points_of(xyz: np.ndarray, angles: np.ndarray) -> Points:
    """A cloud by a method that states no uncertainty of a point: one that grows with the square of the distance.

    Args:
        xyz: [records, rows, 3], m; z up, NaN where there is no point.
        angles: Of the table [records], rad.
    """
    far = np.linalg.norm(xyz, axis=-1)
    valid = np.isfinite(far) & (far < FARTHEST_M)
    sigma = np.where(valid, _SIGMA_M * (far / _SIGMA_AT_M) ** 2, 0.0)
    lasers = np.zeros(len(xyz), np.uint8)
    return Points(np.where(valid[..., None], xyz, 0.0), sigma, valid, lasers, np.asarray(angles))


ANGLES_DEG = (0.5, 1.0, PAIR_DEG, 4.0, 8.0, 16.0, 24.0)
QUICK_DEG = (PAIR_DEG, 16.0)
CALIBRATIONS, QUICK_CALIBRATIONS = 4, 1
"""Number of calibrations by the paper's method that take their Tr from another pair."""
DRAWS, QUICK_DRAWS = 3, 2
"""Draws of the noise of each pair, for each calibration."""
_PAIR_STREAM = 91
_TILT = rodrigues(np.array([np.cos(0.7), np.sin(0.7), 0.0]), np.deg2rad(30.0))
_MARGIN = 0.01
"""Of the image's size, between the board and the image's edge."""


class PairAngle(NamedTuple):
    """Results of pairs of one angle."""

    angle_deg: float
    depth_m: float
    """Of the board from the camera, midway between both views."""
    sizes: list[list[Size]]
    """By each calibration, with each draw of the pair's noise."""

    def rms(self, truth: Size) -> np.ndarray:
        """Root mean square error of width and length [2], mm; where walls were found."""
        errors = self._errors(truth)
        return np.sqrt(np.nanmean(errors**2, axis=(0, 1)))

    def scatter(self, truth: Size) -> np.ndarray:
        """Standard deviation of width and length [2], mm, by the noise of the pair alone: calibrations stay."""
        errors = self._errors(truth)
        apart = errors - np.nanmean(errors, axis=1, keepdims=True)
        seen = np.isfinite(errors).sum(1)
        return np.sqrt(np.nansum(apart**2, axis=(0, 1)) / np.maximum(seen - 1, 0).sum(0))

    def _errors(self, truth: Size) -> np.ndarray:
        return np.array([[size.errors(truth) for size in sizes] for sizes in self.sizes])


def pair_angles(stage: Stage, known: list[Draw], plain: PlainStripes, angles: np.ndarray) -> list[PairAngle]:
    """The room by the paper's method, with Tr from pairs of larger turns; camera and plane are those of its draws.

    Args:
        known: Calibrations by the paper's method, of which Tr is replaced.
        angles: Of the table, of each record [rad].
    """
    out = []
    for degrees in QUICK_DEG if stage.quick else ANGLES_DEG:
        place = place_pair(stage.config, np.deg2rad(degrees))
        if place is None:
            continue
        placement, depth = place
        records = list(expect_each(stage, BoardPlan([placement], [False, False])))
        some = known[: QUICK_CALIBRATIONS if stage.quick else CALIBRATIONS]
        sizes: list[list[Size]] = [[] for _ in some]
        for draw in range(QUICK_DRAWS if stage.quick else DRAWS):
            for number, calibration in enumerate(some):
                random = stage.generator(_PAIR_STREAM, round(100 * degrees), draw, number)
                views = [_corners(stage.config, record.off, random) for record in records]
                way = with_pair(calibration.paper, views, np.deg2rad(degrees))
                box = None if way is None else box_of(paper_points(way, plain, angles))
                sizes[number].append(size_of(box))
        out.append(PairAngle(degrees, depth, sizes))
    return out


def with_pair(way: PaperWay, views: list[BoardCorners | None], angle: float) -> PaperWay | None:
    """The same calibration with Tr from two other views, equation (10).

    Args:
        views: The board in both views.
        angle: The table's turn between them, as commanded [rad].

    Returns:
        None if a board was not found.
    """
    poses = []
    for view in views:
        if view is None:
            return None
        poses.append(board_pose(way.matrix, way.k, view))
    return way._replace(tr=pair_motion(*poses), pair_angle=angle)


def place_pair(config: SimulationConfig, angle: float) -> tuple[Placement, float] | None:
    """A board before the camera, seen from half the angle on either side, as near to the working distance as it fits.

    Returns:
        The placement, and the board's depth midway [m]; None if the field of view is too small for the turn.
    """
    rig = make_rig(config)
    outline = config.boards.board().outline()
    middle = np.append(outline.mean(0), 0.0)
    edge = np.column_stack([outline, np.zeros(len(outline))])
    size = np.array([config.camera.width, config.camera.height])
    angles = (-angle / 2, angle / 2)
    for depth in np.arange(WORKING_M, 2.8, 0.05):
        pose = rig.pose(0.0) @ Motion(_TILT, np.array([0.0, 0.0, depth]) - _TILT @ middle)
        seen = np.concatenate([(rig.pose(phi).inverse() @ pose).apply(edge) for phi in angles])
        pixels = np.stack(project(config.camera, seen), -1)
        if np.all((pixels > _MARGIN * size) & (pixels < (1 - _MARGIN) * size)):
            return Placement(pose, angles, 0), float(depth)
    return None


def smallest_angle(angles: np.ndarray, values: np.ndarray, wanted: float) -> float:
    """The angle at which a value falls to another, by the power law through all angles that were tried.

    Few draws at each angle scatter by a quarter: a first crossing would be too early.

    Args:
        angles: Of the pairs [deg].
        values: Of each [mm]; those that are not finite are left out.
        wanted: The value to reach [mm].

    Returns:
        The angle [deg], perhaps beyond those that were tried; infinite if values do not fall.
    """
    known = np.isfinite(values) & (values > 0)
    if known.sum() < 2:
        return np.inf
    slope, start = np.polyfit(np.log(angles[known]), np.log(values[known]), 1)
    return float(np.exp((np.log(wanted) - start) / slope)) if slope < 0 else np.inf


def _corners(config: SimulationConfig, light: np.ndarray, random: np.random.Generator) -> BoardCorners | None:
    """The board in one exposure without laser."""
    flicker = max(0.0, 1 + config.light.flicker * random.standard_normal())
    board = config.boards.board()
    return find_board(take_frame(light * np.float32(flicker), config, random), board.grid(), board.square)


PAPER_ERRORS = (-2.0, -9.0)
"""Of the paper's room, width and length [mm]."""
COLOURS = ("tab:blue", "tab:orange")
SIDE_NAMES = ("width, 3.82 m", "length, 6.15 m")


def draw_errors(path: Path, groups: dict[str, list[Size]], pairs: list[PairAngle], truth: Size, title: str) -> None:
    """Errors of each group as dots on the left, rms error against the angle of the pair on the right.

    Args:
        groups: Measured rooms by method; NaN where walls were not found.
        pairs: Rooms by the paper's method, for each turn between the views of Tr.
    """
    figure, (left, right) = plt.subplots(1, 2, figsize=(17, 7.5), width_ratios=(1.25, 1), constrained_layout=True)
    figure.suptitle(title, fontsize=15)
    _dots(left, groups, truth)
    _against_angle(right, pairs, truth)
    save(figure, path, 110)


def _dots(axis: Axes, groups: dict[str, list[Size]], truth: Size) -> None:
    """Errors on a scale that is linear near zero."""
    for place, sizes in enumerate(groups.values()):
        errors = np.array([size.errors(truth) for size in sizes]).reshape(-1, 2)
        for side, (colour, name) in enumerate(zip(COLOURS, SIDE_NAMES, strict=True)):
            seen = errors[np.isfinite(errors[:, side]), side]
            height = -place + (0.18 if side == 0 else -0.18)
            spread = 0.09 * np.sin(2.4 * np.arange(len(seen)))
            label = name if place == 0 else None
            axis.plot(seen, height + spread, "o", color=colour, alpha=0.6, markersize=5, label=label)
            if len(seen) > 3:
                low, middle, high = np.percentile(seen, [25, 50, 75])
                axis.plot([low, high], [height, height], color=colour, lw=6, alpha=0.3)
                axis.plot([middle], [height], "|", color=colour, markersize=22, markeredgewidth=2.5)
    for error, colour in zip(PAPER_ERRORS, COLOURS, strict=True):
        axis.axvline(error, color=colour, ls="--", lw=1)
    axis.axvline(0, color="0.3", lw=0.8)
    axis.set_xscale("symlog", linthresh=1.0, linscale=0.8)
    axis.xaxis.set_major_formatter(mpl.ticker.FormatStrFormatter("%g"))
    axis.set_yticks([-place for place in range(len(groups))], list(groups))
    axis.set_xlabel("measured minus true [mm] (linear between -1 and 1); dashed: the paper's errors")
    axis.set_title("Errors of the room's dimensions; bars: quartiles of the draws")
    axis.grid(axis="x", alpha=0.3)
    axis.legend(loc="lower right")


def _against_angle(axis: Axes, pairs: list[PairAngle], truth: Size) -> None:
    angle = np.array([pair.angle_deg for pair in pairs])
    rms, scatter = np.array([[pair.rms(truth), pair.scatter(truth)] for pair in pairs]).transpose(1, 0, 2)
    for side, (colour, name) in enumerate(zip(COLOURS, SIDE_NAMES, strict=True)):
        axis.plot(angle, rms[:, side], "o-", color=colour, label=f"{name}: rms error")
        axis.plot(
            angle,
            scatter[:, side],
            "s:",
            color=colour,
            label=f"{name}: standard deviation by the noise of these two views",
        )
        axis.axhline(-PAPER_ERRORS[side], color=colour, ls="--", lw=1)
    axis.set_xscale("log")
    axis.set_yscale("log")
    for scale in (axis.xaxis, axis.yaxis):
        scale.set_major_formatter(mpl.ticker.FormatStrFormatter("%g"))
        scale.set_minor_formatter(mpl.ticker.NullFormatter())
    axis.set_xticks(angle, [f"{each:g}" for each in angle])
    axis.set_xlabel("turn between the two views that give Tr [°]")
    axis.set_ylabel("error of the room [mm]")
    axis.set_title("The paper's method by the turn between the views of Tr; dashed: the paper's errors")
    axis.grid(alpha=0.3, which="both")
    axis.legend()


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
        paper: Those of the paper's method; None if it found no walls.
        paper_azimuth: The table's angle of each of them [deg].
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


SIDES = ("width", "length")
PAPER_MM = (3818.0, 6141.0)
LIMITS_MM = (0.5, 1.0)
"""Largest errors of the dimensions."""
HONEST = (0.8, 1.2)
"""Observed errors over predicted ones."""
OURS = {
    "boards": "ours, own protocol, boards alone",
    "recalibrated": "ours, own protocol, refined by the sweep",
    "same_views": "ours, the paper's views",
}
"""Our calibrations in words, by the keys of their metrics."""
_CALIBRATIONS = 3


class Measured(NamedTuple):
    """The room by all methods."""

    boards: list[Size]
    """Ours, own protocol, from boards alone."""
    again: list[Size]
    """Ours, own protocol, refined by the sweep."""
    same: list[Size]
    """Ours, the paper's views, of each draw."""
    paper: dict[str, list[Size]]
    """The paper's method with each stripe finder, of each draw."""
    pairs: list[PairAngle]


def run(stage: Stage) -> list[Metric]:
    """Figures and pictures of the room."""
    seen, known, truth = room(stage), draws(stage), true_size(stage)
    paths = our_calibrations(stage, _CALIBRATIONS)
    paper = {name: [_papers(seen, draw, name) for draw in known] for name in METHODS}
    stage.say("room by the paper's method")
    few = thinned(seen)
    boards, again = [], []
    for number, path in enumerate(paths):
        scanner = jaxscan.load_scanner(path)
        # All points for the pictures; planes through a tenth of them are as exact.
        middle = known[_middle(paper["gravity"], truth)]
        boards.append(_draw(stage, seen, scanner, middle) if number == 0 else _ours(stage, few, scanner))
        # Its compilation takes longer than the rest of a quick run.
        again += [] if stage.quick else [_ours(stage, few, recalibrated(stage, few, str(path)).scanner)]
        stage.say(f"room by calibration {number + 1} of {len(paths)}")
    same = [_ours(stage, few, jaxscan.load_scanner(draw.ours)) for draw in known]
    stage.say("room by calibrations from the paper's views")
    pairs = pair_angles(stage, known, seen.plain["gravity"], seen.angles)
    found = Measured(boards, again, same, paper, pairs)
    groups = {
        OURS["boards"]: boards,
        OURS["recalibrated"]: again,
        OURS["same_views"]: same,
        **{METHODS[name]: sizes for name, sizes in paper.items()},
    }
    title = f"The room of {truth.width:.0f} x {truth.length:.0f} mm, {stage.world} world: errors of its dimensions"
    draw_errors(stage.picture("figure_9_errors"), groups, pairs, truth, title)
    return [*_our_metrics(stage, found, truth), *_paper_metrics(found, truth)]


def _ours(stage: Stage, seen: Room, scanner: jaxscan.Scanner) -> Size:
    return size_of(box_of(our_cloud(stage, seen, scanner), scanner))


def _papers(seen: Room, draw: Draw, name: str) -> Size:
    return size_of(box_of(paper_points(draw.by(name), seen.plain[name], seen.angles)))


def _middle(sizes: list[Size], truth: Size) -> int:
    """The draw whose length has the median error; draws without walls come last."""
    return int(np.argsort([abs(size.length - truth.length) for size in sizes])[len(sizes) // 2])


def _draw(stage: Stage, seen: Room, scanner: jaxscan.Scanner, rival: Draw) -> Size:
    """The pictures of the room, and its size by all points."""
    cloud = our_cloud(stage, seen, scanner, normals=True)
    box = box_of(cloud, scanner)
    if box is None:
        return size_of(box)
    rgb = room_colours(stage, seen, cloud.xyz, scanner)
    survey = survey_of(cloud.xyz[cloud.valid], rgb[cloud.valid], box)
    there = paper_points(rival.paper, seen.plain["gravity"], seen.angles)
    walls = box_of(there)
    paper = None if walls is None else survey_of(there.xyz[there.valid], None, walls)
    azimuth = np.rad2deg(np.broadcast_to(there.angle[:, None], there.valid.shape)[there.valid])
    steps = f"{len(seen.angles)} steps, {stage.world} world"
    draw_plans(stage.picture("figure_9"), survey, paper, azimuth, f"The room from above, {steps}")
    sides = f"The walls of the room from within, {steps}"
    draw_elevations(stage.picture("figure_9_sides"), survey, len(seen.angles), sides)
    draw_view(stage.picture("figure_9_view"), cloud, rgb, max(1, len(seen.angles) // 900))
    return size_of(box)


def _our_metrics(stage: Stage, found: Measured, truth: Size) -> list[Metric]:
    """Errors, predicted sigmas, and one over the other."""
    out = []
    for name, sizes in (("boards", found.boards), ("recalibrated", found.again)):
        out += _ours_by(stage, name, sizes, truth) if sizes else []
    errors, sigmas = _table(found.same, truth)
    for side, letters in enumerate(SIDES):
        error, sigma = (rms(part[:, side]) for part in (errors, sigmas))
        key, ours = f"ours_same_views_{letters}", f"{OURS['same_views']}: {letters} of the room"
        spread = 3 / np.sqrt(2 * len(errors))
        label = f"{ours}, predicted standard deviation"
        out.append(Metric(f"{key}_rms", error, "mm", "less", spread * error, label=f"{ours}, rms error"))
        out.append(Metric(f"{key}_sigma", sigma, "mm", "less", 0.1 * sigma, label=label))
    # The prediction includes the prior of the table's errors. A world has one table, and the kind world an ideal one.
    low, high = (None, None) if stage.quick else HONEST
    label = f"{OURS['same_views']}: rms error of the room over predicted standard deviation, {len(errors)} draws"
    ratio = _ratio(errors, sigmas)
    out.append(Metric("ours_same_views_error_over_sigma", ratio, "1", "near", 0.4, low=low, high=high, label=label))
    return out


def _ours_by(stage: Stage, name: str, sizes: list[Size], truth: Size) -> list[Metric]:
    """By the calibrations of our own protocol."""
    out = []
    errors, sigmas = _table(sizes, truth)
    # Quick images have a quarter of the pixels.
    loose = 6.0 if stage.quick else 1.0
    for side, letters in enumerate(SIDES):
        limit = LIMITS_MM[side]
        worst, sigma = float(np.abs(errors[:, side]).max()), rms(sigmas[:, side])
        key, ours = f"ours_{name}_{letters}", f"{OURS[name]}: {letters} of the room"
        mean = float(np.mean(errors[:, side]) + truth[side])
        out.append(Metric(key, mean, "mm", "near", loose * limit, PAPER_MM[side], label=f"{ours}, mean"))
        reach, of_paper = None if stage.quick else limit, abs(PAPER_MM[side] - truth[side])
        label = f"{ours}, largest error of {len(sizes)} calibrations"
        tolerance = loose * limit / 2
        out.append(Metric(f"{key}_error", worst, "mm", "less", tolerance, of_paper, high=reach, label=label))
        label = f"{ours}, predicted standard deviation"
        out.append(Metric(f"{key}_sigma", sigma, "mm", "less", 0.1 * sigma, label=label))
    label = f"{OURS[name]}: rms error of the room over predicted standard deviation, {errors.size} values"
    out.append(Metric(f"ours_{name}_error_over_sigma", _ratio(errors, sigmas), "1", label=label))
    return out


def _ratio(errors: np.ndarray, sigmas: np.ndarray) -> float:
    """Root mean square of errors over their predicted sigmas; rooms that were not measured do not count."""
    return float(np.sqrt(np.nanmean((errors / sigmas) ** 2)))


def _paper_metrics(found: Measured, truth: Size) -> list[Metric]:
    """Distribution over the draws, and by the angle of the pair."""
    out = []
    for name, sizes in found.paper.items():
        errors, _ = _table(sizes, truth)
        lost = int(np.count_nonzero(~np.isfinite(errors[:, 0])))
        out.append(
            Metric(f"paper_way_{name}_not_measured", lost, "draws", label=f"{METHODS[name]}: rooms without walls")
        )
        for side, letters in enumerate(SIDES):
            some = errors[np.isfinite(errors[:, side]), side]
            room_side, key = f"{METHODS[name]}: {letters} of the room", f"paper_way_{name}_{letters}"
            parts = np.percentile(some, [25, 50, 75]) if len(some) else np.full(3, np.nan)
            for word, part in zip(("lower_quartile", "median", "upper_quartile"), parts, strict=True):
                value, label = float(part + truth[side]), f"{room_side}, {word.replace('_', ' ')} of {len(some)} draws"
                out.append(Metric(f"{key}_{word}", value, "mm", paper=PAPER_MM[side], label=label))
            of_paper = abs(PAPER_MM[side] - truth[side])
            out.append(Metric(f"{key}_rms", rms(some), "mm", paper=of_paper, label=f"{room_side}, rms error"))
    return out + _pair_metrics(found.pairs, truth)


def _pair_metrics(pairs: list[PairAngle], truth: Size) -> list[Metric]:
    """Errors against the turn between the views of Tr, and the turns that explain the paper's errors."""
    out = []
    whole, scatter = np.array([[pair.rms(truth), pair.scatter(truth)] for pair in pairs]).transpose(1, 0, 2)
    for side, letters in enumerate(SIDES):
        for pair, error, alone in zip(pairs, whole[:, side], scatter[:, side], strict=True):
            key = f"pair_{pair.angle_deg:g}_{letters}"
            place = f"Tr from a turn of {pair.angle_deg:g}°, board at {pair.depth_m:.2f} m"
            label = f"{METHODS['gravity']}, {place}: {letters} of the room"
            out.append(Metric(f"{key}_rms", float(error), "mm", label=f"{label}, rms error"))
            by_noise = f"{label}, standard deviation by the noise of these two views"
            out.append(Metric(f"{key}_scatter", float(alone), "mm", label=by_noise))
        wanted = abs(PAPER_MM[side] - truth[side])
        turns = np.array([pair.angle_deg for pair in pairs])
        for key, values, word in (("", scatter, "standard deviation"), ("_rms", whole, "rms error")):
            angle = smallest_angle(turns, values[:, side], wanted)
            if np.isfinite(angle):
                limit = f"{word} of the room's {letters} falls to {wanted:g} mm, by a power law"
                label = f"{METHODS['gravity']}: smallest turn between the two views of Tr at which the {limit}"
                out.append(Metric(f"pair_angle_for_{letters}{key}", angle, "°", label=label))
    return out


def _table(sizes: list[Size], truth: Size) -> tuple[np.ndarray, np.ndarray]:
    """Errors and predicted sigmas of width and length [n, 2], mm."""
    return np.array([size.errors(truth) for size in sizes]), np.array([size.sigmas() for size in sizes])
