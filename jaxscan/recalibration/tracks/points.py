"""Points of the room from their sightings by a scanner whose motion is known: lines of sight, triangulation, and which
sightings agree with points at rest."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.geometry import Scanner, compose, invert, pixels, poses, rays, root_of, transform, turn
from jaxscan.recalibration.observed import SweepStripes, Tracks


MOST_RANGE_M = 30.0
LEAST_RANGE_M = 0.1


class Rays(NamedTuple):
    """Lines of sight in one frame; directions of length 1."""

    origin: Float[np.ndarray, "n 3"]
    direction: Float[np.ndarray, "n 3"]


class Triangulated(NamedTuple):
    """Points, and how well their sightings hold them."""

    point: Float[np.ndarray, "tracks 3"]
    covariance: Float[np.ndarray, "tracks 3 3"]
    """Covariance by the noise of the sightings [m^2]."""
    range_m: Float[np.ndarray, " tracks"]
    """Mean distance from the camera; negative behind it."""
    valid: Bool[np.ndarray, " tracks"]
    """Whether the point is in front of the camera, and no farther than `MOST_RANGE_M`."""


def rays_of(
    scanner: Scanner,
    q: Float[np.ndarray, "n 2"],
    angle: Float[np.ndarray, " n"],
    station: Float[np.ndarray, "n 4 4"] | None = None,
) -> Rays:
    """Lines of sight through pixels at the table's angles, in the room, or without stations in the scanner's frame."""
    pose = poses(scanner.rig, angle)
    pose = pose if station is None else compose(station, pose)
    return Rays(np.asarray(pose)[:, :3, 3], np.asarray(turn(pose[:, :3, :3], rays(scanner.rig, q))))


def triangulate(
    rays: Rays, sigma_rad: Float[np.ndarray, " n"], track: Int[np.ndarray, " n"], count: int
) -> Triangulated:
    """The point nearest to all lines of sight of each track, by linear least squares.

    A camera on the axis cannot tell the distance of points: then `valid` is False.
    """
    across = np.eye(3) - rays.direction[:, :, None] * rays.direction[:, None, :]
    weight = sigma_rad**-2.0
    point, covariance = np.zeros((count, 3)), np.zeros((count, 3, 3))
    range_m = np.ones(len(track))
    for _ in range(2):
        # An error of an angle is one of the point over its range.
        normal = _summed(across * (weight / range_m**2)[:, None, None], track, count)
        moment = _summed((across @ rays.origin[..., None])[..., 0] * (weight / range_m**2)[:, None], track, count)
        size = np.trace(normal, axis1=1, axis2=2)[:, None, None]
        normal = normal + np.eye(3) * np.maximum(size * 1e-12, 1e-300)
        covariance = np.linalg.inv(normal)
        point = (covariance @ moment[..., None])[..., 0]
        along = ((point[track] - rays.origin) * rays.direction).sum(1)
        range_m = np.maximum(np.abs(along), LEAST_RANGE_M)
    seen = np.maximum(np.bincount(track, minlength=count), 1)
    mean = np.bincount(track, along, count) / seen
    behind = np.bincount(track, along < LEAST_RANGE_M, count) > 0
    return Triangulated(point, covariance, mean, ~behind & (mean > LEAST_RANGE_M) & (mean < MOST_RANGE_M))


def project_all(
    scanner: Scanner,
    point: Float[np.ndarray, "n 3"],
    angle: Float[np.ndarray, " n"],
    station: Float[np.ndarray, "n 4 4"] | None = None,
    step: Float[np.ndarray, " params"] | None = None,
) -> Float[np.ndarray, "n 2"]:
    """Pixels at which points are seen at the table's angles, by a scanner after a step in its minimal coordinates."""
    rig = scanner.rig if step is None else scanner.rig.retract(step)
    return np.asarray(pixels(rig, point if station is None else transform(invert(station), point), angle))


def _summed(values: np.ndarray, track: np.ndarray, count: int) -> np.ndarray:
    size = int(np.prod(values.shape[1:]))
    out = np.stack([np.bincount(track, column, count) for column in values.reshape(len(values), size).T], -1)
    return out.reshape(count, *values.shape[1:])


