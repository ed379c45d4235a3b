"""Figure 9: the room of 3820 x 6150 mm, scanned all around and measured from its cloud, wall to wall by planes.

All methods measure the same sweep. Ours has calibrations from boards by our own protocol, the same refined by the walls
of the sweep, and calibrations from the paper's 23 views. The paper's method has calibrations from those same views, in
all draws of their noise.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

import jaxscan
from experiments.paper.methods import METHODS, PaperWay, paper_cloud
from experiments.paper.products import Draw, PlainStripes, Room, draws, our_calibrations, room, room_colours, room_sweep
from experiments.paper.stage import Metric, Stage, plt, save
from experiments.report import rms
from jaxscan import recalibration
from jaxscan.measurement.room import RoomBox
from jaxscan.reconstruction import plan_sweep, smooth_stripes
from jaxscan.report.clouds import draw_cloud


PROFILES, ROWS = 360, 200
"""Points of a thinned cloud, about: enough for planes, and thirty clouds take little time."""
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
        """Errors of width and length [2]."""
        return np.array(self[:2]) - np.array(truth[:2])

    def sigmas(self) -> np.ndarray:
        """Predicted standard deviations of width and length [2]."""
        return np.array(self[2:])


NOT_MEASURED = Size(np.nan, np.nan)


def true_size(stage: Stage) -> Size:
    """Size of the configuration's room."""
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
        angles: Angles of the table [records], rad.
    """
    far = np.linalg.norm(xyz, axis=-1)
    valid = np.isfinite(far) & (far < FARTHEST_M)
    sigma = np.where(valid, _SIGMA_M * (far / _SIGMA_AT_M) ** 2, 0.0)
    lasers = np.zeros(len(xyz), np.uint8)
    return Points(np.where(valid[..., None], xyz, 0.0), sigma, valid, lasers, np.asarray(angles))


def draw_room(path: Path, title: str, clouds: dict[str, tuple[np.ndarray, np.ndarray]]) -> None:
    """Rooms, cut open: points [profiles, rows, 3], m, zero where there is none, and their colours, by a title each."""
    figure, axes = plt.subplots(1, len(clouds), figsize=(7 * len(clouds), 6.3), layout="constrained")
    for axis, (name, (xyz, rgb)) in zip(axes, clouds.items(), strict=True):
        axis.imshow(draw_cloud(xyz.astype(np.float32), rgb, size=(900, 760)))
        axis.set_title(name)
        axis.set_axis_off()
    figure.suptitle(title, fontsize=14)
    save(figure, path, 110)


def shades(values: np.ndarray, colours: str) -> np.ndarray:
    """Values as colours [..., 3], uint8, over the range that nearly all of them have."""
    low, high = np.nanpercentile(values, [1, 99])
    return (255 * plt.get_cmap(colours)((np.nan_to_num(values) - low) / (high - low))[..., :3]).astype(np.uint8)


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
    """Figures of the room, and its picture."""
    seen, known, truth = room(stage), draws(stage), true_size(stage)
    paper = {name: [_papers(seen, draw, name) for draw in known] for name in METHODS}
    stage.say("room by the paper's method")
    middle = known[_middle(paper["gravity"], truth)]
    few = thinned(seen)
    boards, again = [], []
    for number, path in enumerate(our_calibrations(stage)):
        scanner = jaxscan.load_scanner(path)
        # All points for the picture; planes through a tenth of them are as exact.
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
    """The picture of the room, and its size by all points."""
    cloud = our_cloud(stage, seen, scanner)
    box = box_of(cloud, scanner)
    if box is None:
        return NOT_MEASURED
    rgb = room_colours(stage, seen, cloud.xyz, scanner)
    # Neighbouring profiles and rows are joined in the picture.
    some = np.s_[:: max(1, len(seen.angles) // 900), ::4]
    xyz = np.where(cloud.valid[..., None], cloud.xyz, 0.0)[some]
    size, there = size_of(box), paper_points(rival.paper, seen.plain["gravity"], seen.angles)
    by = size_of(box_of(there))
    turned = np.broadcast_to(there.angle[:, None], there.valid.shape)
    clouds = {
        "Ours, without colour: by height": (xyz, shades(np.where(cloud.valid[some], xyz[..., 2], np.nan), "viridis")),
        f"Ours, with colour: {size.width:.1f} x {size.length:.1f} mm": (xyz, rgb[some]),
        f"The paper's method, the draw of median error, by table angle: {by.width:.0f} x {by.length:.0f} mm": (
            there.xyz,
            shades(turned, "twilight"),
        ),
    }
    title = f"The room, cut open: {len(seen.angles)} steps, {stage.world} world"
    draw_room(stage.picture("figure_9"), title, clouds)
    return size


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
