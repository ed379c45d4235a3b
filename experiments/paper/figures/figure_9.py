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
    few = thinned(seen)
    boards, again = [], []
    for number, path in enumerate(paths):
        scanner = jaxscan.load_scanner(path)
        # All points once; planes through a tenth of them are as good.
        boards.append(_draw(stage, seen, scanner, known) if number == 0 else _ours(stage, few, scanner))
        again.append(_ours(stage, few, recalibrated(stage, few, str(path)).scanner))
        stage.say(f"room by calibration {number + 1} of {len(paths)}")
    same = [_ours(stage, few, jaxscan.load_scanner(draw.ours)) for draw in known]
    paper = {name: [_papers(seen, draw, name) for draw in known] for name in seen.plain}
    stage.say("room by the paper's way")
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
    return [*_our_metrics(stage, found, truth), *_paper_metrics(stage, found, truth)]


def _ours(stage: Stage, seen: Room, scanner: jaxscan.Scanner) -> Size:
    return size_of(box_of(our_cloud(stage, seen, scanner), scanner))


def _papers(seen: Room, draw: Draw, name: str) -> Size:
    way = draw.paper if name == "gravity" else draw.highest
    return size_of(box_of(paper_points(way, seen.plain[name], seen.angles)))


def _draw(stage: Stage, seen: Room, scanner: jaxscan.Scanner, known: list[Draw]) -> Size:
    """The pictures of the room, and its size by all points."""
    cloud = our_cloud(stage, seen, scanner, normals=True)
    box = box_of(cloud, scanner)
    size = size_of(box)
    if box is None:
        return size
    points = cloud.points()
    survey = survey_of(points.xyz, points.rgb, box)
    rivals = [paper_points(draw.paper, seen.plain["gravity"], seen.angles) for draw in known[: 1 if stage.quick else 9]]
    boxes = [box_of(each) for each in rivals]
    error = [abs(size_of(each).length - size.length) for each in boxes]
    paper, azimuth = None, np.zeros(0)
    if np.isfinite(error).any():
        middle = int(np.argsort(error)[np.isfinite(error).sum() // 2])
        there, rival = rivals[middle], boxes[middle]
        assert rival is not None
        paper = survey_of(there.xyz[there.valid], None, rival)
        azimuth = np.rad2deg(np.broadcast_to(there.angle[:, None], there.valid.shape)[there.valid])
    steps = f"{len(seen.angles)} steps, {stage.world} world"
    draw_plans(stage.picture("figure_9"), survey, paper, azimuth, f"The room from above, {steps}")
    draw_elevations(stage.picture("figure_9_sides"), survey, f"The walls of the room from within, {steps}")
    draw_view(stage.picture("figure_9_view"), cloud, max(1, len(seen.angles) // 900))
    return size


def _our_metrics(stage: Stage, found: Measured, truth: Size) -> list[Metric]:
    """Errors, predicted sigmas, and one over the other."""
    out = []
    loose = 6.0 if stage.quick else 1.0
    ways = (("boards", found.boards, "boards alone"), ("recalibrated", found.again, "refined by the sweep"))
    for name, sizes, words in ways:
        errors, sigmas = _table(sizes, truth)
        for side, letters in enumerate(SIDES):
            limit = None if stage.quick else LIMITS_MM[side]
            mean = float(np.mean(errors[:, side]) + truth[side])
            worst, sigma = float(np.abs(errors[:, side]).max()), float(np.sqrt(np.mean(sigmas[:, side] ** 2)))
            ours = f"room's {letters}, ours, {words}"
            key = f"ours_{name}_{letters}"
            out += [
                Metric(key, mean, "mm", "near", loose * LIMITS_MM[side], PAPER_MM[side], label=ours),
                Metric(
                    f"{key}_error",
                    worst,
                    "mm",
                    "less",
                    loose * LIMITS_MM[side] / 2,
                    abs(PAPER_MM[side] - truth[side]),
                    high=limit,
                    label=f"{ours}: largest error of {len(sizes)} calibrations",
                ),
                Metric(f"{key}_sigma", sigma, "mm", "less", 0.1 * sigma, label=f"{ours}: predicted"),
            ]
        ratio = float(np.sqrt(np.mean((errors / sigmas) ** 2)))
        out.append(
            Metric(
                f"ours_{name}_error_over_sigma",
                ratio,
                "1",
                "none",
                label=f"room, ours, {words}: rms error over predicted, {errors.size} values",
            )
        )
    errors, sigmas = _table(found.same, truth)
    for side, letters in enumerate(SIDES):
        rms, sigma = (float(np.sqrt(np.mean(part[:, side] ** 2))) for part in (errors, sigmas))
        ours = f"room's {letters}, ours from the paper's 23 views"
        spread = 3 / np.sqrt(2 * len(errors))
        out += [
            Metric(f"ours_same_views_{letters}_rms", rms, "mm", "less", spread * rms, label=f"{ours}: rms error"),
            Metric(f"ours_same_views_{letters}_sigma", sigma, "mm", "less", 0.1 * sigma, label=f"{ours}: predicted"),
        ]
    ratio = float(np.sqrt(np.mean((errors / sigmas) ** 2)))
    low, high = (None, None) if stage.quick else HONEST
    out.append(
        Metric(
            "ours_same_views_error_over_sigma",
            ratio,
            "1",
            "near",
            0.4,
            low=low,
            high=high,
            label=f"room, ours from the paper's 23 views: rms error over predicted, {len(errors)} draws",
        )
    )
    return out


def _paper_metrics(stage: Stage, found: Measured, truth: Size) -> list[Metric]:
    """Distribution over the draws, and by the angle of the pair."""
    out = []
    for name, sizes in found.paper.items():
        errors, _ = _table(sizes, truth)
        way = f"the paper's way ({'centre of gravity' if name == 'gravity' else 'highest pixel'})"
        lost = int(np.count_nonzero(~np.isfinite(errors[:, 0])))
        out.append(Metric(f"paper_way_{name}_not_measured", lost, "draws", label=f"rooms without walls, {way}"))
        for side, letters in enumerate(SIDES):
            some = errors[np.isfinite(errors[:, side]), side]
            parts = np.percentile(some, [25, 50, 75]) if len(some) else np.full(3, np.nan)
            for word, part in zip(("lower_quartile", "median", "upper_quartile"), parts, strict=True):
                out.append(
                    Metric(
                        f"paper_way_{name}_{letters}_{word}",
                        float(part + truth[side]),
                        "mm",
                        paper=PAPER_MM[side],
                        label=f"room's {letters}, {way}, {len(some)} draws: {word.replace('_', ' ')}",
                    )
                )
            size = float(np.sqrt(np.mean(some**2))) if len(some) else np.nan
            out.append(
                Metric(
                    f"paper_way_{name}_{letters}_rms",
                    size,
                    "mm",
                    paper=abs(PAPER_MM[side] - truth[side]),
                    label=f"room's {letters}, {way}: rms error",
                )
            )
    rms = np.array([pair.rms(truth) for pair in found.pairs])
    for pair, (width, length) in zip(found.pairs, rms, strict=True):
        words = f"rms error, Tr from {pair.angle_deg:g}°, board at {pair.depth_m:.2f} m"
        for letters, value in zip(SIDES, (width, length), strict=True):
            out.append(
                Metric(f"pair_{pair.angle_deg:g}_{letters}_rms", float(value), "mm", label=f"room's {letters}: {words}")
            )
    for side, (letters, error) in enumerate(zip(SIDES, (2.0, 9.0), strict=True)):
        angle = smallest_angle(found.pairs, rms[:, side], error)
        out.append(
            Metric(
                f"pair_angle_for_{letters}",
                angle,
                "°",
                label=f"turn between the two views of Tr at which the {letters} has an rms error of {error:g} mm",
            )
        )
    return out


def _table(sizes: list[Size], truth: Size) -> tuple[np.ndarray, np.ndarray]:
    """Errors and predicted sigmas of width and length [n, 2], mm."""
    return np.array([size.errors(truth) for size in sizes]), np.array([size.sigmas() for size in sizes])
