"""Points of tracks in the room, once the stations are known, and named points of one sweep."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jaxscan.geometry import Scanner
from jaxscan.recalibration.observed import SweepStripes, Tracks
from jaxscan.recalibration.tracks.triangulate import Triangulated, rays_of, triangulate


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
