"""Fig. 7: marks 300 mm apart on a flat wall about 2.5 m away, measured in the coloured cloud.

One sweep of the wall gives both clouds: ours, and that of the paper's method, with the stripes of two plain finders in
the same frames. Marks are found by their colours alone, `find_edges`. A click selects the point of the cloud nearest
to a mark's centre instead. Profiles are 4.6 mm apart, which dominates the distances between such points, so these are
reported separately ("picked").
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from scipy import ndimage

import jaxscan
from experiments.paper.methods import EXTRACTORS, METHODS, PaperWay, in_window, paper_cloud
from experiments.paper.products import RenderedSweep, draws, our_calibrations
from experiments.paper.stage import Metric, Stage, plt, save, windowed, windowed_scanner
from experiments.paper.targets import PITCH_M, marks_hall, marks_wall, nominal_window, wall_distance
from experiments.report import rms
from jaxscan.reconstruction import SweepSource
from jaxscan.simulation.scene import make_scene
from jaxscan.stripes import NoiseModel, estimate_noise


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
    gradient: np.ndarray
    """Change of grey per line [DN], positive [edges]."""


class WallPlane(NamedTuple):
    """The plane of the wall."""

    middle: np.ndarray
    """[3], m."""
    axes: np.ndarray
    """To the right, upwards and towards the scanner, unit rows [3, 3]."""


class Noise(NamedTuple):
    """Random noise of a coloured cloud."""

    along: np.ndarray
    """A standard deviation of each point, as a vector along its ray [profiles, lines, 3], m."""
    shared: np.ndarray
    """Lines of a profile over which it is shared [profiles, lines]."""
    aside: np.ndarray
    """A standard deviation of the place whose colour a point has, from the point: its own in each [profiles, lines, 3],
    m."""
    grey: float
    """Standard deviation of a grey value [DN]."""


class Centres(NamedTuple):
    """Marks that were found."""

    mark: np.ndarray
    """Number of each, as in `Edges` [marks]."""
    place: np.ndarray
    """To the right, upwards and out of the wall [marks, 3], m."""
    radius: np.ndarray
    """[marks], m."""
    sigma: np.ndarray
    """Predicted standard deviation to the right and upwards [marks, 2], m; zero where no noise is given."""


def find_edges(grey: np.ndarray, valid: np.ndarray) -> Edges:
    """Outlines of dark patches.

    Args:
        grey: Grey values [profiles, lines], DN.
    """
    share = grey / np.maximum(_surroundings(grey, valid), 1.0)
    dark = valid & (share < _DARK)
    # A patch keeps its missing points and single bright ones.
    label, _ = ndimage.label(ndimage.binary_closing(dark, np.ones((3, 3))))
    found: list[tuple[int, int, float, float]] = []
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
                for line, gradient in _crossings(grey[profile], valid[profile], (own[0], own[-1]), ink):
                    found.append((mark, profile, line, gradient))
    table = np.array(found).reshape(-1, 4)
    return Edges(table[:, 0].astype(int), table[:, 1].astype(int), table[:, 2], table[:, 3])


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


def find_centres(
    xyz: np.ndarray, valid: np.ndarray, edges: Edges, wall: WallPlane, noise: Noise | None = None
) -> Centres:
    """Circles through the outlines.

    Args:
        xyz: The cloud [profiles, lines, 3], m.
        edges: From `find_edges` of the same cloud.
        noise: For the prediction of the centres' uncertainty.
    """
    low = np.floor(edges.line).astype(int)
    rest = (edges.line - low)[:, None]

    def between(field: np.ndarray) -> np.ndarray:
        return (1 - rest) * field[edges.profile, low] + rest * field[edges.profile, low + 1]

    both = valid[edges.profile, low] & valid[edges.profile, low + 1]
    at = (between(xyz) - wall.middle) @ wall.axes.T
    step = ((xyz[edges.profile, low + 1] - xyz[edges.profile, low]) @ wall.axes.T)[:, :2]
    fits: list[tuple[int, np.ndarray, float, np.ndarray]] = []
    for mark in np.unique(edges.mark):
        own = np.flatnonzero(both & (edges.mark == mark))
        circle = fit_circle(at[own, :2])
        if circle is None:
            continue
        centre, radius, kept = circle
        own = own[kept]
        sigma = np.zeros(2)
        if noise is not None:
            shared = np.maximum(noise.shared[edges.profile[own], low[own]], 1.0)
            # A position between two lines, and the crossing between two grey values, are means of both.
            apart, slope = rest[own, 0] * (1 - rest[own, 0]), edges.gradient[own]
            along = (between(noise.along)[own] @ wall.axes.T)[:, :2] * np.sqrt(1 - 2 * apart / shared)[:, None]
            greys = step[own] * (noise.grey * np.sqrt(1 - 2 * apart) / slope)[:, None]
            aside = (between(noise.aside)[own] @ wall.axes.T)[:, :2] * np.sqrt(1 - 2 * apart)[:, None]
            sigma = _predicted(
                at[own, :2] - centre, (along, greys, aside), (edges.profile[own], edges.line[own]), shared
            )
        fits.append((int(mark), np.append(centre, np.median(at[own, 2])), radius, sigma))
    if not fits:
        return Centres(np.zeros(0, int), np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2)))
    mark, place, radius, sigma = (np.array(part) for part in zip(*fits, strict=True))
    usual = np.median(radius)
    good = (radius > _RADIUS_SHARE[0] * usual) & (radius < _RADIUS_SHARE[1] * usual)
    return Centres(mark[good], place[good], radius[good], sigma[good])


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


def _crossings(grey: np.ndarray, valid: np.ndarray, ends: tuple[int, int], ink: float) -> list[tuple[float, float]]:
    """Where a profile crosses the middle between wall and ink, above and below a mark: line, and gradient."""
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
                out.append((min(line + sense * share, len(grey) - 1.001), float(grey[after] - grey[line])))
                break
    return out


def _predicted(
    apart: np.ndarray, noise: tuple[np.ndarray, ...], grid: tuple[np.ndarray, np.ndarray], shared: np.ndarray
) -> np.ndarray:
    """Standard deviation [2] of a circle's centre from the noise of its points.

    Args:
        apart: Points from the centre [n, 2].
        noise: Displacements by one standard deviation of the points' ranges, shared along a profile, of their grey
            values, and of the places of these [n, 2].
        grid: Profile and line of each point.
        shared: Lines over which the noise of each range is shared.
    """
    normal = apart / np.linalg.norm(apart, axis=1)[:, None]
    factors = np.linalg.pinv(np.column_stack([normal, np.ones(len(normal))]))[:2]
    ranges, greys, aside = (np.sum(normal * part, 1) for part in noise)
    profile, line = grid
    alike = np.clip(1 - np.abs(line[:, None] - line) / np.minimum(shared[:, None], shared), 0, 1) * (
        profile[:, None] == profile
    )
    covariance = alike * np.outer(ranges, ranges) + np.diag(greys**2 + aside**2)
    return np.sqrt(np.diag(factors @ covariance @ factors.T))


LENGTH_MM = 300.0


class Plain(NamedTuple):
    """The stripe of a sweep by a plain finder."""

    u: np.ndarray
    """Column [records, rows], px."""
    valid: np.ndarray
    """bool [records, rows]."""
    grey: np.ndarray
    """The laser-off image at the centres [records, rows], DN."""


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

    def predicted(self) -> np.ndarray:
        """Standard deviation of each distance from the noise of the points [pairs], mm."""
        axis = np.where(self.beside, 0, 1)
        both = self.centres.sigma[self.numbers, axis[:, None]]
        return 1000 * np.sqrt(np.sum(both**2, axis=1))


def measure_ours(cloud: jaxscan.PointCloud, scanner: jaxscan.Scanner, noise: NoiseModel) -> Measured:
    """Marks in our cloud, with their predicted uncertainty."""
    xyz, valid = np.asarray(cloud.xyz, np.float64), np.asarray(cloud.valid)
    grey = np.asarray(cloud.rgb, np.float64).mean(-1)
    poses = np.asarray(jax.vmap(scanner.pose)(np.asarray(cloud.angle)), np.float64)
    ray, sigma = xyz - poses[:, None, :3, 3], np.asarray(cloud.sigma_random, np.float64)
    far = np.maximum(np.linalg.norm(ray, axis=-1), 1e-9)
    # A smoothed point has the colour at the centre of its own row, which lies aside of it along the row. A change of
    # range moves the centre by d / (n_x range) times as much.
    own = sigma if cloud.sigma_row is None else np.asarray(cloud.sigma_row, np.float64)
    sheet = np.asarray(scanner.lasers.distance).ravel()[0] / abs(np.asarray(scanner.lasers.normal).reshape(-1, 3)[0, 0])
    wide = np.sqrt(np.maximum(own**2 - sigma**2, 0)) * sheet / far
    aside = wide[..., None] * poses[:, None, :3, 0]
    ray *= (sigma / far)[..., None]
    shared = np.ones(valid.shape) if cloud.shared_lines is None else np.asarray(cloud.shared_lines)
    # A grey value is a mean of two pixels, on average of two thirds of the variance of one.
    level = np.sqrt(noise.variance(np.median(grey[valid])) * 2 / 3 + 1 / 12)
    return _measured((xyz, valid, grey), np.array([0.0, 0.0, 1.0]), Noise(ray, shared, aside, float(level)))


def measure_paper_way(seen: Plain, ways: list[PaperWay], angles: np.ndarray) -> list[Measured]:
    """Marks in the paper's cloud, by several calibrations of the same camera."""
    out = []
    for way in ways:
        xyz = paper_cloud(way, seen.u, seen.valid, angles)
        valid = np.isfinite(xyz).all(-1)
        out.append(_measured((np.where(valid[..., None], xyz, 0), valid, seen.grey), np.array([0.0, -1.0, 0.0]), None))
    return out


