"""Figure 9: the room of 3820 x 6150 mm, scanned all around and measured from its cloud, wall to wall by planes.

All methods measure the same sweep. Ours has calibrations from boards by our own protocol, the same refined by the walls
of the sweep, and calibrations from the paper's 23 views. The paper's method has calibrations from those same views, in
all draws of their noise.
"""

from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from scipy.ndimage import distance_transform_edt  # type: ignore[import-untyped]

import jaxscan
from experiments.paper.methods import METHODS, PaperWay, paper_cloud
from experiments.paper.products import (
    Draw,
    PlainStripes,
    Room,
    draws,
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


def our_cloud(stage: Stage, room: Room, scanner: jaxscan.Scanner) -> jaxscan.PointCloud:
    """The room by one of our calibrations; no frame is read."""
    settings = jaxscan.ReconstructSettings(normals=False)
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
    """Points [n, 3] turned so that the measured walls run along the axes; without colours all are grey."""
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
    """Draw top views: ours by height and with colour, and that of the paper's method by table angle [deg]."""
    figure, axes = plt.subplots(1, 3, figsize=(17, 9.2), constrained_layout=True)
    figure.suptitle(title, fontsize=15)
    low, high = np.percentile(ours.xyz[:, 2], [1, 99])
    shown = _plan(axes[0], ours, ours.xyz[:, 2], "viridis", (low, high))
    axes[0].set_title("Ours, without colour: by height")
    figure.colorbar(shown, ax=axes[0], shrink=0.4, label="height above the scanner [m]")
    _plan(axes[1], ours, ours.rgb, None, (0, 1))
    axes[1].set_title("Ours, with colour")
    if paper is None:
        axes[2].axis("off")
    else:
        shown = _plan(axes[2], paper, paper_azimuth, "twilight", (0, 360))
        axes[2].set_title("The paper's method, the draw of median error: by table angle")
        figure.colorbar(shown, ax=axes[2], shrink=0.4, label="angle of the table [°]")
    save(figure, path, 110)


def draw_elevations(path: Path, ours: Survey, steps: int, title: str) -> None:
    """Side views of all four walls, from within: without colour, by the distance before the wall, and with colour."""
    low, high = np.percentile(ours.xyz[:, 2], [0.2, 99.8])
    reach = max(ours.length_m, ours.width_m) / 2 + 0.1
    gap = FAR_M * 2 * np.pi / steps
    figure, axes = plt.subplots(4, 2, figsize=(18, 12.5), sharex=True, sharey=True, constrained_layout=True)
    figure.suptitle(title, fontsize=15)
    for row, (name, side) in zip(axes, (("x", 1.0), ("y", 1.0), ("x", -1.0), ("y", -1.0)), strict=True):
        across = "xy".index(name)
        depth = (ours.width_m if name == "x" else ours.length_m) / 2 - side * ours.xyz[:, across]
        # Seen from within, with the wall ahead: to the right is -y before +x, and +x before +y.
        right = ours.xyz[:, 1 - across] * (-side if name == "x" else side)
        half = (ours.length_m if name == "x" else ours.width_m) / 2
        kept = (np.abs(depth) < IN_FRONT_M) & (np.abs(right) < half + 0.05)
        at = np.column_stack([right[kept], ours.xyz[kept, 2]])
        extent = (-half - 0.05, half + 0.05, low, high)
        shown = _front(row[0], at, 1e3 * depth[kept], extent, gap, coloured=False)
        _front(row[1], at, ours.rgb[kept], extent, gap, coloured=True)
        row[0].set_ylabel(f"wall at {'+' if side > 0 else '-'}{name}: height [m]")
    figure.colorbar(shown, ax=axes, location="bottom", shrink=0.35, aspect=40, label="before the wall [mm]")
    axes[0, 0].set(xlim=(-reach, reach), title="Without colour: by distance before the wall")
    axes[0, 1].set_title("With colour")
    for axis in axes[-1]:
        axis.set_xlabel("along the wall [m]")
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
    axis: Axes, survey: Survey, values: np.ndarray, colours: str | None, limits: tuple[float, float]
) -> mpl.cm.ScalarMappable:
    """Points from above, the denser the darker, with the measured dimensions; values are RGB without `colours`."""
    x, y = survey.width_m / 2, survey.length_m / 2
    extent = (-x - MARGIN_M, x + MARGIN_M, -y - MARGIN_M, y + MARGIN_M)
    mean, count = _raster(survey.xyz[:, :2], values, extent, PLAN_M)
    scale = mpl.cm.ScalarMappable(mpl.colors.Normalize(*limits), colours)
    strength = np.clip(np.log1p(count) / np.log1p(np.percentile(count[count > 0], 90)), 0, 1)
    picture = _brightened(mean) if colours is None else scale.to_rgba(np.nan_to_num(mean[..., 0]))[..., :3]
    alpha = np.where(count > 0, 0.15 + 0.85 * strength, 0)
    axis.imshow(np.dstack([picture, alpha]), extent=extent, origin="lower", interpolation="nearest")
    axis.plot(*survey.rig_m, "+", color="crimson", markersize=11)
    axis.annotate("scanner", survey.rig_m, xytext=(6, 6), textcoords="offset points", color="crimson", fontsize=9)
    axis.set(aspect="equal", xlabel="across the room [m]", ylabel="along the room [m]")
    line = {"arrowstyle": "<->", "color": _INK, "lw": 1.2, "shrinkA": 0, "shrinkB": 0}
    axis.annotate("", (-x, -0.3 * y), (x, -0.3 * y), arrowprops=line)
    axis.annotate("", (0.3 * x, -y), (0.3 * x, y), arrowprops=line)
    box = {"boxstyle": "round,pad=0.25", "fc": "white", "ec": "none", "alpha": 0.85}
    text = {"ha": "center", "va": "center", "fontsize": 12, "color": _INK, "bbox": box}
    axis.text(-0.35 * x, -0.3 * y, f"{1e3 * survey.width_m:.1f} mm", **text)
    axis.text(0.3 * x, 0.35 * y, f"{1e3 * survey.length_m:.1f} mm", rotation=90, **text)
    return scale


