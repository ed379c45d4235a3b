"""What walls say of a result: which are flat, how flat those are that were not used, and the gap after a turn."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.errors import CalibrationError
from jaxscan.geometry import Scanner, Turntable
from jaxscan.measurement.planes import facing, weighted_plane
from jaxscan.recalibration.grid import spread_over
from jaxscan.recalibration.observed import RoomObservations, Surfaces, SweepStripes
from jaxscan.recalibration.result import Adjusted, Closure, HoldOut, PanoramaOfWalls
from jaxscan.recalibration.triangulate import place_points, triangulate_points


_LEAST_M, _MOST_M = 8e-4, 3e-3
"""Unevenness that every wall may have, and that none may have [m]."""
_USUAL = 3.0
"""Unevenness of a flat wall at most, over that of most walls of the room."""
_CURVED = 0.02
"""Curvature of a flat wall at most [1/m], where it is worth its unevenness."""
_STEP_M = 2e-3
"""Height of a step that no flat wall has [m]."""
_SIGMAS = 5.0
_ROUGH_M, _SHARED = 5e-4, 9.0
"""Roughness of walls [m], and factor on the variance for errors that neighbours share; the largest accepted ones."""
_LOST = 0.3
"""Share of points that were left out from which a surface is no plane."""
_FEWEST = 12
_BLOCK_M, _BLOCK_POINTS = 0.3, 5
_FAR = 6.0
"""Standard deviations at which a residual is cut off."""
_SPLITS = np.linspace(0.08, 0.92, 29)
"""Where a step is looked for: share of the points on one side."""


class Shape(NamedTuple):
    """Structure in the distances of points from their plane."""

    uneven_m: float
    """RMS of means over blocks, or of a bow, beside noise [m]."""
    sure: bool
    curvature: float
    """Largest [1/m], beyond its standard deviations."""
    step_m: float
    """Height of the likeliest step, beyond its standard deviations [m]."""


def flat(adjusted: Adjusted) -> Bool[np.ndarray, " surfaces"]:
    """Which surfaces are flat within noise and the unevenness that most walls of the room have.

    A plane is fitted to the distances of each surface's points. The residuals are compared with a bow, with a step, and
    with means over blocks; noise is widened by the errors that neighbours share.
    """
    surfaces, points = adjusted.surfaces, adjusted.observations.points
    place, _ = place_points(adjusted.scanner, adjusted.observations, adjusted.corrections, stations=adjusted.stations)
    # One bad wall makes all of them rough and their errors shared; it must not excuse itself with that.
    widened, wall = np.sqrt(np.clip(adjusted.inflation, 1.0, _SHARED)), adjusted.wall_m
    stripe = np.sqrt(np.maximum(adjusted.point_sigma**2 - wall**2, (0.1 * adjusted.point_sigma) ** 2))
    noise = widened * np.hypot(stripe, min(wall, _ROUGH_M))
    good = np.ones(len(surfaces.distance), bool)
    shapes: dict[int, Shape] = {}
    for k in range(len(good)):
        own = points.surface == k
        if own.sum() < _FEWEST or np.mean(~adjusted.point_kept[own]) > _LOST:
            good[k] = False
            continue
        sigma = adjusted.point_sigma[own]
        error = np.clip(adjusted.point_error[own], -_FAR * sigma, _FAR * sigma)
        across = _in_plane(place[own], surfaces.normal[k])
        shapes[k] = shape_of(across, error, noise[own])
    if not shapes:
        return good
    usual = float(np.median([shape.uneven_m for shape in shapes.values()]))
    limit = float(np.clip(_USUAL * usual, _LEAST_M, _MOST_M))
    for k, shape in shapes.items():
        bowed = shape.curvature > _CURVED and shape.uneven_m > 0.5 * limit
        good[k] = not ((shape.sure and shape.uneven_m > limit) or bowed or shape.step_m > _STEP_M)
    return good


def shape_of(
    across: Float[np.ndarray, "points 2"], error: Float[np.ndarray, " points"], sigma: Float[np.ndarray, " points"]
) -> Shape:
    """Structure in distances from a plane at places in it [m]; sigmas are widened for errors that neighbours share."""
    across = across - across.mean(0)
    weight = sigma**-2.0
    s, t = across.T
    plane = np.column_stack([np.ones(len(s)), s, t])

    def fitted(design: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        covariance = np.linalg.pinv((design * weight[:, None]).T @ design)
        return covariance @ (design * weight[:, None]).T @ error, covariance

    error = error - plane @ fitted(plane)[0]
    bow = np.column_stack([plane, s * s, s * t, t * t])
    c, covariance = fitted(bow)
    hessian = np.array([[2 * c[3], c[4]], [c[4], 2 * c[5]]])
    doubt = 2.0 * np.sqrt(max(covariance[3, 3], covariance[5, 5]))
    curvature = float(np.abs(np.linalg.eigvalsh(hessian)).max() - _SIGMAS * doubt)
    bowed = bow @ c
    part = c[3:] @ np.linalg.pinv(covariance[3:, 3:]) @ c[3:]
    rms, sure = float(np.sqrt(np.mean(bowed**2))), bool(part > 3.0 + _SIGMAS * np.sqrt(6.0))
    uneven, uneven_sure = _blocks(across, error, weight)
    if uneven_sure and (uneven > rms or not sure):
        rms, sure = uneven, True
    return Shape(rms if sure else 0.0, sure, max(curvature, 0.0), _step(across, error, weight, plane))


def _blocks(across: np.ndarray, error: np.ndarray, weight: np.ndarray) -> tuple[float, bool]:
    """RMS of the means over blocks less their noise, and whether it is more than noise."""
    size = max(_BLOCK_M, float(np.ptp(across, axis=0).max()) / 20)
    at = np.floor(across / size).astype(int)
    number = np.unique(at, axis=0, return_inverse=True)[1].ravel()
    count = np.bincount(number)
    total = np.bincount(number, weight)
    mean = np.bincount(number, weight * error) / total
    many = count >= _BLOCK_POINTS
    if many.sum() < 3:
        return 0.0, False
    mean, variance = mean[many], 1.0 / total[many]
    chi2, freedom = float((mean**2 / variance).sum()), max(int(many.sum()) - 3, 1)
    excess = float(np.average(mean**2 - variance, weights=count[many]))
    return float(np.sqrt(max(excess, 0.0))), bool(chi2 > freedom + _SIGMAS * np.sqrt(2.0 * freedom))


def _step(across: np.ndarray, error: np.ndarray, weight: np.ndarray, plane: np.ndarray) -> float:
    """Height of the likeliest step along either axis of the plane, less its standard deviations [m]."""
    best, found = 0.0, 0.0
    root = np.sqrt(weight)[:, None]
    basis = np.linalg.qr(plane * root)[0]
    whitened = error * root[:, 0]
    whitened = whitened - basis @ (basis.T @ whitened)
    for axis in (0, 1):
        for split in np.quantile(across[:, axis], _SPLITS):
            side = (across[:, axis] > split) * root[:, 0]
            side = side - basis @ (basis.T @ side)
            length = float(side @ side)
            if length <= 0:
                continue
            height = float(side @ whitened) / length
            if height * height * length > best:
                best, found = height * height * length, abs(height) - _SIGMAS / np.sqrt(length)
    return max(float(found), 0.0)


def _in_plane(p: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Coordinates of points in a plane: along the floor first, so that upright edges are a step of one of them."""
    level = np.cross([0.0, 0.0, 1.0], normal)
    if np.linalg.norm(level) < 0.1:
        level = np.cross([1.0, 0.0, 0.0], normal)
    level = level / np.linalg.norm(level)
    return np.stack([p @ level, p @ np.cross(normal, level)], -1)