def _measured(
    coloured: tuple[np.ndarray, np.ndarray, np.ndarray],
    up: np.ndarray,
    noise: Noise | None,
) -> Measured:
    """Distances in a cloud of positions [profiles, lines, 3], which exist, and grey values."""
    xyz, valid, grey = coloured
    plane, edges = fit_wall(xyz, valid, up), find_edges(grey, valid)
    centres = find_centres(xyz, valid, edges, plane, noise)
    number, beside = pairs_of(centres.place, LENGTH_MM / 1000, 0.03)
    picked = picked_points(xyz, valid, plane, centres)
    lengths = [1000 * np.linalg.norm(np.diff(each[number], axis=1)[:, 0], axis=-1) for each in (centres.place, picked)]
    return Measured(centres, lengths[0], beside, number, lengths[1])


_UNGUARDED = jaxscan.ReconstructSettings(stripes=jaxscan.StripeSettings(guard_edges=False))


class Kept:
    """Keeps the frames of the first records of a sweep while it is read."""

    def __init__(self, count: int, also: Callable[[int, np.ndarray, np.ndarray], None] | None = None) -> None:
        """Of `count` records; `also` sees all frames."""
        self.count, self.also = count, also
        self.frames: list[np.ndarray] = []

    def __call__(self, first: int, on: np.ndarray, off: np.ndarray) -> None:
        """Keep a chunk."""
        if self.also is not None:
            self.also(first, on, off)
        if not self.frames:
            self.frames = [np.zeros((self.count, *on.shape[1:]), np.uint8) for _ in range(2)]
        for whole, part in zip(self.frames, (on, off), strict=True):
            whole[first : first + len(part)] = part[: max(0, self.count - first)]

    def sweep(self, source: SweepSource) -> jaxscan.Sweep:
        """The kept frames as a sweep in memory, with the camera and laser of `source`."""
        on, off = self.frames
        alike = {name: getattr(source, name) for name in ("pixel_format", "response", "lasers")}
        return jaxscan.Sweep(on, off, source.angles[: self.count], carries="scanner", **alike)


