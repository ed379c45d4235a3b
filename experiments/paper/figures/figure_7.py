"""Fig. 7: marks 300 mm apart on a flat wall about 2.5 m away, measured in the coloured cloud.

One sweep of the wall gives both clouds: ours, and that of the paper's way, whose stripe is found in the same frames by
its two plain extractors. Marks are found by their colours alone, `mark_finder`. A person who clicks on a point of the
cloud gets the one nearest to the mark's middle instead: with a profile every 4.6 mm that dominates his distances, so it
is reported apart ("picked").
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

import jaxscan
from experiments.paper.figures import mark_finder as finder
from experiments.paper.figures.mark_picture import draw_marks, wall_picture
from experiments.paper.figures.mark_wall import PITCH_M, hall, stripe_window, wall, wall_distance
from experiments.paper.methods import paper_way
from experiments.paper.methods.plain_stripes import gravity, highest
from experiments.paper.metrics import Metric
from experiments.paper.products.draws import Draw, draws, our_calibrations
from experiments.paper.rendering.sweeps import RenderedSweep
from experiments.paper.stage import Stage
from experiments.paper.worlds import windowed, windowed_scanner
from jaxscan.simulation.scene import make_scene
from jaxscan.stripes import NoiseModel, estimate_noise


LENGTH_MM = 300.0
COLUMNS = {False: 15, True: 5}
"""Of marks, in the full and the quick wall."""
STEP_DEG = {False: 0.1, True: 0.2}
DEPTHS_M = (2.2, 3.1)
"""Between which the wall lies: a surveyor knows that."""
REPEATED = 0.4
"""Share of the sweep that is repeated with other noise, which tells the random part of the distances."""
_SEED, _OTHER = 71, 72
_PLAIN = {"gravity": gravity, "highest": highest}


class Plain(NamedTuple):
    """A sweep as a plain extractor sees it."""

    u: np.ndarray
    valid: np.ndarray
    grey: np.ndarray
    """The laser-off image at the centres [records, rows], DN."""


class Measured(NamedTuple):
    """Distances in one cloud."""

    centres: finder.Centres
    distances: np.ndarray
    """[pairs], mm."""
    beside: np.ndarray
    """Which pairs lie beside each other, not above."""
    numbers: np.ndarray
    """Both centres of each pair [pairs, 2]."""
    picked: np.ndarray
    """The same distances between points of the cloud [pairs], mm."""

    def predicted(self) -> np.ndarray:
        """Standard deviation of each distance from the noise of the points [pairs], mm."""
        axis = np.where(self.beside, 0, 1)
        both = self.centres.sigma[self.numbers, axis[:, None]]
        return 1000 * np.sqrt(np.sum(both**2, axis=1))


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
    sweep = place.sweep(place.angles, seed=_SEED, watch=partial(_watch, plain))
    noise = _noise_of(place, sweep)
    stripes = jaxscan.extract_sweep(sweep, parts[0], noise=noise)
    stage.say(f"figure 7: {len(place.angles)} records of the wall")
    clouds = [jaxscan.reconstruct(sweep, part, stripes=stripes) for part in parts]
    ours = [measure_ours(cloud, part, noise) for cloud, part in zip(clouds, parts, strict=True)]
    metrics = our_metrics(ours)
    metrics += _random_part(place, parts[0], noise, ours[0])
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


def measure_ours(cloud: jaxscan.PointCloud, scanner: jaxscan.Scanner, noise: NoiseModel) -> Measured:
    """Marks in our cloud, with their predicted uncertainty."""
    xyz, valid = np.asarray(cloud.xyz, np.float64), np.asarray(cloud.valid)
    grey = np.asarray(cloud.rgb, np.float64).mean(-1)
    towards = np.stack([np.asarray(scanner.pose(phi))[:3, 3] for phi in cloud.angle])
    ray = xyz - towards[:, None]
    ray *= (np.asarray(cloud.sigma_random) / np.maximum(np.linalg.norm(ray, axis=-1), 1e-9))[..., None]
    shared = 1.0 if cloud.shared_lines is None else float(np.median(np.asarray(cloud.shared_lines)[valid]))
    # A grey value is a mean of two pixels, on average of two thirds of the variance of one.
    level = np.sqrt(noise.variance(np.median(grey[valid])) * 2 / 3 + 1 / 12)
    return _measured((xyz, valid, grey), np.array([0.0, 0.0, 1.0]), (ray, shared, float(level)))


def measure_paper_way(seen: Plain, ways: list[paper_way.PaperWay], angles: np.ndarray) -> list[Measured]:
    """Marks in the paper's cloud, by several calibrations of the same camera."""
    out = []
    for way in ways:
        xyz = paper_way.cloud(way, seen.u, seen.valid, angles)
        valid = np.isfinite(xyz).all(-1)
        out.append(_measured((np.where(valid[..., None], xyz, 0), valid, seen.grey), np.array([0.0, -1.0, 0.0]), None))
    return out


