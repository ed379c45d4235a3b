"""Everything that one adjustment takes in: planes, spheres, tracks, known lengths, boards."""

from collections.abc import Sequence

import numpy as np

from jaxscan.errors import CalibrationError, GivenError
from jaxscan.geometry import invert, transform
from jaxscan.recalibration.lengths import place_lengths
from jaxscan.recalibration.observed import (
    Given,
    KnownSphere,
    RecalibrationSettings,
    RoomObservations,
    SurfacePoints,
    Surfaces,
    SweepStripes,
)
from jaxscan.recalibration.result import Start
from jaxscan.recalibration.segment import Sphere, find_sphere, observe_surfaces
from jaxscan.recalibration.tracks import place_tracks


def observe_room(
    sweeps: Sequence[SweepStripes], start: Start, given: Given, settings: RecalibrationSettings
) -> RoomObservations:
    """Surfaces of the room and points on them, found with a scanner as it is, and everything that was given.

    Args:
        sweeps: Stripes of each, with the angles of its journal.
        start: The scanner, whose covariance says how far it may bend a wall; stations and known faults of angles.
        given: Spheres, tracks, lengths, boards.
        settings: With the largest number of points.

    Raises:
        CalibrationError: If no plane is found.
        GivenError: If something that was given is not there.
    """
    turned = [one.turned(c) for one, c in zip(sweeps, start.corrections, strict=True)] if start.corrections else sweeps
    points, surfaces = observe_surfaces(turned, start.scanner, start.stations, settings.points)
    for number, sphere in enumerate(given.spheres):
        points, surfaces = _with_sphere(points, surfaces, _found(turned, start, sphere, number))
    tracks = given.tracks
    if tracks is not None and len(tracks.q):
        # They were observed before the stations and faults of angles were known.
        tracks = place_tracks(tracks, turned, start.scanner, start.stations)
    observed = RoomObservations(
        points=points,
        surfaces=surfaces,
        angles=tuple(np.asarray(sweep.angle, np.float64) for sweep in sweeps),
        station=np.array([sweep.station for sweep in sweeps], np.int32),
        stripe_axis=sweeps[0].stripe_axis,
        tracks=tracks,
        boards=given.boards,
    )
    return observed._replace(lengths=place_lengths(given.lengths, observed, start))


def _found(
    sweeps: Sequence[SweepStripes], start: Start, sphere: KnownSphere, number: int
) -> list[tuple[int, np.ndarray, Sphere]]:
    """The sphere in every sweep that sees it: number of the sweep, T_room_scanner, and the sphere."""
    found, problem = [], None
    for index in range(len(sweeps)) if sphere.sweep is None else (sphere.sweep,):
        if not 0 <= index < len(sweeps):
            raise GivenError(f"sphere {number + 1}: names sweep {index}, found {len(sweeps)} sweeps.")
        pose = np.asarray(start.stations[sweeps[index].station], np.float64)
        near = np.asarray(transform(invert(pose), np.asarray(sphere.near, np.float64)))
        try:
            found.append((index, pose, find_sphere(sweeps[index], start.scanner, near, sphere.diameter_m)))
        except CalibrationError as missed:
            problem = missed
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
    centre = transform(pose, first.centre)
    return SurfacePoints(*map(np.concatenate, zip(*parts, strict=True))), Surfaces(
        kind=(*surfaces.kind, "sphere"),
        normal=np.concatenate([surfaces.normal, np.zeros((1, 3))]),
        distance=np.append(surfaces.distance, first.radius),
        centre=np.concatenate([surfaces.centre, centre[None]]),
    )