def random_part(
    sweeps: tuple[SweepSource, SweepSource], scanner: jaxscan.Scanner, noise: NoiseModel, guarded: Measured
) -> list[Metric]:
    """Compare two sweeps that differ in noise alone.

    Args:
        sweeps: Both, of the same angles.
        guarded: Distances of the whole sweep with the sigmas as they are.
    """
    clouds = [jaxscan.reconstruct(sweep, scanner, settings=_UNGUARDED, noise=noise) for sweep in sweeps]
    one, two = (measure_ours(cloud, scanner, noise) for cloud in clouds)
    first, second = _same(one, two)
    observed = float(np.std(two.distances[second] - one.distances[first]) / np.sqrt(2)) if len(first) > 1 else np.nan
    expected = rms(one.predicted()[first])
    cautious = rms(guarded.predicted())
    spread = float(np.std(guarded.distances))
    random, without = "ours: standard deviation of distances by noise alone", "without the guard of edges"
    return [
        Metric("ours_random_std", observed, "mm", "less", 0.03, label=f"{random}, from a repeated sweep"),
        Metric("ours_predicted_std", expected, "mm", "near", 0.03, label=f"{random}, predicted {without}"),
        Metric("ours_random_over_predicted", observed / expected, "1", "near", 0.25, None, 0.8, 1.2,
               f"{random}, observed over predicted {without}"),
        Metric("ours_guarded_std", cautious, "mm", "none",
               label="ours: standard deviation of distances, predicted with the guard of edges"),
        Metric("ours_std_over_guarded", spread / cautious, "1", "none",
               label="ours: standard deviation of distances over the prediction with the guard of edges"),
    ]  # fmt: skip


