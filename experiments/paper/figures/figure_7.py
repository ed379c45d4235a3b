"""Fig. 7: marks 300 mm apart on a flat wall about 2.5 m away, measured in the coloured cloud.

One sweep of the wall gives both clouds: ours, and that of the paper's way, whose stripe is found in the same frames by
its two plain extractors. Marks are found by their colours alone, `marks.finder`. A person who clicks on a point of the
cloud gets the one nearest to the mark's middle instead: with a profile every 4.6 mm that dominates his distances, so it
is reported apart ("picked").
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
from experiments.paper.methods import paper_way
from experiments.paper.methods.plain_stripes import gravity, highest
from experiments.paper.metrics import Metric
from experiments.paper.products.draws import Draw, draws, our_calibrations
from experiments.paper.rendering.sweeps import RenderedSweep
from experiments.paper.stage import Stage
from experiments.paper.worlds import windowed, windowed_scanner
from jaxscan.simulation.scene import make_scene
from jaxscan.stripes import NoiseModel, estimate_noise


COLUMNS = {False: 15, True: 5}
"""Of marks, in the full and the quick wall."""
STEP_DEG = {False: 0.1, True: 0.2}
DEPTHS_M = (2.2, 3.1)
"""Between which the wall lies: a surveyor knows that."""
REPEATED = 0.5
"""Share of the sweep that is repeated with other noise, which tells the random part of the distances."""
_SEED, _OTHER = 71, 72
_PLAIN = {"gravity": gravity, "highest": highest}


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
    # Frames may be read more than once: what is seen of them is kept by their number.
    shape = len(place.angles), stage.config.camera.height
    plain = {name: Plain(np.zeros(shape), np.zeros(shape, bool), np.zeros(shape)) for name in _PLAIN}
    scanners = [jaxscan.load_scanner(path) for path in our_calibrations(stage, 3)]
    parts = [windowed_scanner(scanner, place.first, place.stop) for scanner in scanners]
    kept = Kept(int(REPEATED * len(place.angles)), partial(_watch, plain))
    sweep = place.sweep(place.angles, seed=_SEED, watch=kept)
    noise = _noise_of(place, sweep)
    stripes = jaxscan.extract_sweep(sweep, parts[0], noise=noise)
    stage.say(f"figure 7: {len(place.angles)} records of the wall")
    clouds = [jaxscan.reconstruct(sweep, part, stripes=stripes) for part in parts]
    ours = [measure_ours(cloud, part, noise) for cloud, part in zip(clouds, parts, strict=True)]
    metrics = our_metrics(ours)
    again = Kept(kept.count)
    other = place.sweep(place.angles[: kept.count], seed=_OTHER, watch=again)
    for _ in other.chunks(32):
        pass
    metrics += random_part((kept.sweep(sweep), again.sweep(other)), parts[0], noise, ours[0])
    paper = {}
    for name, seen in plain.items():
        paper[name] = measure_paper_way(seen, [_way(draw, name, place.first) for draw in draws(stage)], place.angles)
        metrics += paper_metrics(name, paper[name])
    draw_marks(
        stage.picture("figure_7"),
        f"Fig. 7, {stage.world} world: marks {LENGTH_MM:.0f} mm apart on a wall 2.5 m away",
        wall_picture(clouds[0], ours[0]),
        {"ours": ours, **{f"the paper's way, {name}": each for name, each in paper.items()}},
    )
    return metrics


def before_wall(stage: Stage) -> Wall:
    """The rig of a world before the wall."""
    config, columns = hall(stage.config), COLUMNS[stage.quick]
    first, stop = stripe_window(config, *DEPTHS_M)
    config = windowed(config, first, stop)
    distance = wall_distance(config)
    # The stripe stands aslant, and to the right of the middle of the image: 3.8 degrees, and 3 to both sides.
    half = np.degrees(np.arctan2(PITCH_M * columns / 2, distance)) + 4.5
    angles = np.deg2rad(np.arange(np.floor(-half + 3.8), np.ceil(half + 3.8), STEP_DEG[stage.quick]))
    scene = make_scene(config, extras=partial(wall, distance, columns))
    return Wall(partial(RenderedSweep, config, scene=scene), angles, first, stop)


def our_metrics(ours: list[Measured]) -> list[Metric]:
    """Figures of our clouds, by several calibrations of one sweep."""
    what = "ours"
    error = np.array([one.distances.mean() - LENGTH_MM for one in ours])
    std = float(np.mean([one.distances.std(ddof=1) for one in ours]))
    worst, picked = float(np.abs(error).max()), float(np.mean([np.nanstd(one.picked) for one in ours]))
    metrics = [
        Metric("ours_pairs", len(ours[0].distances), "", "more", 5, label=f"pairs of marks, {what}"),
        Metric("ours_mean_error", float(error.mean()), "mm", "near", 0.05, -0.16, -0.05, 0.05, f"mean error, {what}"),
        Metric("ours_worst_mean_error", worst, "mm", "less", 0.08, label="the same of the worst calibration, ours"),
        Metric("ours_std", std, "mm", "less", 0.03, 0.87, high=0.45, label=f"standard deviation, {what}"),
        Metric("ours_picked_std", picked, "mm", "near", 0.2, label=f"the same between single picked points, {what}"),
    ]
    for name, side in (("horizontal", True), ("vertical", False)):
        part = [one.distances[one.beside == side] for one in ours]
        mean = float(np.mean([one.mean() - LENGTH_MM for one in part]))
        std = float(np.mean([one.std(ddof=1) for one in part]))
        metrics += [
            Metric(f"ours_{name}_mean_error", mean, "mm", "near", 0.1, label=f"mean error, {name} pairs, {what}"),
            Metric(f"ours_{name}_std", std, "mm", "less", 0.05, label=f"standard deviation, {name} pairs, {what}"),
        ]
    return metrics


def paper_metrics(name: str, paper: list[Measured]) -> list[Metric]:
    """Figures of the paper's way by one extractor, over all draws of its calibration."""
    error = np.array([one.distances.mean() - LENGTH_MM for one in paper])
    root = float(np.sqrt(np.mean(error**2)))
    count, std, picked = (
        float(np.median(values))
        for values in (
            [len(one.distances) for one in paper],
            [one.distances.std(ddof=1) for one in paper],
            [np.nanstd(one.picked) for one in paper],
        )
    )
    what, key = f"the paper's way, {name}", f"paper_way_{name}"
    return [
        Metric(f"{key}_pairs", count, "", "more", 10, label=f"pairs of marks, {what}"),
        Metric(f"{key}_mean_error", root, "mm", "none", 0, 0.16, 0.08, 0.32, f"mean error, RMS of draws, {what}"),
        Metric(f"{key}_std", std, "mm", "none", 0, 0.87, 0.435, 1.74, f"standard deviation, {what}"),
        Metric(f"{key}_picked_std", picked, "mm", "none", 0, 0.87, label=f"the same between picked points, {what}"),
    ]