def _front(
    axis: Axes,
    at: np.ndarray,
    values: np.ndarray,
    extent: tuple[float, float, float, float],
    gap_m: float,
    *,
    coloured: bool,
) -> mpl.cm.ScalarMappable:
    """Points from the front; a pixel has the mean of its points."""
    mean, count = _raster(at, values, extent, FRONT_M)
    # Gaps between profiles take the nearest points.
    distance, nearest = distance_transform_edt(count == 0, return_indices=True)
    mean, there = mean[tuple(nearest)], distance <= 1 + gap_m / 2 / FRONT_M
    axis.set(facecolor="0.93", aspect="equal")
    if coloured:
        return axis.imshow(np.dstack([_brightened(mean), there.astype(float)]), extent=extent, origin="lower")
    image = np.where(there, mean[..., 0], np.nan)
    return axis.imshow(image, extent=extent, origin="lower", cmap="cividis", vmin=-10, vmax=250)


def _brightened(mean: np.ndarray) -> np.ndarray:
    """Colours [..., 3] of 0 ... 1: as bright as a print wants them."""
    seen = mean[np.isfinite(mean)]
    top = np.percentile(seen, 99.5) if len(seen) else 1.0
    return np.clip(np.nan_to_num(mean) / max(top, 1.0), 0, 1)


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


def run(stage: Stage) -> list[Metric]:
    """Figures and pictures of the room."""
    seen, known, truth = room(stage), draws(stage), true_size(stage)
    paper = {name: [_papers(seen, draw, name) for draw in known] for name in METHODS}
    stage.say("room by the paper's method")
    middle = known[_middle(paper["gravity"], truth)]
    few = thinned(seen)
    boards, again = [], []
    for number, path in enumerate(our_calibrations(stage)):
        scanner = jaxscan.load_scanner(path)
        # All points for the pictures; planes through a tenth of them are as exact.
        boards.append(_draw(stage, seen, scanner, middle) if number == 0 else _ours(stage, few, scanner))
        # Its compilation takes longer than the rest of a quick run.
        again += [] if stage.quick else [_ours(stage, few, recalibrated(stage, few, str(path)).scanner)]
        stage.say(f"room by calibration {number + 1}")
    same = [_ours(stage, few, jaxscan.load_scanner(draw.ours)) for draw in known]
    metrics = _own_protocol(stage, "boards", boards, truth)
    metrics += _own_protocol(stage, "recalibrated", again, truth) if again else []
    return [*metrics, *_same_views(stage, same, truth), *_paper_metrics(paper, truth)]


def _ours(stage: Stage, seen: Room, scanner: jaxscan.Scanner) -> Size:
    return size_of(box_of(our_cloud(stage, seen, scanner), scanner))


def _papers(seen: Room, draw: Draw, name: str) -> Size:
    return size_of(box_of(paper_points(draw.by(name), seen.plain[name], seen.angles)))


