"""Figure 9: the room of 3820 x 6150 mm, scanned all around and measured from its cloud, wall to wall by planes.

Ours with calibrations from boards alone, by our protocol, and again after each was refined by the walls of the sweep;
ours from the paper's 23 views; and the paper's way from those same views, over all draws of their noise. All measure
the same sweep. Then the paper's way with its Tr from two views that are farther apart, to see which turn explains the
errors that the paper reports.
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
from experiments.paper.metrics import Metric
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
_CALIBRATIONS = 3


class Measured(NamedTuple):
    """The room by all that measure it."""

    boards: list[Size]
    """Ours, by our protocol alone."""
    again: list[Size]
    """Ours, refined by the sweep."""
    same: list[Size]
    """Ours, from the paper's views; of each draw."""
    paper: dict[str, list[Size]]
    """The paper's way with either extractor; of each draw."""
    pairs: list[PairAngle]


def run(stage: Stage) -> list[Metric]:
    """Measure, draw, compare."""
    seen, known, truth = room(stage), draws(stage), true_size(stage)
    paths = our_calibrations(stage, _CALIBRATIONS)
    paper = {name: [_papers(seen, draw, name) for draw in known] for name in seen.plain}
    stage.say("room by the paper's way")
    few = thinned(seen)
    boards, again = [], []
    for number, path in enumerate(paths):
        scanner = jaxscan.load_scanner(path)
        # All points once; planes through a tenth of them are as good.
        middle = known[_middle(paper["gravity"], truth)]
        boards.append(_draw(stage, seen, scanner, middle) if number == 0 else _ours(stage, few, scanner))
        # Compiling takes longer than all the rest of a quick run.
        again += [] if stage.quick else [_ours(stage, few, recalibrated(stage, few, str(path)).scanner)]
        stage.say(f"room by calibration {number + 1} of {len(paths)}")
    same = [_ours(stage, few, jaxscan.load_scanner(draw.ours)) for draw in known]
    stage.say("room by calibrations from the paper's views")
    pairs = pair_angles(stage, known, seen.plain["gravity"], seen.angles)
    found = Measured(boards, again, same, paper, pairs)
    groups = {
        "ours, boards alone": boards,
        "ours, refined by the sweep": again,
        "ours, the paper's 23 views": same,
        "paper's way, centre of gravity": paper["gravity"],
        "paper's way, highest pixel": paper["highest"],
    }
    title = f"The room of {truth.width:.0f} x {truth.length:.0f} mm, {stage.world} world: errors of its dimensions"
    draw_errors(stage.picture("figure_9_errors"), groups, pairs, truth, title)
    return [*_our_metrics(stage, found, truth), *_paper_metrics(found, truth)]


def _ours(stage: Stage, seen: Room, scanner: jaxscan.Scanner) -> Size:
    return size_of(box_of(our_cloud(stage, seen, scanner), scanner))


def _papers(seen: Room, draw: Draw, name: str) -> Size:
    return size_of(box_of(paper_points(draw.by(name), seen.plain[name], seen.angles)))


def _middle(sizes: list[Size], truth: Size) -> int:
    """The draw whose length has the median error; those without walls come last."""
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
    ways = (("boards", found.boards, "boards alone"), ("recalibrated", found.again, "refined by the sweep"))
    out = []
    for name, sizes, words in ways:
        out += _ours_by(stage, name, sizes, words, truth) if sizes else []
    errors, sigmas = _table(found.same, truth)
    for side, letters in enumerate(SIDES):
        rms, sigma = (float(np.sqrt(np.mean(part[:, side] ** 2))) for part in (errors, sigmas))
        key, ours = f"ours_same_views_{letters}", f"room's {letters}, ours from the paper's 23 views"
        spread = 3 / np.sqrt(2 * len(errors))
        out.append(Metric(f"{key}_rms", rms, "mm", "less", spread * rms, label=f"{ours}: rms error"))
        out.append(Metric(f"{key}_sigma", sigma, "mm", "less", 0.1 * sigma, label=f"{ours}: predicted"))
    # The prediction covers any table; the one of a world is the same in all draws, and in the kind world it is ideal.
    low, high = (None, None) if stage.quick else HONEST
    label = f"room, ours from the paper's 23 views: rms error over predicted, {len(errors)} draws"
    ratio = _ratio(errors, sigmas)
    out.append(Metric("ours_same_views_error_over_sigma", ratio, "1", "near", 0.4, low=low, high=high, label=label))
    return out