def our_metrics(ours: list[Measured]) -> list[Metric]:
    """Figures of our clouds."""
    error = np.array([one.distances.mean() - LENGTH_MM for one in ours])
    spread = float(np.mean([one.distances.std(ddof=1) for one in ours]))
    largest = float(np.abs(error).max())
    metrics = [
        Metric("ours_pairs", len(ours[0].distances), "", "more", 5, low=None, label="pairs of marks, our cloud"),
        Metric("ours_mean_error", error.mean(), "mm", "near", 0.03, -0.16, -0.05, 0.05, "mean error, ours"),
        Metric(
            "ours_largest_mean_error",
            largest,
            "mm",
            "less",
            0.04,
            0.16,
            high=0.05,
            label="mean error of the worst of our calibrations",
        ),
        Metric("ours_std", spread, "mm", "less", 0.03, 0.87, high=0.45, label="standard deviation, ours"),
    ]
    for name, side in (("horizontal", True), ("vertical", False)):
        part = [one.distances[one.beside == side] for one in ours]
        mean = float(np.mean([one.mean() - LENGTH_MM for one in part]))
        spread = float(np.mean([one.std(ddof=1) for one in part]))
        metrics += [
            Metric(f"ours_{name}_mean_error", mean, "mm", "near", 0.05, label=f"mean error of {name} pairs, ours"),
            Metric(f"ours_{name}_std", spread, "mm", "less", 0.05, label=f"standard deviation of {name} pairs, ours"),
        ]
    picked = float(np.mean([np.nanstd(one.picked) for one in ours]))
    label = "standard deviation between single points of our cloud that lie nearest to the centres"
    return [*metrics, Metric("ours_picked_std", picked, "mm", "near", 0.1, 0.87, label=label)]


def paper_metrics(name: str, paper: list[Measured]) -> list[Metric]:
    """Figures of the paper's way by one extractor, over all draws of its calibration."""
    error = np.array([one.distances.mean() - LENGTH_MM for one in paper])
    spread = float(np.median([one.distances.std(ddof=1) for one in paper]))
    picked = float(np.median([np.nanstd(one.picked) for one in paper]))
    root = float(np.sqrt(np.mean(error**2)))
    what, key = f"the paper's way, {name}", f"paper_way_{name}"
    return [
        Metric(
            f"{key}_pairs",
            float(np.median([len(one.distances) for one in paper])),
            "",
            "more",
            10,
            label=f"pairs of marks, {what}",
        ),
        Metric(
            f"{key}_mean_error",
            root,
            "mm",
            "none",
            0.0,
            0.16,
            0.08,
            0.32,
            f"mean error (root mean square over draws), {what}",
        ),
        Metric(
            f"{key}_std", spread, "mm", "none", 0.0, 0.87, 0.435, 1.74, f"standard deviation (median of draws), {what}"
        ),
        Metric(
            f"{key}_picked_std",
            picked,
            "mm",
            "none",
            0.0,
            0.87,
            label=f"standard deviation between picked points, {what}",
        ),
    ]


def _measured(
    coloured: tuple[np.ndarray, np.ndarray, np.ndarray],
    up: np.ndarray,
    noise: tuple[np.ndarray, float, float] | None,
) -> Measured:
    """Distances in a cloud of positions [profiles, lines, 3], which exist, and grey values."""
    xyz, valid, grey = coloured
    plane, edges = finder.fit_wall(xyz, valid, up), finder.find_edges(grey, valid)
    centres = finder.find_centres(xyz, valid, edges, plane, noise)
    number, beside = finder.pairs(centres.place, LENGTH_MM / 1000, 0.03)
    picked = finder.picked_points(xyz, valid, plane, centres)
    lengths = [1000 * np.linalg.norm(np.diff(each[number], axis=1)[:, 0], axis=-1) for each in (centres.place, picked)]
    return Measured(centres, lengths[0], beside, number, lengths[1])


def _random_part(place: Wall, scanner: jaxscan.Scanner, noise: NoiseModel, first: Measured) -> list[Metric]:
    """What other noise changes in the distances, against what the sigmas of the points predict."""
    angles = place.angles[: int(REPEATED * len(place.angles))]
    again = measure_ours(jaxscan.reconstruct(place.sweep(angles, seed=_OTHER), scanner, noise=noise), scanner, noise)
    change, predicted, both = [], [], []
    middles = [one.centres.place[one.numbers].mean(1) for one in (first, again)]
    # Both clouds have planes, and so coordinates, of their own: their common marks tell the shift.
    shift = _shift(first.centres.place, again.centres.place)
    for number, middle in enumerate(middles[1]):
        apart = np.linalg.norm((middles[0] - middle - shift)[:, :2], axis=1)
        same = np.flatnonzero((apart < 0.02) & (first.beside == again.beside[number]))
        if len(same) == 1:
            change.append(again.distances[number] - first.distances[same[0]])
            both.append((again.distances[number] + first.distances[same[0]]) / 2)
            predicted.append(again.predicted()[number])
    observed = float(np.std(change) / np.sqrt(2)) if change else np.nan
    expected = float(np.sqrt(np.mean(np.square(predicted)))) if predicted else np.nan
    fixed = float(np.sqrt(max(np.var(both) - observed**2 / 2, 0))) if both else np.nan
    return [
        Metric(
            "ours_random_std",
            observed,
            "mm",
            "less",
            0.02,
            label="random part of the standard deviation, from a repeated sweep",
        ),
        Metric(
            "ours_predicted_std", expected, "mm", "none", label="the same as predicted from the points' uncertainties"
        ),
        Metric(
            "ours_random_over_predicted",
            observed / expected,
            "",
            "near",
            0.2,
            None,
            0.8,
            1.2,
            "random part, observed over predicted",
        ),
        Metric(
            "ours_fixed_std",
            fixed,
            "mm",
            "none",
            label="part of the standard deviation that stays the same: sampling, and calibration",
        ),
    ]


def _shift(places: np.ndarray, others: np.ndarray) -> np.ndarray:
    """From places [n, 3] of the same grid of marks to others: that which brings most of these on each other."""
    every = (places[:, None, :2] - others[None, :, :2]).reshape(-1, 2)
    votes = [(np.linalg.norm(every - one, axis=1) < 0.01).sum() for one in every]
    best = every[int(np.argmax(votes))]
    near = every[np.linalg.norm(every - best, axis=1) < 0.01]
    return np.append(near.mean(0), 0.0)


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