Fitting = Callable[[RoomObservations], Adjusted]
# Points of one mean: so few that a wall has many, so many that noise is small beside a bend.
_BLOCK = 40
# A plane needs a few more blocks than it has unknowns.
_LEAST_BLOCKS = 6
# Smallest singular value of the normals of planes that place a station.
_LEAST_SPREAD = 0.3
# Flatness may come out worse by this share by chance.
_BY_CHANCE = 1.1


def hold_out(adjusted: Adjusted, stored: Scanner, fit: Fitting) -> HoldOut | None:
    """Flatness of planes that were not used, with the stored scanner and with one fitted to the others.

    RMS of means of neighbouring points over each half; None where there are fewer than two planes, or where those
    of one half do not determine every station and the scanner.
    """
    points = adjusted.observations.points
    numbers = _halves(adjusted.observations.surfaces, points.surface[adjusted.point_kept])
    if any(len(half) == 0 or not _places_stations(adjusted, half) for half in numbers):
        return None
    before, after = [], []
    for half in numbers:
        try:
            fitted = fit(hidden(adjusted.observations, half))
        except CalibrationError:
            # All planes together have an adjustment; these alone leave something open.
            return None
        test = adjusted.point_kept & np.isin(points.surface, half)
        before.append(1e3 * flatness(stored, adjusted.observations, adjusted.corrections, test))
        after.append(1e3 * flatness(fitted.scanner, adjusted.observations, adjusted.corrections, test))
    worse = [new > _BY_CHANCE * old for old, new in zip(before, after, strict=True)]
    return HoldOut(tuple(before), tuple(after), not all(worse))