def _ours_by(stage: Stage, name: str, sizes: list[Size], words: str, truth: Size) -> list[Metric]:
    """By the calibrations of our protocol."""
    out = []
    errors, sigmas = _table(sizes, truth)
    # Quick images have a quarter of the pixels.
    loose = 6.0 if stage.quick else 1.0
    for side, letters in enumerate(SIDES):
        limit = LIMITS_MM[side]
        worst, sigma = float(np.abs(errors[:, side]).max()), float(np.sqrt(np.mean(sigmas[:, side] ** 2)))
        key, ours = f"ours_{name}_{letters}", f"room's {letters}, ours, {words}"
        mean = float(np.mean(errors[:, side]) + truth[side])
        out.append(Metric(key, mean, "mm", "near", loose * limit, PAPER_MM[side], label=ours))
        reach, of_paper = None if stage.quick else limit, abs(PAPER_MM[side] - truth[side])
        label = f"{ours}: largest error of {len(sizes)} calibrations"
        tolerance = loose * limit / 2
        out.append(Metric(f"{key}_error", worst, "mm", "less", tolerance, of_paper, high=reach, label=label))
        out.append(Metric(f"{key}_sigma", sigma, "mm", "less", 0.1 * sigma, label=f"{ours}: predicted"))
    label = f"room, ours, {words}: rms error over predicted, {errors.size} values"
    out.append(Metric(f"ours_{name}_error_over_sigma", _ratio(errors, sigmas), "1", label=label))
    return out


def _ratio(errors: np.ndarray, sigmas: np.ndarray) -> float:
    """Root mean square of errors over their predicted sigmas; of those that were measured."""
    return float(np.sqrt(np.nanmean((errors / sigmas) ** 2)))


def _paper_metrics(found: Measured, truth: Size) -> list[Metric]:
    """Distribution over the draws, and by the angle of the pair."""
    out = []
    for name, sizes in found.paper.items():
        errors, _ = _table(sizes, truth)
        way = f"the paper's way ({'centre of gravity' if name == 'gravity' else 'highest pixel'})"
        lost = int(np.count_nonzero(~np.isfinite(errors[:, 0])))
        out.append(Metric(f"paper_way_{name}_not_measured", lost, "draws", label=f"rooms without walls, {way}"))
        for side, letters in enumerate(SIDES):
            some = errors[np.isfinite(errors[:, side]), side]
            room_side, key = f"room's {letters}, {way}", f"paper_way_{name}_{letters}"
            parts = np.percentile(some, [25, 50, 75]) if len(some) else np.full(3, np.nan)
            for word, part in zip(("lower_quartile", "median", "upper_quartile"), parts, strict=True):
                value, label = float(part + truth[side]), f"{room_side}, {len(some)} draws: {word.replace('_', ' ')}"
                out.append(Metric(f"{key}_{word}", value, "mm", paper=PAPER_MM[side], label=label))
            rms = float(np.sqrt(np.mean(some**2))) if len(some) else np.nan
            of_paper = abs(PAPER_MM[side] - truth[side])
            out.append(Metric(f"{key}_rms", rms, "mm", paper=of_paper, label=f"{room_side}: rms error"))
    return out + _pair_metrics(found.pairs, truth)


def _pair_metrics(pairs: list[PairAngle], truth: Size) -> list[Metric]:
    """Errors by the angle of the pair, and the angles that explain those of the paper."""
    out = []
    rms, scatter = np.array([[pair.rms(truth), pair.scatter(truth)] for pair in pairs]).transpose(1, 0, 2)
    for side, letters in enumerate(SIDES):
        for pair, whole, alone in zip(pairs, rms[:, side], scatter[:, side], strict=True):
            key = f"pair_{pair.angle_deg:g}_{letters}"
            label = f"room's {letters}, Tr from {pair.angle_deg:g}°, board at {pair.depth_m:.2f} m"
            out.append(Metric(f"{key}_rms", float(whole), "mm", label=f"{label}: rms error"))
            out.append(Metric(f"{key}_scatter", float(alone), "mm", label=f"{label}: scatter by the pair's noise"))
        error = abs(PAPER_MM[side] - truth[side])
        angle = smallest_angle(pairs, scatter[:, side], error)
        label = (
            f"turn between the two views of Tr from which on their noise moves the {letters} by {error:g} mm or less"
        )
        out.append(Metric(f"pair_angle_for_{letters}", angle, "°", label=label))
    return out


def _table(sizes: list[Size], truth: Size) -> tuple[np.ndarray, np.ndarray]:
    """Errors and predicted sigmas of width and length [n, 2], mm."""
    return np.array([size.errors(truth) for size in sizes]), np.array([size.sigmas() for size in sizes])
