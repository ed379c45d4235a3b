"""What walls say of a result: flatness of planes that were not used, and where points lie."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.errors import CalibrationError
from jaxscan.geometry import Scanner
from jaxscan.measurement.planes import facing, weighted_plane
from jaxscan.recalibration.grid import spread_over
from jaxscan.recalibration.observed import RoomObservations, Surfaces, SweepStripes
from jaxscan.recalibration.result import Adjusted, HoldOut, PanoramaOfWalls
from jaxscan.recalibration.triangulate import place_points, triangulate_points


Fitting = Callable[[RoomObservations], Adjusted]
# Points of one mean: so few that a wall has many, so many that noise is small beside a bend.
_BLOCK = 40
# A plane with fewer blocks than unknowns and some more says nothing.
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
    """Numbers of planes in two halves, large ones first in turn: each half has walls in several directions."""
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
    """Of points from the plane through them, positive away from the origin [m]."""
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