def _halves(surfaces: Surfaces, seen: Int[np.ndarray, " points"]) -> tuple[list[int], list[int]]:
    """Numbers of planes in two halves. Large planes are dealt out first, so each half has walls in several
    directions."""
    count = np.bincount(seen, minlength=len(surfaces.distance))
    planes = np.flatnonzero(count >= _LEAST_BLOCKS * _BLOCK).tolist()
    halves: tuple[list[int], list[int]] = ([], [])
    size = [0, 0]
    for number in sorted(planes, key=lambda k: -count[k]):
        smaller = int(size[1] < size[0])
        halves[smaller].append(number)
        size[smaller] += int(count[number])
    return halves


def _places_stations(adjusted: Adjusted, without: list[int]) -> bool:
    """Whether planes that are left show where every station is: those it shares with others look in all directions."""
    observations, kept = adjusted.observations, adjusted.point_kept
    if observations.tracks is not None and len(observations.tracks.q):
        return True
    surface, station = observations.points.surface[kept], observations.station[observations.points.sweep[kept]]
    for number in range(1, int(observations.station.max()) + 1):
        shared = np.intersect1d(surface[station == number], surface[station != number])
        normals = adjusted.surfaces.normal[np.setdiff1d(shared, without)]
        if len(normals) < 3 or np.linalg.svd(normals, compute_uv=False)[2] < _LEAST_SPREAD:
            return False
    return True


def hidden(observations: RoomObservations, numbers: list[int]) -> RoomObservations:
    """The observations without the points of some surfaces; arrays keep their sizes, for which a solve is compiled."""
    points, lengths = observations.points, observations.lengths
    sigma = np.where(np.isin(points.surface, numbers), np.inf, points.sigma)
    own = [each for each in lengths if each.between == "tracks" or not {each.first, each.second} & {*numbers}]
    return observations._replace(points=points._replace(sigma=sigma), lengths=tuple(own))


def flatness(
    scanner: Scanner,
    observations: RoomObservations,
    corrections: tuple[Float[np.ndarray, " records"], ...],
    some: Bool[np.ndarray, " points"],
) -> float:
    """RMS of means of neighbouring points' distances from the best plane through each wall of each sweep [m]."""
    points = observations.points.take(np.flatnonzero(some))
    place, valid = place_points(scanner, observations, corrections, points=points)
    points, place = points.take(np.flatnonzero(valid)), place[valid]
    means = []
    for sweep, surface in {*zip(points.sweep.tolist(), points.surface.tolist(), strict=True)}:
        own = np.flatnonzero((points.sweep == sweep) & (points.surface == surface))
        if len(own) >= _LEAST_BLOCKS * _BLOCK:
            means.append(_block_means(_distances(place[own]), points.record[own], points.line[own]))
    return float(np.sqrt(np.mean(np.concatenate(means) ** 2))) if means else 0.0