def place_tracks(
    tracks: Tracks,
    sweeps: Sequence[SweepStripes],
    scanner: Scanner,
    stations: Float[np.ndarray, "stations 4 4"] | None = None,
) -> Tracks:
    """The tracks that have a point in front of the camera, within 30 m, triangulated with these stations.

    Without stations each point is placed by the first station that sees it, in its frame.
    """
    count = len(tracks.point)
    station = np.array([sweep.station for sweep in sweeps])[tracks.sweep]
    use = np.ones(len(station), bool)
    if stations is None:
        first = np.full(count, np.iinfo(int).max)
        np.minimum.at(first, tracks.track, station)
        use = station == first[tracks.track]
    found = _points(tracks, sweeps, scanner, None if stations is None else np.asarray(stations)[station], use)
    kept = np.flatnonzero(found.valid)
    number = np.full(count, -1)
    number[kept] = np.arange(len(kept))
    some = found.valid[tracks.track]
    names = tuple(tracks.name[k] for k in kept) if tracks.name else ()
    return Tracks(
        tracks.q[some],
        tracks.sigma[some],
        tracks.sweep[some],
        tracks.record[some],
        number[tracks.track[some]],
        found.point[kept],
        names if any(names) else (),
    )


def named_points(
    tracks: Tracks, sweep: int, sweeps: Sequence[SweepStripes], scanner: Scanner
) -> dict[str, tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]]:
    """Targets by name as one sweep alone sees them: point in its scanner's frame [m], and covariance by the noise."""
    mine = tracks.sweep == sweep
    found = _points(tracks, sweeps, scanner, None, mine)
    views = np.bincount(tracks.track[mine], minlength=len(tracks.point))
    good = found.valid & (views >= 2)
    return {name: (found.point[k], found.covariance[k]) for k, name in enumerate(tracks.name) if name and good[k]}


def _points(
    tracks: Tracks, sweeps: Sequence[SweepStripes], scanner: Scanner, poses: np.ndarray | None, use: np.ndarray
) -> Triangulated:
    """Points of all tracks by the sightings in `use`, bool [sightings]."""
    angle = np.array([sweeps[s].angle[r] for s, r in zip(tracks.sweep, tracks.record, strict=True)])
    focal = float(np.mean([scanner.camera.fx, scanner.camera.fy]))
    rays = rays_of(scanner, tracks.q[use], angle[use], None if poses is None else poses[use])
    return triangulate(rays, tracks.sigma[use] / focal, tracks.track[use], len(tracks.point))


_ROUNDS, _REWEIGHTED = 3, 4
_ANGLE_SIGMA = 1e-3
"""Error of the table at one key image, beyond that of its model [rad]."""
_ROBUST, _REJECT = 3.0, 4.0
"""Standard deviations beyond which a sighting counts less, and beyond which it is left out."""
_MOST_REJECTED = 0.3
"""Share of its sightings that a good track may lose."""
_SHARED_PX = 0.02
"""Error that sightings in one part of the image share, and that no difference shows, as of interpolation [px]."""
_BINS, _FEWEST_IN_BIN = 6, 60
_FEWEST_VIEWS = 3
_PRIOR_FREEDOM = 6.0
_WORST = 4.0
"""Noise of a track, over the median of its kind, at most."""
_STEP, _POINT_STEP, _ANGLE_STEP = 1e-3, 1e-5, 1e-6
"""Steps of difference quotients: in standard deviations, m, rad."""
_FOR_SCANNER = 4000
"""Sightings from which the errors of scanner and angles are estimated."""


class Sightings(NamedTuple):
    """Sightings of points by one sweep, at the table's angle [rad from home], by number of the image."""

    q: Float[np.ndarray, "n 2"]
    sigma: Float[np.ndarray, " n"]
    """Standard deviation that the detector states [px]."""
    angle: Float[np.ndarray, " n"]
    key: Int[np.ndarray, " n"]
    track: Int[np.ndarray, " n"]
    kind: Int[np.ndarray, " n"]
    """Sightings of one kind have noise of one kind."""

    def take(self, index: np.ndarray) -> "Sightings":
        """The sightings at `index` (numbers or a mask)."""
        return Sightings(*(field[index] for field in self))


class Consistent(NamedTuple):
    """Sightings after the test."""

    kept: Bool[np.ndarray, " n"]
    sigma: Float[np.ndarray, " n"]
    """Standard deviation of u and of v as the differences show it [px]."""
    points: Triangulated
    """Points of all tracks, by the kept sightings and the scanner as it was given."""


