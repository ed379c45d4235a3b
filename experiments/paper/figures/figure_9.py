"""Figure 9: the room of 3820 x 6150 mm, scanned all around and measured from its cloud, wall to wall by planes.

All methods measure the same sweep. Ours has calibrations from boards by our own protocol, the same refined by the walls
of the sweep, and calibrations from the paper's 23 views. The paper's method has calibrations from those same views, in
all draws of their noise. A last series takes Tr from two views that are farther apart: which turn explains the paper's
errors?
"""

from typing import NamedTuple

import numpy as np

import jaxscan
from experiments.paper.figures.pair_angles import PairAngle, pair_angles, smallest_angle
from experiments.paper.figures.room_clouds import (
    Size,
    box_of,
    our_cloud,
    paper_points,
    recalibrated,
    size_of,
    thinned,
    true_size,
)
from experiments.paper.figures.room_errors import draw_errors
from experiments.paper.figures.room_pictures import draw_elevations, draw_plans, draw_view, survey_of
from experiments.paper.methods.plain_stripes import METHODS
from experiments.paper.metrics import Metric, rms
from experiments.paper.products.colours import room_colours
from experiments.paper.products.draws import Draw, draws, our_calibrations
from experiments.paper.products.room import Room, room
from experiments.paper.stage import Stage


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