def _distances(place: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """Distances of points from the plane through them, positive away from the origin [m]."""
    plane = weighted_plane(place, np.ones(len(place)))
    return np.asarray((place - plane.centre) @ facing(plane, plane.centre).normal)


def _block_means(
    error: Float[np.ndarray, " n"], record: Int[np.ndarray, " n"], line: Int[np.ndarray, " n"]
) -> Float[np.ndarray, " blocks"]:
    """Means over about `_BLOCK` points that are near each other on the grid."""
    strips = max(1, round(np.sqrt(len(error) / _BLOCK)))
    by_record = np.argsort(record, kind="stable")
    found = []
    for strip in np.array_split(by_record, strips):
        by_line = strip[np.argsort(line[strip], kind="stable")]
        found += [error[block].mean() for block in np.array_split(by_line, max(1, len(by_line) // _BLOCK))]
    return np.array(found)


# Cells of the picture at most, and points that are averaged in it.
_PROFILES, _LINES, _POINTS = 720, 400, 300_000
_LEAST_POINTS = 30


def panorama_of(
    sweep: SweepStripes,
    labels: Int[np.ndarray, "profiles lines"],
    scanners: tuple[Scanner, Scanner],
    corrections: tuple[Float[np.ndarray, " records"], Float[np.ndarray, " records"]],
) -> PanoramaOfWalls:
    """Means over cells of the grid of the distances from planes, with two scanners and their corrections of angles."""
    profile, line = np.nonzero((labels >= 0) & sweep.valid)
    some = spread_over(np.arange(len(profile)), _POINTS)
    profile, line = profile[some], line[some]
    number = labels[profile, line]
    # Bounds of the cells: profiles that hold stripes are spread evenly.
    height, width = min(_PROFILES, labels.shape[0]), min(_LINES, labels.shape[1])
    cell = profile * height // labels.shape[0] * width + line * width // labels.shape[1]
    q = sweep.pixels(profile, line)
    record = sweep.record[profile]
    pictures = []
    for scanner, correction in zip(scanners, corrections, strict=True):
        place, valid = triangulate_points(scanner, q, sweep.laser[profile], (sweep.angle + correction)[record])
        error, known = np.zeros(len(place)), np.zeros(len(place), bool)
        for each in np.unique(number[valid]):
            own = np.flatnonzero(valid & (number == each))
            if len(own) >= _LEAST_POINTS:
                error[own], known[own] = _distances(place[own]), True
        count = np.bincount(cell[known], minlength=height * width)
        mean = np.bincount(cell[known], error[known], minlength=height * width) / np.maximum(count, 1)
        pictures.append((mean.reshape(height, width), (count > 0).reshape(height, width)))
    (before, seen), (after, again) = pictures
    middle = (np.arange(height) * labels.shape[0] // height).clip(max=labels.shape[0] - 1)
    return PanoramaOfWalls(sweep.name, before, after, seen & again, sweep.angle[sweep.record[middle]])


RADIUS_M = 2.5
"""Distance from the axis at which the gap is reported [m]."""
_TURN = 2.0 * np.pi
# Fewer points of a plane do not determine its direction.
_LEAST_PASS = 30
# A point of the room that is seen again after this turn closes it [rad].
_NEARLY = np.radians(350.0)


def closure_of(adjusted: Adjusted, stored: Scanner) -> Closure | None:
    """The gap after a full turn, with the stored and with the new scanner; None without a full turn.

    Where a sweep overlaps itself the gap is measured: planes that the first pass saw against points of the second.
    A table's gain need not be 1. So without an overlap the gap is the difference of the stored gain and the new one if
    features close the turn. If nothing closes it, the gap is unknown and only its standard deviation is given.
    """
    if not isinstance(stored.turntable, Turntable) or not isinstance(adjusted.scanner.turntable, Turntable):
        return None
    if not any(np.ptp(angle) > _NEARLY for angle in adjusted.observations.angles if len(angle)):
        return None
    before = _overlap_gap(stored, adjusted, ())
    after = _overlap_gap(adjusted.scanner, adjusted, adjusted.corrections)
    if before is not None and after is not None:
        return Closure(_mm(before[0]), _mm(after[0]), _mm(after[1]), "overlap")
    position = stored.parameter_names().index("gain")
    sigma = float(np.sqrt(max(np.asarray(adjusted.scanner.covariance)[position, position], 0.0)))
    if not _seen_again(adjusted):
        return Closure(None, None, _mm(_TURN * sigma), "model")
    change = float(adjusted.scanner.turntable.gain) - float(stored.turntable.gain)
    return Closure(_mm(_TURN * change), None, _mm(_TURN * sigma), "features")


def _mm(angle: float) -> float:
    return 1e3 * RADIUS_M * abs(angle)


def _seen_again(adjusted: Adjusted) -> bool:
    """Whether a tracked point is seen at the beginning and at the end of a turn."""
    tracks = adjusted.observations.tracks
    if tracks is None:
        return False
    kept = np.flatnonzero(adjusted.track_kept)
    for sweep, angle in enumerate(adjusted.observations.angles):
        own = kept[tracks.sweep[kept] == sweep]
        phi = angle[tracks.record[own]]
        _, point = np.unique(tracks.track[own], return_inverse=True)
        low, high = np.full(len(own), np.inf), np.full(len(own), -np.inf)
        np.minimum.at(low, point, phi)
        np.maximum.at(high, point, phi)
        if len(own) and np.any(high - low > _NEARLY):
            return True
    return False


def _overlap_gap(scanner: Scanner, adjusted: Adjusted, corrections: Sequence[np.ndarray]) -> tuple[float, float] | None:
    """The angle by which the second pass is turned against the first, a weighted mean over planes and sweeps, and its
    sigma [rad]."""
    observations = adjusted.observations
    kept = np.flatnonzero(adjusted.point_kept)
    points = observations.points.take(kept)
    journal = observations.angles_of(points)
    place, valid = place_points(scanner, observations, corrections, points=points)
    sigma = adjusted.point_sigma[kept]
    weight = total = 0.0
    for sweep, angle in enumerate(observations.angles):
        way = 1.0 if angle[-1] >= angle[0] else -1.0
        turned = way * (journal - angle[0])
        end = float(np.max(way * (angle - angle[0])))
        for surface in np.unique(points.surface[points.sweep == sweep]):
            own = valid & (points.sweep == sweep) & (points.surface == surface)
            first, second = own & (turned <= end - _TURN), own & (turned >= _TURN)
            if min(first.sum(), second.sum()) >= _LEAST_PASS:
                information, score = _turn_of_plane(place, sigma, first, second)
                weight, total = weight + information, total + score
    if weight <= 0.0:
        return None
    return total / weight, float(np.sqrt(adjusted.inflation / weight))


def _turn_of_plane(
    place: Float[np.ndarray, "n 3"], sigma: Float[np.ndarray, " n"], first: np.ndarray, second: np.ndarray
) -> tuple[float, float]:
    """Information on the turn between two passes over one plane, whose three unknowns are eliminated, and its score."""
    both = np.concatenate([place[first], place[second]])
    late = np.repeat([0.0, 1.0], [first.sum(), second.sum()])
    own = np.concatenate([sigma[first], sigma[second]])
    flat = weighted_plane(both, np.ones(len(both)))
    arm, normal = both - flat.centre, flat.normal
    # A turn about the scanner's z axis moves a point by z x p.
    moved = late * (normal[1] * both[:, 0] - normal[0] * both[:, 1]) / own
    plane = np.column_stack([arm @ flat.axes.T, np.ones(len(arm))]) / own[:, None]
    basis, _ = np.linalg.qr(plane)
    free = moved - basis @ (basis.T @ moved)
    return float(free @ free), float(free @ (arm @ normal / own))
