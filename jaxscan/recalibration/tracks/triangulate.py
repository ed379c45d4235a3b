"""Lines of sight, pixels, and points of the room from their sightings, by a scanner whose motion is known."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.geometry import Scanner, compose, invert, pixels, poses, rays, transform, turn
from jaxscan.recalibration.observed import SweepStripes, Tracks


MOST_RANGE_M = 30.0
LEAST_RANGE_M = 0.1


class Rays(NamedTuple):
    """Lines of sight in one frame."""

    origin: Float[np.ndarray, "n 3"]
    direction: Float[np.ndarray, "n 3"]
    """Of length 1."""


class Triangulated(NamedTuple):
    """Points, and how well their sightings hold them."""

    point: Float[np.ndarray, "tracks 3"]
    covariance: Float[np.ndarray, "tracks 3 3"]
    """By the sightings' noise [m^2]."""
    range_m: Float[np.ndarray, " tracks"]
    """Mean distance from the camera; negative behind it."""
    valid: Bool[np.ndarray, " tracks"]
    """In front of the camera, and no farther than `MOST_RANGE_M`."""


def rays_of(
    scanner: Scanner,
    q: Float[np.ndarray, "n 2"],
    angle: Float[np.ndarray, " n"],
    station: Float[np.ndarray, "n 4 4"],
) -> Rays:
    """Lines of sight in the frame of the room.

    Args:
        scanner: The scanner.
        q: Pixels [px].
        angle: The table's angle of each [rad from home].
        station: T_room_scanner of each.
    """
    pose = compose(station, poses(scanner.rig, angle))
    return Rays(np.asarray(pose)[:, :3, 3], np.asarray(turn(pose[:, :3, :3], rays(scanner.rig, q))))


def triangulate(
    rays: Rays, sigma_rad: Float[np.ndarray, " n"], track: Int[np.ndarray, " n"], count: int
) -> Triangulated:
    """The point nearest to all lines of sight of each track, by linear least squares.

    Args:
        rays: The lines of sight.
        sigma_rad: Standard deviation of each direction [rad].
        track: Number of the point that each sees.
        count: Number of points.

    Returns:
        The points. A camera on the axis does not tell how far they are: then `valid` is False.
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
    station: Float[np.ndarray, "n 4 4"],
    step: Float[np.ndarray, " params"] | None = None,
) -> Float[np.ndarray, "n 2"]:
    """Pixels at which points of the room are seen at the table's angles.

    Args:
        scanner: The scanner.
        point: Points of the room [m].
        angle: The table's angle of each [rad from home].
        station: T_room_scanner of each.
        step: Of the scanner in its minimal coordinates.
    """
    rig = scanner.rig if step is None else scanner.rig.retract(step)
    return np.asarray(pixels(rig, transform(invert(station), point), angle))


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
    """The tracks with their points triangulated again.

    Args:
        tracks: Tracks.
        sweeps: The sweeps that they were seen in.
        scanner: The scanner.
        stations: T_room_scanner of each station; None: each point by the first station that sees it, in its frame.

    Returns:
        The tracks without those of which no point is in front of the camera, within 30 m.
    """
    count = len(tracks.point)
    station = np.array([sweep.station for sweep in sweeps])[tracks.sweep]
    use = np.ones(len(station), bool)
    if stations is None:
        first = np.full(count, np.iinfo(int).max)
        np.minimum.at(first, tracks.track, station)
        use = station == first[tracks.track]
        poses = np.broadcast_to(np.eye(4), (len(station), 4, 4))
    else:
        poses = np.asarray(stations)[station]
    found = _points(tracks, sweeps, scanner, poses, use)
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
    """Targets as one sweep alone sees them.

    Args:
        tracks: Tracks.
        sweep: Number of the sweep.
        sweeps: All sweeps.
        scanner: The scanner.

    Returns:
        By name, the point in the frame of that sweep's scanner [m], and its covariance by the sightings' noise.
    """
    mine = tracks.sweep == sweep
    poses = np.broadcast_to(np.eye(4), (len(mine), 4, 4))
    found = _points(tracks, sweeps, scanner, poses, mine)
    views = np.bincount(tracks.track[mine], minlength=len(tracks.point))
    good = found.valid & (views >= 2)
    return {name: (found.point[k], found.covariance[k]) for k, name in enumerate(tracks.name) if name and good[k]}


def _points(
    tracks: Tracks, sweeps: Sequence[SweepStripes], scanner: Scanner, poses: np.ndarray, use: np.ndarray
) -> Triangulated:
    """Points of all tracks by the sightings in `use`, bool [sightings]."""
    angle = np.array([sweeps[s].angle[r] for s, r in zip(tracks.sweep, tracks.record, strict=True)])
    focal = float(np.mean([scanner.camera.fx, scanner.camera.fy]))
    rays = rays_of(scanner, tracks.q[use], angle[use], poses[use])
    return triangulate(rays, tracks.sigma[use] / focal, tracks.track[use], len(tracks.point))
