"""Sightings that agree with points at rest in the room and one turning scanner, and their noise."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.geometry import Scanner
from jaxscan.recalibration.tracks.triangulate import Triangulated, project_all, rays_of, triangulate


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
"""Of difference quotients: standard deviations, m, rad."""
_FOR_SCANNER = 4000
"""Sightings from which the errors of scanner and angles are estimated."""


class Sightings(NamedTuple):
    """Sightings of points by one sweep."""

    q: Float[np.ndarray, "n 2"]
    sigma: Float[np.ndarray, " n"]
    """As the finder states it [px]."""
    angle: Float[np.ndarray, " n"]
    """The table's angle [rad from home]."""
    key: Int[np.ndarray, " n"]
    """Number of the image."""
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
    """Of all tracks, by the kept sightings and the scanner as it was given."""


def keep_consistent(scanner: Scanner, sightings: Sightings) -> Consistent:
    """Leave out sightings that do not fit points at rest, and learn the noise of the others.

    The scanner and the angle of each image may move within their covariance, by linearised least squares, so
    that errors of a poor calibration are not taken for wrong tracks.

    Args:
        scanner: The stored scanner; its covariance is the prior.
        sightings: Sightings of points by one sweep.

    Returns:
        The kept sightings, whose noise is learned from the residuals of that fit.
    """
    count = int(sightings.track.max(initial=-1)) + 1
    still = np.broadcast_to(np.eye(4), (len(sightings.q), 4, 4))
    focal = float(np.mean([scanner.camera.fx, scanner.camera.fy]))
    rays = rays_of(scanner, sightings.q, sightings.angle, still)

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
    still = np.broadcast_to(np.eye(4), (len(point), 4, 4))
    error = part.q - project_all(scanner, point, part.angle, still)
    moved = [
        project_all(scanner, point + step, part.angle, still) - project_all(scanner, point - step, part.angle, still)
        for step in _POINT_STEP * np.eye(3)
    ]
    by_point = np.stack(moved, -1) / (2 * _POINT_STEP)
    ahead, behind = (project_all(scanner, point, part.angle + step, still) for step in (_ANGLE_STEP, -_ANGLE_STEP))
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
    values, vectors = np.linalg.eigh(np.asarray(covariance, np.float64))
    some = values > 1e-16 * values.max()
    root = vectors[:, some] * np.sqrt(values[some])
    still = np.broadcast_to(np.eye(4), (len(point), 4, 4))
    columns = []
    for direction in root.T:
        ahead, behind = (
            project_all(scanner, point, part.angle, still, step) for step in (_STEP * direction, -_STEP * direction)
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
