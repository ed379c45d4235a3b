"""Fig. 7: marks 300 mm apart on a flat wall about 2.5 m away, measured in the coloured cloud.

One sweep of the wall gives both clouds: ours, and that of the paper's method, with the stripes of two plain finders in
the same frames. Marks are found by their colours alone, `find_edges`. A click selects the point of the cloud nearest
to a mark's centre instead. Profiles are 4.6 mm apart, which dominates the distances between such points, so these are
reported separately ("picked").
"""

from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import ndimage

import jaxscan
from experiments.paper.methods import METHODS, PaperWay, in_window, paper_cloud
from experiments.paper.products import PlainStripes, RenderedSweep, draws, our_calibrations, plain_stripes
from experiments.paper.stage import Metric, Stage, plt, save, windowed, windowed_scanner
from experiments.paper.targets import PITCH_M, marks_hall, marks_wall, nominal_window, wall_distance
from experiments.report import rms
from jaxscan.simulation.scene import make_scene


_DARK = 0.75
"""A point is of a mark if it is darker than this share of its surroundings."""
_MIN_PROFILES = 3
_MIN_EDGES = 6
_STRAY = 7.5
"""Edges farther from the circle than this many times the median of them do not count: five standard deviations."""
_RADIUS_SHARE = (0.6, 1.6)
"""Circles much smaller or larger than most of them are no marks."""


class Edges(NamedTuple):
    """Where profiles cross the outlines of marks."""

    mark: np.ndarray
    """Number of the mark, int [edges]."""
    profile: np.ndarray
    """int [edges]."""
    line: np.ndarray
    """Position between the lines of the profile, float [edges]."""


class WallPlane(NamedTuple):
    """The plane of the wall."""

    middle: np.ndarray
    """[3], m."""
    axes: np.ndarray
    """To the right, upwards and towards the scanner, unit rows [3, 3]."""


class Centres(NamedTuple):
    """Marks that were found."""

    place: np.ndarray
    """To the right, upwards and out of the wall [marks, 3], m."""
    radius: np.ndarray
    """[marks], m."""


def find_edges(grey: np.ndarray, valid: np.ndarray) -> Edges:
    """Outlines of dark patches.

    Args:
        grey: Grey values [profiles, lines], DN.
    """
    share = grey / np.maximum(_surroundings(grey, valid), 1.0)
    dark = valid & (share < _DARK)
    # A patch keeps its missing points and single bright ones.
    label, _ = ndimage.label(ndimage.binary_closing(dark, np.ones((3, 3))))
    found: list[tuple[int, int, float]] = []
    for mark, place in enumerate(ndimage.find_objects(label)):
        profiles, lines = place
        tall = lines.stop - lines.start
        inside = profiles.start > 0 and profiles.stop < len(grey) and lines.start > tall / 2
        if not inside or profiles.stop - profiles.start < _MIN_PROFILES or lines.stop + tall / 2 > grey.shape[1]:
            continue
        body = label[place] == mark + 1
        ink = float(np.median(share[place][body & valid[place]]))
        for profile in range(profiles.start, profiles.stop):
            own = np.flatnonzero(body[profile - profiles.start]) + lines.start
            if len(own):
                for line in _crossings(grey[profile], valid[profile], (own[0], own[-1]), ink):
                    found.append((mark, profile, line))
    table = np.array(found).reshape(-1, 3)
    return Edges(table[:, 0].astype(int), table[:, 1].astype(int), table[:, 2])