def _same(one: Measured, two: Measured) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the pairs that both clouds have. Each cloud has coordinates of its own plane."""
    shift = _shift(one.centres.place[:, :2], two.centres.place[:, :2])
    middles = [each.centres.place[each.numbers, :2].mean(1) for each in (one, two)]
    apart = np.linalg.norm(middles[0][:, None] - middles[1] - shift, axis=-1)
    return np.nonzero((apart < 0.02) & (one.beside[:, None] == two.beside))


def _shift(places: np.ndarray, others: np.ndarray) -> np.ndarray:
    """The shift that brings most of `others` [n, 2] onto `places` [m, 2] of the same grid of marks [m]."""
    every = (places[:, None] - others).reshape(-1, 2)
    near = np.linalg.norm(every[:, None] - every, axis=-1) < 0.01
    return every[near[np.argmax(near.sum(1))]].mean(0)


PAPER_MM = (299.84, 0.87)
"""The paper's mean and standard deviation."""
_CELL_M = 0.0025


class WallPicture(NamedTuple):
    """A cloud of a wall, as seen from the front."""

    grey: np.ndarray
    """[rows, columns], DN; NaN where there is no point."""
    extent: tuple[float, float, float, float]
    """Left, right, bottom and top [m]."""
    centres: np.ndarray
    """[marks, 2], m."""
    pairs: np.ndarray
    """Both ends of each pair [pairs, 2, 2], m."""


def wall_picture(cloud: jaxscan.PointCloud, measured: Any) -> WallPicture:
    """The cloud's colours on a raster in the plane of the wall."""
    xyz, valid = np.asarray(cloud.xyz, np.float64), np.asarray(cloud.valid)
    plane = fit_wall(xyz, valid, np.array([0.0, 0.0, 1.0]))
    # Profiles are farther apart than the raster is fine: neighbours are joined by straight lines.
    both = valid[:-1] & valid[1:]
    grey = np.asarray(cloud.rgb, np.float64)[..., 0]
    places, greys = [], []
    for share in (0.0, 0.25, 0.5, 0.75):
        places.append(((1 - share) * xyz[:-1] + share * xyz[1:])[both])
        greys.append(((1 - share) * grey[:-1] + share * grey[1:])[both])
    at = (np.concatenate(places) - plane.middle) @ plane.axes[:2].T
    low, high = at.min(0), at.max(0)
    shape = tuple(np.ceil((high - low) / _CELL_M).astype(int))
    ends = [(low[0], high[0]), (low[1], high[1])]
    count, *_ = np.histogram2d(*at.T, bins=shape, range=ends)
    total, *_ = np.histogram2d(*at.T, bins=shape, range=ends, weights=np.concatenate(greys))
    raster = np.where(count > 0, total / np.maximum(count, 1), np.nan).T
    place = measured.centres.place[:, :2]
    return WallPicture(raster, (low[0], high[0], low[1], high[1]), place, place[measured.numbers])


