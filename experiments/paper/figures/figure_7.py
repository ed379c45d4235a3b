"""Fig. 7: marks 300 mm apart on a flat wall about 2.5 m away, measured in the coloured cloud.

One sweep of the wall gives both clouds: ours, and that of the paper's method, with the stripes of two plain finders in
the same frames. Marks are found by their colours alone, `marks.finder`. A click selects the point of the cloud nearest
to a mark's centre instead. Profiles are 4.6 mm apart, which dominates the distances between such points, so these are
reported separately ("picked").
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

import jaxscan
from experiments.paper.figures.marks.measure import LENGTH_MM, Measured, Plain, measure_ours, measure_paper_way
from experiments.paper.figures.marks.picture import draw_marks, wall_picture
from experiments.paper.figures.marks.repeated import Kept, random_part
from experiments.paper.figures.marks.wall import PITCH_M, hall, stripe_window, wall, wall_distance
from experiments.paper.methods.paper_way import in_window
from experiments.paper.methods.plain_stripes import EXTRACTORS, METHODS
from experiments.paper.metrics import Metric, rms
from experiments.paper.products.draws import draws, our_calibrations
from experiments.paper.rendering.sweeps import RenderedSweep
from experiments.paper.stage import Stage
from experiments.paper.worlds import windowed, windowed_scanner
from jaxscan.simulation.scene import make_scene
from jaxscan.stripes import NoiseModel, estimate_noise


COLUMNS = {False: 15, True: 5}
"""Of marks, in the full and the quick wall."""
LEAST_PAIRS = 200
"""Of marks, so that their standard deviation is known to 5 %."""
STEP_DEG = {False: 0.1, True: 0.2}
DEPTHS_M = (2.2, 3.1)
"""Between which the wall lies, as a user knows."""
REPEATED = 0.5
"""Share of the sweep that is repeated with other noise, for the random part of the distances."""
_SEED, _OTHER = 71, 72
CLASS = 2.0
"""Largest factor between the paper's figures and those of its method on the simulator."""
PAPER_ERROR_MM, PAPER_STD_MM = 0.16, 0.87
"""Size of the paper's mean error, and its standard deviation."""


class Wall(NamedTuple):
    """The rig before the wall, and its sweep."""

    sweep: Callable[..., RenderedSweep]
    """Of `angles`, with `seed` and `watch`."""
    angles: np.ndarray
    first: int
    """Column at which the camera's window begins."""
    stop: int


def run(stage: Stage) -> list[Metric]:
    """Measure the marks."""
    place = before_wall(stage)
    # Frames may be read more than once: stripes are kept by the number of their record.
    shape = len(place.angles), stage.config.camera.height
    plain = {name: Plain(np.zeros(shape), np.zeros(shape, bool), np.zeros(shape)) for name in EXTRACTORS}
    scanners = [jaxscan.load_scanner(path) for path in our_calibrations(stage, 3)]
    parts = [windowed_scanner(scanner, place.first, place.stop) for scanner in scanners]
    kept = Kept(int(REPEATED * len(place.angles)), partial(_watch, plain))
    sweep = place.sweep(place.angles, seed=_SEED, watch=kept)
    noise = _noise_of(place, sweep)
    stripes = jaxscan.extract(sweep, parts[0], noise=noise).stripes
    stage.say(f"figure 7: {len(place.angles)} records of the wall")
    clouds = [jaxscan.reconstruct(sweep, part, stripes=stripes) for part in parts]
    ours = [measure_ours(cloud, part, noise) for cloud, part in zip(clouds, parts, strict=True)]
    metrics = our_metrics(ours, quick=stage.quick)
    again = Kept(kept.count)
    other = place.sweep(place.angles[: kept.count], seed=_OTHER, watch=again)
    for _ in other.chunks(32):
        pass
    metrics += random_part((kept.sweep(sweep), again.sweep(other)), parts[0], noise, ours[0])
    paper = {}
    for name, seen in plain.items():
        ways = [in_window(draw.by(name), place.first) for draw in draws(stage)]
        paper[name] = measure_paper_way(seen, ways, place.angles)
        metrics += paper_metrics(name, paper[name])
    draw_marks(
        stage.picture("figure_7"),
        f"Fig. 7, {stage.world} world: marks {LENGTH_MM:.0f} mm apart on a wall 2.5 m away",
        wall_picture(clouds[0], ours[0]),
        {"ours": ours, **{METHODS[name]: each for name, each in paper.items()}},
    )
    return metrics