def _noise_of(place: Wall, sweep: RenderedSweep) -> NoiseModel:
    """From the first records, which are rendered once more for it."""
    quiet = place.sweep(place.angles[:4], seed=_SEED)
    on, off = next(quiet.chunks(4))
    return estimate_noise(on, off, pixel_format=sweep.pixel_format, response=sweep.response, line=sweep.lasers[0])


def _watch(plain: dict[str, Plain], first: int, on: np.ndarray, off: np.ndarray) -> None:
    """Plain stripes of a chunk, and the colours at their centres."""
    for name, extract in _PLAIN.items():
        u, valid = extract(on, off)
        left = np.clip(u.astype(int), 0, off.shape[2] - 2)
        near = [np.take_along_axis(off, at[..., None], 2)[..., 0].astype(np.float64) for at in (left, left + 1)]
        found = Plain(u, valid, near[0] + (u - left) * (near[1] - near[0]))
        for whole, part in zip(plain[name], found, strict=True):
            whole[first : first + len(part)] = part


def _way(draw: Draw, name: str, first: int) -> paper_way.PaperWay:
    """The paper's calibration of a draw for a camera whose window begins at column `first`."""
    way = draw.paper if name == "gravity" else draw.highest
    matrix = way.matrix.copy()
    matrix[0, 2] -= first
    return way._replace(matrix=matrix)