def draw_marks(path: Path, title: str, wall: WallPicture, measured: dict[str, list[Any]]) -> None:
    """Write the picture; `measured` holds the clouds of each method by its name."""
    figure = plt.figure(figsize=(13, 9.5), dpi=110, layout="constrained")
    grid = figure.add_gridspec(2, len(measured), height_ratios=(1.75, 1))
    axes = figure.add_subplot(grid[0, :])
    axes.imshow(wall.grey, cmap="gray", origin="lower", extent=wall.extent, interpolation="nearest", vmin=0)
    for start, end in wall.pairs:
        axes.plot(*np.transpose([start, end]), color="tab:cyan", lw=0.6, alpha=0.5)
    axes.plot(*wall.centres.T, "+", color="tab:red", ms=9, mew=1.4)
    axes.set(xlabel="along the wall [m]", ylabel="height on the wall [m]", aspect="equal")
    axes.set_title(
        "The wall in our coloured cloud: centres found by colour (red), pairs 300 mm apart (blue)", fontsize=11
    )
    for column, (name, clouds) in enumerate(measured.items()):
        _histogram(figure.add_subplot(grid[1, column]), name, clouds)
    figure.suptitle(title, fontsize=13)
    save(figure, path, 110)


def _histogram(axes: Any, name: str, clouds: list[Any]) -> None:
    beside = np.concatenate([one.distances[one.beside] for one in clouds])
    above = np.concatenate([one.distances[~one.beside] for one in clouds])
    every = np.concatenate([beside, above])
    bins = np.linspace(297, 303, 61)
    axes.hist(
        [np.clip(above, 297, 303), np.clip(beside, 297, 303)],
        bins,
        stacked=True,
        density=True,
        label=["vertical pairs", "horizontal pairs"],
        color=["tab:blue", "tab:orange"],
    )
    x = np.linspace(297, 303, 400)
    mean, std = PAPER_MM
    axes.plot(
        x,
        np.exp(-0.5 * ((x - mean) / std) ** 2) / (std * np.sqrt(2 * np.pi)),
        "k--",
        lw=1.2,
        label=f"paper: {mean} ± {std} mm",
    )
    axes.axvline(300, color="0.4", lw=0.8)
    spread = np.median([one.distances.std(ddof=1) for one in clouds])
    axes.set(xlabel="distance [mm]", ylabel="density [1/mm]", xlim=(297, 303))
    axes.set_title(f"{name}: {every.mean():.2f} ± {spread:.2f} mm\n({len(clouds)} calibrations)", fontsize=11)
    # Room for the legend.
    axes.set_ylim(0, 1.45 * axes.get_ylim()[1])
    axes.legend(fontsize=8)


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


class BeforeWall(NamedTuple):
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


def before_wall(stage: Stage) -> BeforeWall:
    """The rig of a world before the wall."""
    config, columns = marks_hall(stage.config), COLUMNS[stage.quick]
    first, stop = nominal_window(config, *DEPTHS_M)
    config = windowed(config, first, stop)
    distance = wall_distance(config)
    # The stripe is tilted and right of the middle of the image: 3.8 degrees on average, and 3 more or less at its ends.
    half = np.degrees(np.arctan2(PITCH_M * columns / 2, distance)) + 4.5
    angles = np.deg2rad(np.arange(np.floor(-half + 3.8), np.ceil(half + 3.8), STEP_DEG[stage.quick]))
    scene = make_scene(config, extras=partial(marks_wall, distance, columns))
    return BeforeWall(partial(RenderedSweep, config, scene=scene), angles, first, stop)


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


def _noise_of(place: BeforeWall, sweep: RenderedSweep) -> NoiseModel:
    """The noise of the sweep, learned from its first records, which are rendered once more for this."""
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