def before_wall(stage: Stage) -> Wall:
    """The rig of a world before the wall."""
    config, columns = hall(stage.config), COLUMNS[stage.quick]
    first, stop = stripe_window(config, *DEPTHS_M)
    config = windowed(config, first, stop)
    distance = wall_distance(config)
    # The stripe is tilted and right of the middle of the image: 3.8 degrees on average, and 3 more or less at its ends.
    half = np.degrees(np.arctan2(PITCH_M * columns / 2, distance)) + 4.5
    angles = np.deg2rad(np.arange(np.floor(-half + 3.8), np.ceil(half + 3.8), STEP_DEG[stage.quick]))
    scene = make_scene(config, extras=partial(wall, distance, columns))
    return Wall(partial(RenderedSweep, config, scene=scene), angles, first, stop)


def our_metrics(ours: list[Measured], *, quick: bool) -> list[Metric]:
    """Figures of our clouds, by several calibrations of one sweep."""
    spread, count = "standard deviation of distances", len(ours)
    least = None if quick else LEAST_PAIRS
    error = np.array([one.distances.mean() - LENGTH_MM for one in ours])
    std = float(np.mean([one.distances.std(ddof=1) for one in ours]))
    worst, picked = float(np.abs(error).max()), float(np.mean([np.nanstd(one.picked) for one in ours]))
    metrics = [
        Metric("ours_pairs", len(ours[0].distances), "1", "more", 5, low=least, label="ours: pairs of marks"),
        Metric("ours_mean_error", float(error.mean()), "mm", "near", 0.05, -PAPER_ERROR_MM, -0.05, 0.05,
               f"ours: mean error of distances, mean of {count} calibrations"),
        Metric("ours_worst_mean_error", worst, "mm", "less", 0.03, PAPER_ERROR_MM, None, 0.05,
               label=f"ours: mean error of distances, largest of {count} calibrations"),
        Metric("ours_std", std, "mm", "less", 0.03, PAPER_STD_MM, high=0.45, label=f"ours: {spread}"),
        Metric("ours_picked_std", picked, "mm", "near", 0.2, label=f"ours: {spread} between picked points"),
    ]  # fmt: skip
    for name, side in (("horizontal", True), ("vertical", False)):
        part = [one.distances[one.beside == side] for one in ours]
        mean = float(np.mean([one.mean() - LENGTH_MM for one in part]))
        std = float(np.mean([one.std(ddof=1) for one in part]))
        metrics += [
            Metric(
                f"ours_{name}_mean_error", mean, "mm", "near", 0.1, label=f"ours: mean error of distances, {name} pairs"
            ),
            Metric(f"ours_{name}_std", std, "mm", "less", 0.05, label=f"ours: {spread}, {name} pairs"),
        ]
    return metrics


def paper_metrics(name: str, paper: list[Measured]) -> list[Metric]:
    """Figures of the paper's method with one stripe finder, over all draws of its calibration."""
    error = np.array([one.distances.mean() - LENGTH_MM for one in paper])
    count, std, picked = (
        float(np.median(values))
        for values in (
            [len(one.distances) for one in paper],
            [one.distances.std(ddof=1) for one in paper],
            [np.nanstd(one.picked) for one in paper],
        )
    )
    what, key, spread = METHODS[name], f"paper_way_{name}", "standard deviation of distances, median of the draws"
    around = {"low": PAPER_STD_MM / CLASS, "high": PAPER_STD_MM * CLASS}
    return [
        Metric(f"{key}_pairs", count, "1", "more", 10, label=f"{what}: pairs of marks, median of the draws"),
        Metric(f"{key}_mean_error", rms(error), "mm", "none", 0,
               PAPER_ERROR_MM, PAPER_ERROR_MM / CLASS, PAPER_ERROR_MM * CLASS,
               f"{what}: mean error of distances, rms of the draws"),
        Metric(f"{key}_std", std, "mm", "none", 0, PAPER_STD_MM, **around, label=f"{what}: {spread}"),
        Metric(f"{key}_picked_std", picked, "mm", "none", 0, PAPER_STD_MM,
               label=f"{what}: {spread}, between picked points"),
    ]  # fmt: skip


def _noise_of(place: Wall, sweep: RenderedSweep) -> NoiseModel:
    """From the first records, which are rendered once more for it."""
    quiet = place.sweep(place.angles[:4], seed=_SEED)
    on, off = next(quiet.chunks(4))
    return estimate_noise(on, off, pixel_format=sweep.pixel_format, response=sweep.response, line=sweep.lasers[0])


def _watch(plain: dict[str, Plain], first: int, on: np.ndarray, off: np.ndarray) -> None:
    """Plain stripes of a chunk, and the colours at their centres."""
    for name, extract in EXTRACTORS.items():
        u, valid = extract(on, off)
        left = np.clip(u.astype(int), 0, off.shape[2] - 2)
        near = [np.take_along_axis(off, at[..., None], 2)[..., 0].astype(np.float64) for at in (left, left + 1)]
        found = Plain(u, valid, near[0] + (u - left) * (near[1] - near[0]))
        for whole, part in zip(plain[name], found, strict=True):
            whole[first : first + len(part)] = part
