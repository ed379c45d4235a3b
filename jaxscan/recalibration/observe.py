"""Everything that one adjustment takes in: planes, spheres, tracks, known lengths, boards."""

from collections.abc import Sequence

import numpy as np

from jaxscan.errors import CalibrationError, GivenError
from jaxscan.recalibration.given import Given, KnownSphere, RecalibrationSettings
from jaxscan.recalibration.lengths import place_lengths
from jaxscan.recalibration.observed import RoomObservations, SurfacePoints, Surfaces, SweepStripes, Tracks
from jaxscan.recalibration.result import Start
from jaxscan.recalibration.segment import Sphere, find_sphere, observe_surfaces
from jaxscan.recalibration.tracks import place_tracks


def observe_room(
    sweeps: Sequence[SweepStripes], start: Start, given: Given, settings: RecalibrationSettings
) -> RoomObservations:
    """Surfaces of the room and points on them, found with a scanner as it is, and everything that was given.

    Args:
        sweeps: Stripes of each.
        start: The scanner, whose covariance says how far it may bend a wall; stations and known faults of angles.
        given: Spheres, tracks, lengths, boards.
        settings: With the largest number of points.

    Raises:
        CalibrationError: If no plane is found.
        GivenError: If something that was given is not there.
    """
    points, surfaces = observe_surfaces(sweeps, start.scanner, start.stations, start.corrections, settings)
    for number, sphere in enumerate(given.spheres):
        points, surfaces = _with_sphere(points, surfaces, _found(sweeps, start, sphere, number))
    observed = RoomObservations(
        points=points,
        surfaces=surfaces,
        angles=tuple(np.asarray(sweep.angle, np.float64) for sweep in sweeps),
        station=np.array([sweep.station for sweep in sweeps], np.int32),
        stripe_axis=sweeps[0].stripe_axis,
        tracks=_placed(given.tracks, sweeps, start),
        boards=given.boards,
    )
    return observed._replace(lengths=place_lengths(given.lengths, observed, start))


def _placed(tracks: Tracks | None, sweeps: Sequence[SweepStripes], start: Start) -> Tracks | None:
    """Tracks with their points in the room: they were observed before the stations and faults of angles were known."""
    if tracks is None or not len(tracks.q):
        return tracks
    corrections = start.corrections or tuple(np.zeros(len(sweep.angle)) for sweep in sweeps)
    turned = [s._replace(angle=s.angle + c) for s, c in zip(sweeps, corrections, strict=True)]
    return place_tracks(tracks, turned, start.scanner, start.stations)


def _found(
    sweeps: Sequence[SweepStripes], start: Start, sphere: KnownSphere, number: int
) -> list[tuple[int, np.ndarray, Sphere]]:
    """The sphere in every sweep that sees it: number of the sweep, T_room_scanner, and the sphere."""
    found, problem = [], None
    for index in range(len(sweeps)) if sphere.sweep is None else (sphere.sweep,):
        if not 0 <= index < len(sweeps):
            raise GivenError(f"sphere {number + 1}: names sweep {index}, found {len(sweeps)} sweeps.")
        pose = np.asarray(start.stations[sweeps[index].station], np.float64)
        near = pose[:3, :3].T @ (np.asarray(sphere.near, np.float64) - pose[:3, 3])
        correction = start.corrections[index] if start.corrections else None
        try:
            one = find_sphere(sweeps[index], start.scanner, near, sphere.diameter_m, correction)
        except CalibrationError as missed:
            problem = missed
        else:
            found.append((index, pose, one))
    if not found:
        raise GivenError(f"sphere {number + 1}: {problem}") from problem
    return found


def _with_sphere(
    points: SurfacePoints, surfaces: Surfaces, found: list[tuple[int, np.ndarray, Sphere]]
) -> tuple[SurfacePoints, Surfaces]:
    number = len(surfaces.kind)
    parts = [points]
    for index, _, sphere in found:
        own = sphere.points
        parts.append(own._replace(sweep=np.full_like(own.sweep, index), surface=np.full_like(own.surface, number)))
    _, pose, first = found[0]
    centre = pose[:3, :3] @ first.centre + pose[:3, 3]
    return SurfacePoints(*(np.concatenate(fields) for fields in zip(*parts, strict=True))), Surfaces(
        kind=(*surfaces.kind, "sphere"),
        normal=np.concatenate([surfaces.normal, np.zeros((1, 3))]),
        distance=np.append(surfaces.distance, first.radius),
        centre=np.concatenate([surfaces.centre, centre[None]]),
    )