def keep_consistent(scanner: Scanner, sightings: Sightings) -> Consistent:
    """Leave out sightings by one sweep that do not fit points at rest, and learn the noise of the others.

    The scanner and the angle of each image may move within their covariance, by linearised least squares, so
    that errors of a poor calibration are not taken for wrong tracks.
    """
    count = int(sightings.track.max(initial=-1)) + 1
    focal = float(np.mean([scanner.camera.fx, scanner.camera.fy]))
    rays = rays_of(scanner, sightings.q, sightings.angle)

    def points_of(kept: np.ndarray, sigma: np.ndarray) -> Triangulated:
        # Sightings that are left out have no weight, and their tracks stay in place.
        return triangulate(rays, np.where(kept, sigma, 1e6) / focal, sightings.track, count)

    kept, sigma = np.ones(len(sightings.q), bool), sightings.sigma.copy()
    points = points_of(kept, sigma)
    kept &= _steady(points, kept, sightings.track, count)
    for _ in range(_ROUNDS):
        use = np.flatnonzero(kept)
        if len(use) < 2 * _FEWEST_VIEWS:
            break
        part = sightings.take(use)
        error, freedom = _left(scanner, part, points.point[part.track], sigma[use])
        sigma = _learned(sightings, sigma, use, (error, freedom))
        size = np.linalg.norm(error, axis=1) / (sigma[use] * np.sqrt(freedom))
        kept[use] = size < _REJECT * np.sqrt(2.0)
        kept[use] &= sigma[use] < _WORST * np.median(sigma[use])
        kept = _whole(kept, sightings.track, count)
        points = points_of(kept, sigma)
        kept &= _steady(points, kept, sightings.track, count)
    return Consistent(kept, np.hypot(sigma, _SHARED_PX), points)