def fit_wall(xyz: np.ndarray, valid: np.ndarray, up: np.ndarray) -> WallPlane:
    """The plane through most of a cloud.

    Args:
        xyz: [..., 3], m; the origin is on the scanner's side of the wall.
        up: Roughly upwards [3].
    """
    points = xyz[valid]
    points = points[:: max(1, len(points) // 50_000)]
    kept = np.ones(len(points), bool)
    for _ in range(5):
        middle = points[kept].mean(0)
        normal = np.linalg.eigh(np.cov((points[kept] - middle).T))[1][:, 0]
        apart = (points - middle) @ normal
        kept = np.abs(apart) < 4 * 1.4826 * np.median(np.abs(apart)) + 1e-6
    normal = normal * -np.sign(normal @ middle)
    right = np.cross(up, normal)
    right /= np.linalg.norm(right)
    return WallPlane(middle, np.stack([right, np.cross(normal, right), normal]))


def find_centres(xyz: np.ndarray, valid: np.ndarray, edges: Edges, wall: WallPlane) -> Centres:
    """Circles through the outlines in a cloud [profiles, lines, 3]."""
    low = np.floor(edges.line).astype(int)
    rest = (edges.line - low)[:, None]
    both = valid[edges.profile, low] & valid[edges.profile, low + 1]
    between = (1 - rest) * xyz[edges.profile, low] + rest * xyz[edges.profile, low + 1]
    at = (between - wall.middle) @ wall.axes.T
    fits: list[tuple[np.ndarray, float]] = []
    for mark in np.unique(edges.mark):
        own = np.flatnonzero(both & (edges.mark == mark))
        circle = fit_circle(at[own, :2])
        if circle is not None:
            centre, radius, kept = circle
            fits.append((np.append(centre, np.median(at[own[kept], 2])), radius))
    if not fits:
        return Centres(np.zeros((0, 3)), np.zeros(0))
    place, radius = (np.array(part) for part in zip(*fits, strict=True))
    usual = np.median(radius)
    good = (radius > _RADIUS_SHARE[0] * usual) & (radius < _RADIUS_SHARE[1] * usual)
    return Centres(place[good], radius[good])


def fit_circle(points: np.ndarray) -> tuple[np.ndarray, float, np.ndarray] | None:
    """The circle with the least squared distances from points [n, 2]: centre, radius, and which points it kept.

    None where the points determine none.
    """
    kept = np.ones(len(points), bool)
    if len(points) < _MIN_EDGES:
        return None
    centre = points.mean(0)
    radius = float(np.sqrt(2) * np.sqrt(np.mean((points - centre) ** 2)))
    for _ in range(8):
        apart = points - centre
        far = np.maximum(np.linalg.norm(apart, axis=1), 1e-9)
        residual = far - radius
        kept = np.abs(residual) < max(_STRAY * float(np.median(np.abs(residual))), 3e-4)
        if kept.sum() < _MIN_EDGES:
            return None
        design = np.column_stack([apart / far[:, None], np.ones(len(points))])[kept]
        change = np.linalg.lstsq(design, residual[kept], rcond=None)[0]
        centre, radius = centre + change[:2], radius + change[2]
    return (centre, float(radius), kept) if radius > 0 else None


def picked_points(xyz: np.ndarray, valid: np.ndarray, wall: WallPlane, centres: Centres) -> np.ndarray:
    """The point of the cloud nearest to each centre, as by a click [marks, 3], m, axes of the wall; NaN without one."""
    at = (xyz[valid] - wall.middle) @ wall.axes.T
    at = at[np.abs(at[:, 2]) < 0.1]
    order = np.argsort(at[:, 0])
    at = at[order]
    out = np.full((len(centres.place), 3), np.nan)
    for number, place in enumerate(centres.place):
        first, stop = np.searchsorted(at[:, 0], place[0] + np.array([-0.01, 0.01]))
        near = at[first:stop]
        if len(near):
            out[number] = near[np.argmin(np.sum((near[:, :2] - place[:2]) ** 2, axis=1))]
    return out


def pairs_of(place: np.ndarray, length: float, room: float) -> tuple[np.ndarray, np.ndarray]:
    """Horizontal and vertical pairs of places, about `length` apart.

    Args:
        place: [n, 3], m, axes of the wall.
        length: Nominal distance [m].
        room: Largest departure from it, along and across [m].

    Returns:
        Numbers of both [pairs, 2], and whether they are horizontal, bool [pairs].
    """
    apart = place[None, :, :2] - place[:, None, :2]
    beside = (np.abs(apart[..., 0] - length) < room) & (np.abs(apart[..., 1]) < room)
    above = (np.abs(apart[..., 1] - length) < room) & (np.abs(apart[..., 0]) < room)
    number = np.argwhere(beside | above)
    return number, beside[number[:, 0], number[:, 1]]


def _surroundings(grey: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """The wall's own grey round every point: a median over more than a mark."""
    steps = max(1, grey.shape[0] // 130), max(1, grey.shape[1] // 130)
    small = np.where(valid, grey, np.nan)[:: steps[0], :: steps[1]]
    small = np.where(np.isfinite(small), small, np.nanmedian(small))
    # A mark is a twelfth of its field of the grid: the upper half of a window round it is wall.
    wide = ndimage.percentile_filter(small, 70, size=(15, 15), mode="nearest")
    at = np.minimum(np.arange(grey.shape[0]) // steps[0], len(wide) - 1)
    line = np.minimum(np.arange(grey.shape[1]) // steps[1], wide.shape[1] - 1)
    return wide[np.ix_(at, line)]


def _crossings(grey: np.ndarray, valid: np.ndarray, ends: tuple[int, int], ink: float) -> list[float]:
    """Lines at which a profile crosses the middle between wall and ink, above and below a mark."""
    first, last = ends
    reach = max(2, (last - first) // 3)
    out = []
    for start, sense in ((first, -1), (last, 1)):
        beyond = start + sense * np.arange(1 + reach // 2, 2 + 2 * reach)
        beyond = beyond[(beyond >= 0) & (beyond < len(grey))]
        if valid[beyond].sum() < 2:
            continue
        bright = float(np.median(grey[beyond[valid[beyond]]]))
        middle = 0.5 * (1 + ink) * bright
        # From inside the mark outwards, to the first point that is brighter.
        for line in range(start - sense * min(reach, 3), start + sense * (reach + 2), sense):
            after = line + sense
            if not (0 <= after < len(grey) and valid[line] and valid[after]):
                continue
            if grey[line] < middle <= grey[after]:
                share = (middle - grey[line]) / (grey[after] - grey[line])
                out.append(min(line + sense * share, len(grey) - 1.001))
                break
    return out


LENGTH_MM = 300.0


class Measured(NamedTuple):
    """Distances in one cloud."""

    centres: Centres
    distances: np.ndarray
    """[pairs], mm."""
    beside: np.ndarray
    """Horizontal pairs, bool [pairs]; the others are vertical."""
    numbers: np.ndarray
    """Both centres of each pair [pairs, 2]."""
    picked: np.ndarray
    """The same distances between points of the cloud [pairs], mm."""


def measure_ours(cloud: jaxscan.PointCloud) -> Measured:
    """Marks in our cloud."""
    grey = np.asarray(cloud.rgb, np.float64).mean(-1)
    return _measured(np.asarray(cloud.xyz, np.float64), np.asarray(cloud.valid), grey, np.array([0.0, 0.0, 1.0]))


def measure_paper_way(seen: PlainStripes, way: PaperWay, angles: np.ndarray) -> Measured:
    """Marks in the paper's cloud."""
    xyz = paper_cloud(way, seen.u, seen.valid, angles)
    valid = np.isfinite(xyz).all(-1)
    return _measured(np.where(valid[..., None], xyz, 0), valid, seen.grey, np.array([0.0, -1.0, 0.0]))


def _measured(xyz: np.ndarray, valid: np.ndarray, grey: np.ndarray, up: np.ndarray) -> Measured:
    """Distances in a cloud of positions [profiles, lines, 3], which exist, and grey values."""
    plane, edges = fit_wall(xyz, valid, up), find_edges(grey, valid)
    centres = find_centres(xyz, valid, edges, plane)
    number, beside = pairs_of(centres.place, LENGTH_MM / 1000, 0.03)
    picked = picked_points(xyz, valid, plane, centres)
    lengths = [1000 * np.linalg.norm(np.diff(each[number], axis=1)[:, 0], axis=-1) for each in (centres.place, picked)]
    return Measured(centres, lengths[0], beside, number, lengths[1])


PAPER_MM = (299.84, 0.87)
"""The paper's mean and standard deviation."""
_CELL_M = 0.0025


def draw_marks(path: Path, title: str, cloud: jaxscan.PointCloud, measured: dict[str, list[Measured]]) -> None:
    """The wall from the front, and the distances in the clouds of each method, by its name; the first is ours."""
    xyz, valid = np.asarray(cloud.xyz, np.float64), np.asarray(cloud.valid)
    plane = fit_wall(xyz, valid, np.array([0.0, 0.0, 1.0]))
    # Profiles are farther apart than the raster is fine: neighbours are joined by straight lines.
    both = valid[:-1] & valid[1:]
    level = np.asarray(cloud.rgb, np.float64)[..., 0]
    shares = (0.0, 0.25, 0.5, 0.75)
    places, greys = (
        np.concatenate([((1 - share) * field[:-1] + share * field[1:])[both] for share in shares])
        for field in (xyz, level)
    )
    x, y = ((places - plane.middle) @ plane.axes[:2].T).T
    ends = [(x.min(), x.max()), (y.min(), y.max())]
    bins = [int(np.ceil((high - low) / _CELL_M)) for low, high in ends]
    count, *_ = np.histogram2d(x, y, bins=bins, range=ends)
    total, *_ = np.histogram2d(x, y, bins=bins, range=ends, weights=greys)
    figure = plt.figure(figsize=(13, 9.5), layout="constrained")
    grid = figure.add_gridspec(2, len(measured), height_ratios=(1.75, 1))
    axes, ours = figure.add_subplot(grid[0, :]), next(iter(measured.values()))[0]
    picture = np.where(count > 0, total / np.maximum(count, 1), np.nan).T
    axes.imshow(picture, cmap="gray", origin="lower", extent=(*ends[0], *ends[1]), interpolation="nearest", vmin=0)
    for pair in ours.centres.place[ours.numbers, :2]:
        axes.plot(*pair.T, color="tab:cyan", lw=0.6, alpha=0.5)
    axes.plot(*ours.centres.place[:, :2].T, "+", color="tab:red", ms=9, mew=1.4)
    axes.set(xlabel="along the wall [m]", ylabel="height on the wall [m]", aspect="equal")
    axes.set_title("The wall in our coloured cloud: centres found by colour (red), pairs 300 mm apart (blue)")
    for column, (name, clouds) in enumerate(measured.items()):
        _histogram(figure.add_subplot(grid[1, column]), name, clouds)
    figure.suptitle(title, fontsize=13)
    save(figure, path, 110)


def _histogram(axes: plt.Axes, name: str, clouds: list[Measured]) -> None:
    beside = np.concatenate([one.distances[one.beside] for one in clouds])
    above = np.concatenate([one.distances[~one.beside] for one in clouds])
    sides = [np.clip(above, 297, 303), np.clip(beside, 297, 303)]
    bins, labels = np.linspace(297, 303, 61), ["vertical pairs", "horizontal pairs"]
    axes.hist(sides, bins, stacked=True, density=True, label=labels, color=["tab:blue", "tab:orange"])
    x, (mean, std) = np.linspace(297, 303, 400), PAPER_MM
    density = np.exp(-0.5 * ((x - mean) / std) ** 2) / (std * np.sqrt(2 * np.pi))
    axes.plot(x, density, "k--", lw=1.2, label=f"paper: {mean} ± {std} mm")
    spread = np.median([one.distances.std(ddof=1) for one in clouds])
    axes.set(xlabel="distance [mm]", ylabel="density [1/mm]", xlim=(297, 303))
    axes.set_title(f"{name}: {np.concatenate([beside, above]).mean():.2f} ± {spread:.2f} mm", fontsize=11)
    axes.legend(fontsize=8)


COLUMNS = {False: 15, True: 5}
"""Columns of marks on the full and on the quick wall."""
LEAST_PAIRS = 200
"""Least number of pairs of marks: their standard deviation is then known to 5 %."""
STEP_DEG = {False: 0.1, True: 0.2}
DEPTHS_M = (2.2, 3.1)
"""Between which the wall lies, as a user knows."""
_SEED = 71
CLASS = 2.0
"""Largest factor between the paper's figures and those of its method on the simulator."""
PAPER_ERROR_MM, PAPER_STD_MM = 0.16, 0.87
"""Size of the paper's mean error, and its standard deviation."""


def run(stage: Stage) -> list[Metric]:
    """Measure the marks."""
    config, columns = marks_hall(stage.config), COLUMNS[stage.quick]
    first, stop = nominal_window(config, *DEPTHS_M)
    config = windowed(config, first, stop)
    distance = wall_distance(config)
    # The stripe is tilted and right of the middle of the image: 3.8 degrees on average, and 3 more or less at its ends.
    half = np.degrees(np.arctan2(PITCH_M * columns / 2, distance)) + 4.5
    angles = np.deg2rad(np.arange(np.floor(-half + 3.8), np.ceil(half + 3.8), STEP_DEG[stage.quick]))
    scene = make_scene(config, extras=partial(marks_wall, distance, columns))
    plain, watch = plain_stripes((len(angles), config.camera.height))
    sweep = RenderedSweep(config, angles, seed=_SEED, scene=scene, watch=watch)
    parts = [windowed_scanner(jaxscan.load_scanner(path), first, stop) for path in our_calibrations(stage)]
    stripes = jaxscan.extract(sweep, parts[0]).stripes
    stage.say(f"figure 7: {len(angles)} records of the wall")
    clouds = [jaxscan.reconstruct(sweep, part, stripes=stripes) for part in parts]
    ours = [measure_ours(cloud) for cloud in clouds]
    metrics, measured = our_metrics(ours, quick=stage.quick), {"ours": ours}
    for name, seen in plain.items():
        ways = [in_window(draw.by(name), first) for draw in draws(stage)]
        paper = [measure_paper_way(seen, way, angles) for way in ways]
        metrics += paper_metrics(name, paper)
        measured[METHODS[name]] = paper
    title = f"Fig. 7, {stage.world} world: marks {LENGTH_MM:.0f} mm apart on a wall 2.5 m away"
    draw_marks(stage.picture("figure_7"), title, clouds[0], measured)
    return metrics


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