def _middle(sizes: list[Size], truth: Size) -> int:
    """The draw whose length has the median error; draws without walls come last."""
    return int(np.argsort([abs(size.length - truth.length) for size in sizes])[len(sizes) // 2])


def _draw(stage: Stage, seen: Room, scanner: jaxscan.Scanner, rival: Draw) -> Size:
    """The pictures of the room, and its size by all points."""
    cloud = our_cloud(stage, seen, scanner)
    box = box_of(cloud, scanner)
    if box is None:
        return NOT_MEASURED
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
    return size_of(box)


def _table(sizes: list[Size], truth: Size) -> tuple[np.ndarray, np.ndarray]:
    """Errors and predicted sigmas of width and length [n, 2], mm."""
    return np.array([size.errors(truth) for size in sizes]), np.array([size.sigmas() for size in sizes])


def _ratio(errors: np.ndarray, sigmas: np.ndarray) -> float:
    """Root mean square of errors over their predicted sigmas; rooms that were not measured do not count."""
    return float(np.sqrt(np.nanmean((errors / sigmas) ** 2)))


def _same_views(stage: Stage, sizes: list[Size], truth: Size) -> list[Metric]:
    """Errors by our calibrations of the paper's views, and one over the predicted sigmas."""
    errors, sigmas = _table(sizes, truth)
    out = []
    for side, letters in enumerate(SIDES):
        error, sigma = (rms(part[:, side]) for part in (errors, sigmas))
        key, ours = f"ours_same_views_{letters}", f"{OURS['same_views']}: {letters} of the room"
        tolerance = 3 / np.sqrt(2 * len(errors)) * error
        label = f"{ours}, predicted standard deviation"
        out.append(Metric(f"{key}_rms", error, "mm", "less", tolerance, label=f"{ours}, rms error"))
        out.append(Metric(f"{key}_sigma", sigma, "mm", "less", 0.1 * sigma, label=label))
    # The prediction includes the prior of the table's errors. A world has one table, and the kind world an ideal one.
    low, high = (None, None) if stage.quick else HONEST
    label = f"{OURS['same_views']}: rms error of the room over predicted standard deviation, {len(errors)} draws"
    ratio = _ratio(errors, sigmas)
    out.append(Metric("ours_same_views_error_over_sigma", ratio, "1", "near", 0.4, low=low, high=high, label=label))
    return out


def _own_protocol(stage: Stage, name: str, sizes: list[Size], truth: Size) -> list[Metric]:
    """Largest errors by the calibrations of our own protocol, and predicted sigmas."""
    errors, sigmas = _table(sizes, truth)
    # Quick images have a quarter of the pixels.
    loose = 6.0 if stage.quick else 1.0
    out = []
    for side, (letters, limit) in enumerate(zip(SIDES, LIMITS_MM, strict=True)):
        key, ours = f"ours_{name}_{letters}", f"{OURS[name]}: {letters} of the room"
        mean, worst = float(np.mean(errors[:, side]) + truth[side]), float(np.abs(errors[:, side]).max())
        sigma, of_paper = rms(sigmas[:, side]), abs(PAPER_MM[side] - truth[side])
        reach = None if stage.quick else limit
        label = f"{ours}, largest error of {len(sizes)} calibrations"
        out += [
            Metric(key, mean, "mm", "near", loose * limit, PAPER_MM[side], label=f"{ours}, mean"),
            Metric(f"{key}_error", worst, "mm", "less", loose * limit / 2, of_paper, high=reach, label=label),
            Metric(f"{key}_sigma", sigma, "mm", "less", 0.1 * sigma, label=f"{ours}, predicted standard deviation"),
        ]
    label = f"{OURS[name]}: rms error of the room over predicted standard deviation, {errors.size} values"
    return [*out, Metric(f"ours_{name}_error_over_sigma", _ratio(errors, sigmas), "1", label=label)]


def _paper_metrics(paper: dict[str, list[Size]], truth: Size) -> list[Metric]:
    """Distribution over the draws of the paper's method, by stripe finder."""
    out = []
    for name, sizes in paper.items():
        errors, _ = _table(sizes, truth)
        lost = int(np.count_nonzero(~np.isfinite(errors[:, 0])))
        words = METHODS[name]
        out.append(Metric(f"paper_way_{name}_not_measured", lost, "draws", label=f"{words}: rooms without walls"))
        for side, letters in enumerate(SIDES):
            some = errors[np.isfinite(errors[:, side]), side]
            room_side, key = f"{words}: {letters} of the room", f"paper_way_{name}_{letters}"
            parts = np.percentile(some, [25, 50, 75]) if len(some) else np.full(3, np.nan)
            for word, part in zip(("lower_quartile", "median", "upper_quartile"), parts, strict=True):
                value, label = float(part + truth[side]), f"{room_side}, {word.replace('_', ' ')} of {len(some)} draws"
                out.append(Metric(f"{key}_{word}", value, "mm", paper=PAPER_MM[side], label=label))
            of_paper = abs(PAPER_MM[side] - truth[side])
            out.append(Metric(f"{key}_rms", rms(some), "mm", paper=of_paper, label=f"{room_side}, rms error"))
    return out