def _left(
    scanner: Scanner, part: Sightings, point: Float[np.ndarray, "n 3"], sigma: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
    """Residual of each sighting after a robust fit [px], and the share of its variance that a fit leaves."""
    by_scanner = _scanner_gradients(scanner, part, point)
    error = part.q - project_all(scanner, point, part.angle)
    moved = [
        project_all(scanner, point + step, part.angle) - project_all(scanner, point - step, part.angle)
        for step in _POINT_STEP * np.eye(3)
    ]
    by_point = np.stack(moved, -1) / (2 * _POINT_STEP)
    ahead, behind = (project_all(scanner, point, part.angle + step) for step in (_ANGLE_STEP, -_ANGLE_STEP))
    by_angle = (ahead - behind) / (2 * _ANGLE_STEP) * _ANGLE_SIGMA
    key = np.unique(part.key, return_inverse=True)[1]
    track = np.unique(part.track, return_inverse=True)[1]
    # Scanner and angles are held well by some of the tracks.
    some = track % int(np.ceil(len(track) / _FOR_SCANNER)) == 0
    chosen = np.flatnonzero(some)
    k = by_scanner.shape[2]
    design = np.zeros((len(chosen), 2, k + int(key.max()) + 1))
    design[..., :k] = by_scanner[chosen]
    design[np.arange(len(chosen)), :, k + key[chosen]] = by_angle[chosen]
    left, weight = error, 1.0 / sigma**2
    for _ in range(_REWEIGHTED):
        right = np.concatenate([design, error[chosen][..., None]], -1)
        reduced = _without_points(right, by_point[chosen], weight[chosen], track[chosen])
        rows = reduced.reshape(-1, right.shape[-1]) * np.sqrt(np.repeat(weight[chosen], 2))[:, None]
        normal = rows[:, :-1].T @ rows[:, :-1] + np.eye(design.shape[2])
        x = np.linalg.solve(normal, rows[:, :-1].T @ rows[:, -1])
        left = error - by_scanner @ x[:k] - by_angle * x[k + key][:, None]
        left = _without_points(left[..., None], by_point, weight, track)[..., 0]
        size = np.linalg.norm(left, axis=1) / sigma / np.sqrt(2.0)
        weight = 1.0 / (sigma * (1.0 + (size / _ROBUST) ** 2)) ** 2
    seen = np.bincount(track)
    freedom = np.maximum(2.0 * seen - 3.0, 1.0) / (2.0 * seen)
    return left, freedom[track]


def _without_points(
    values: Float[np.ndarray, "n 2 k"], by_point: Float[np.ndarray, "n 2 3"], weight: np.ndarray, track: np.ndarray
) -> Float[np.ndarray, "n 2 k"]:
    """Columns over all sightings, less the part that steps of each track's point explain."""
    order = np.argsort(track, kind="stable")
    numbers, start = np.unique(track[order], return_index=True)
    weighted = by_point.transpose(0, 2, 1) * weight[:, None, None]
    normal = np.add.reduceat((weighted @ by_point)[order], start, 0)
    # A camera on the axis does not see how far points are: those directions stay.
    size = np.trace(normal, axis1=1, axis2=2)[:, None, None] + 1e-30
    mixed = np.add.reduceat((weighted @ values)[order], start, 0)
    solved = np.linalg.inv(normal + 1e-9 * size * np.eye(3)) @ mixed
    return values - by_point @ solved[np.searchsorted(numbers, track)]


def _scanner_gradients(
    scanner: Scanner, part: Sightings, point: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 2 k"]:
    """Derivatives of pixels by the independent deviations of the scanner, each of standard deviation one."""
    layout = scanner.layout()
    covariance = scanner.covariance
    if covariance is None:
        covariance = np.diag([block.scale**2 for block in layout.blocks])
    root = root_of(np.asarray(covariance, np.float64))
    root = root[root.any(1)]
    columns = []
    for direction in root:
        ahead, behind = (
            project_all(scanner, point, part.angle, step=step) for step in (_STEP * direction, -_STEP * direction)
        )
        columns.append((ahead - behind) / (2 * _STEP))
    return np.stack(columns, -1)


def _learned(
    sightings: Sightings, sigma: np.ndarray, use: np.ndarray, left: tuple[np.ndarray, np.ndarray]
) -> Float[np.ndarray, " n"]:
    """Noise of each sighting: a share by the stated one and a floor for each kind, times a factor for each track.

    Steps in depth and shine make some tracks several times worse than others; a track's own differences tell, taken
    together with those of all as if these were `_PRIOR_FREEDOM` more.
    """
    error, freedom = left
    out = sigma.copy()
    for each in np.unique(sightings.kind[use]):
        mine = np.flatnonzero(sightings.kind[use] == each)
        if len(mine) < _FEWEST_IN_BIN:
            continue
        squares = (error[mine] ** 2 / freedom[mine, None]).reshape(-1)
        given = np.repeat(sightings.sigma[use[mine]], 2)
        bins = np.array_split(np.argsort(given, kind="stable"), min(_BINS, len(mine) // _FEWEST_IN_BIN))
        # The median of the square of a normal variable is 0.4549 of its variance.
        seen = np.array([np.median(squares[b]) / 0.4549 for b in bins])
        mean = np.array([np.mean(given[b] ** 2) for b in bins])
        share, floor = _two_parts(mean, seen)
        every = sightings.kind == each
        out[every] = np.sqrt(share * sightings.sigma[every] ** 2 + floor)
    squares = (error**2).sum(1) / out[use] ** 2
    count = int(sightings.track.max()) + 1
    total = np.bincount(sightings.track[use], squares, count)
    free = np.bincount(sightings.track[use], 2.0 * freedom, count)
    factor = (_PRIOR_FREEDOM + total) / (_PRIOR_FREEDOM + free)
    return out * np.sqrt(factor)[sightings.track]


def _two_parts(stated: np.ndarray, seen: np.ndarray) -> tuple[float, float]:
    """seen = share * stated + floor with both at least 0, by relative least squares."""
    columns = np.stack([stated, np.ones_like(stated)], -1) / seen[:, None]
    both = np.linalg.lstsq(columns, np.ones(len(seen)), rcond=None)[0]
    if len(seen) > 1 and (both >= 0).all():
        return float(both[0]), float(both[1])
    alone = columns.sum(0) / (columns**2).sum(0)
    cost = ((columns * alone - 1.0) ** 2).sum(0)
    return (float(alone[0]), 0.0) if cost[0] <= cost[1] else (0.0, float(alone[1]))


def _whole(kept: np.ndarray, track: np.ndarray, count: int) -> np.ndarray:
    """Without the tracks that lost too many sightings."""
    before, after = np.bincount(track, minlength=count), np.bincount(track, kept, count)
    good = (after >= _FEWEST_VIEWS) & (after >= (1.0 - _MOST_REJECTED) * before)
    return kept & good[track]


def _steady(points: Triangulated, kept: np.ndarray, track: np.ndarray, count: int) -> np.ndarray:
    """Sightings of points in front of the camera, near enough, seen often enough."""
    return (points.valid & (np.bincount(track, kept, count) >= _FEWEST_VIEWS))[track]
