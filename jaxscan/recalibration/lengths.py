"""Lengths that somebody measured in the room: between which walls or targets they are, and whether they can be true."""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from jaxscan.errors import GivenError
from jaxscan.geometry import Scanner, root_of
from jaxscan.measurement.planes import Plane, feet_on, weighted_plane
from jaxscan.recalibration.observed import (
    KnownLength,
    MeasuredLength,
    Place,
    RoomObservations,
    Surfaces,
    SweepStripes,
    Tracks,
)
from jaxscan.recalibration.result import FoundLength, Start
from jaxscan.recalibration.tracks import named_points
from jaxscan.recalibration.triangulate import place_points, triangulate_points


# An end that is farther than this from every surface was not meant.
_NEAR_M = 0.3
# A point that is farther than this from the plane of its wall is on something else.
_ON_M = 0.05
# Walls between which there is one length: opposite ones, or steps of one wall.
_PARALLEL = np.cos(np.radians(5.0))


def place_lengths(
    lengths: Sequence[MeasuredLength], observations: RoomObservations, start: Start
) -> tuple[KnownLength, ...]:
    """The walls or targets between which lengths were measured; points are placed as `start` has them.

    Raises:
        GivenError: If an end is near no wall, no target has its name, both ends are the same, or they lie on
            walls that are not parallel.
    """
    if not lengths:
        return ()
    room, valid = place_points(start.scanner, observations, start.corrections, stations=start.stations)
    near, surfaces = (room[valid], observations.points.surface[valid]), observations.surfaces
    found = []
    for number, length in enumerate(lengths):
        name, ends = length.name or f"known length {number + 1}", (length.first, length.second)
        targets = isinstance(length.first, str)
        if targets != isinstance(length.second, str):
            raise GivenError(f"{name}: one end is a target, the other a point; expected two of one kind.")
        if targets:
            first, second = (_target(name, place, observations.tracks) for place in ends)
        else:
            first, second = (_wall(name, place, surfaces, *near) for place in ends)
        if first == second:
            raise GivenError(f"{name}: both ends are on one surface or target; expected two.")
        metres = float(length.metres)
        if not targets:
            _check_parallel(name, surfaces, (first, second))
            metres = _between_centres(length, surfaces, (first, second))
        found.append(KnownLength(metres, float(length.sigma_m), "tracks" if targets else "surfaces", first, second))
    return tuple(found)


def _target(name: str, place: Place, tracks: Tracks | None) -> int:
    known = () if tracks is None else tracks.name
    if place not in known:
        some = ", ".join(sorted({each for each in known if each})[:8]) or "none"
        raise GivenError(f"{name}: no target is called {place}; found {some}.")
    return known.index(str(place))


def _wall(name: str, place: Place, surfaces: Surfaces, room: np.ndarray, surface: np.ndarray) -> int:
    """The number of the wall at a place, by points of the room [n, 3] and the surface of each [n]."""
    point = np.asarray(place, np.float64)
    away = np.linalg.norm(room - point, axis=1)
    nearest = int(np.argmin(away)) if len(away) else -1
    if nearest < 0 or away[nearest] > _NEAR_M:
        where = ", ".join(f"{x:.2f}" for x in point)
        far = f"; the nearest is {away[nearest]:.2f} m away" if nearest >= 0 else ""
        raise GivenError(
            f"{name}: no surface within {_NEAR_M:g} m of ({where}) m{far}; "
            "give a point on the wall as measured in the cloud."
        )
    number = int(surface[nearest])
    off = abs(float(surfaces.normal[number] @ point) - float(surfaces.distance[number]))
    if off > _ON_M:
        raise GivenError(
            f"{name}: found an end {100 * off:.0f} cm off the plane of the nearest flat surface, expected at most "
            f"{100 * _ON_M:.0f} cm; give a point on a wall as measured in the cloud."
        )
    return number


def _check_parallel(name: str, surfaces: Surfaces, ends: tuple[int, int]) -> None:
    cosine = abs(float(surfaces.normal[ends[0]] @ surfaces.normal[ends[1]]))
    if cosine < _PARALLEL:
        raise GivenError(
            f"{name}: its ends lie on walls at {np.degrees(np.arccos(cosine)):.0f} degrees to each other, expected "
            "parallel ones; give a point on each of two opposite walls."
        )


def _between_centres(length: MeasuredLength, surfaces: Surfaces, ends: tuple[int, int]) -> float:
    """The length midway between the centres of both walls, where the adjustment has it [m].

    It was measured midway between the user's points. The walls as they were found give the difference, which is small
    where they are nearly parallel. The result is rounded to a nanometre.
    """
    normal, distance, centre = surfaces
    # Neither axes nor covariance are used.
    planes = [Plane(normal[k], float(distance[k]), centre[k], np.zeros((2, 3)), np.zeros((3, 3))) for k in ends]
    apart = lambda middle: float(np.abs(np.diff(feet_on(planes, middle)[1])[0]))
    measured = (np.asarray(length.first, np.float64) + np.asarray(length.second, np.float64)) / 2
    centres = (surfaces.centre[ends[0]] + surfaces.centre[ends[1]]) / 2
    return round(float(length.metres) + apart(centres) - apart(measured), 9)


def lost_lengths(lengths: Sequence[KnownLength], kept: Sequence[int]) -> list[str]:
    """A sentence for each length that goes because one of its walls is not among those that are kept as flat."""
    return [
        f"known length {number + 1} ({length.metres:.4g} m) is left out, because one of its ends is on a surface that "
        "is not flat: it holds no scale; measure between flat walls"
        for number, length in enumerate(lengths)
        if length.between == "surfaces" and not {length.first, length.second} <= set(kept)
    ]


# A length that differs by more than this was misread, mistyped, or measured somewhere else.
_SIGMAS = 6.0
# The same if the rig was knocked: its sigmas are tolerances already.
_LOOSE_SIGMAS = 3.0
# A length that the scanner of the sweeps misses by so much contradicts them, or the other lengths.
_MISSED_SIGMAS = 10.0
# Points of a surface that are looked at.
_POINTS = 200


def check_lengths(
    observations: RoomObservations, sweeps: Sequence[SweepStripes], stored: Scanner, loose: Scanner
) -> list[str]:
    """Refuse a known length that contradicts the stored calibration even if the rig was knocked, as `loose` has it.

    The standard deviation of the comparison is that of the calibration, with those of the length as it was measured
    and of the surfaces. Lengths whose ends no single sweep sees are not compared.

    Returns:
        A sentence for each length that only a rig that was knocked explains.

    Raises:
        GivenError: With both lengths.
    """
    notes = []
    for number, known, metres, noise in _found(observations, sweeps, stored):
        own, knocked = (_sigma_of_calibration(known, observations, sweeps, one) for one in (stored, loose))
        measured = np.hypot(known.sigma_m, noise)
        limit = _SIGMAS * float(np.hypot(measured, own))
        farthest = max(limit, _LOOSE_SIGMAS * float(np.hypot(measured, knocked)))
        said = f"known length {number}: found {metres:.4f} m by the stored calibration, expected {known.metres:.4f} m"
        off = abs(metres - known.metres)
        if off > farthest:
            raise GivenError(
                f"{said} within {1e3 * farthest:.2g} mm; check its number and its ends; if the "
                "rig was knocked, leave the length out and recalibrate first."
            )
        if off > limit:
            notes.append(f"{said} within {1e3 * limit:.2g} mm; if the rig was not knocked, measure it again")
    return notes


def check_adjusted(observations: RoomObservations, sweeps: Sequence[SweepStripes], scanner: Scanner) -> None:
    """Refuse a known length that the new scanner misses, with its covariance; arguments as of `check_lengths`.

    Raises:
        GivenError: With both lengths.
    """
    for number, known, metres, noise in _found(observations, sweeps, scanner):
        own = _sigma_of_calibration(known, observations, sweeps, scanner)
        limit = _MISSED_SIGMAS * float(np.linalg.norm([known.sigma_m, noise, own]))
        if abs(metres - known.metres) > limit:
            raise GivenError(
                f"known length {number}: found {metres:.4f} m by these sweeps, expected "
                f"{known.metres:.4f} m within {1e3 * limit:.2g} mm; it contradicts them or the other lengths: "
                "measure it again in metres, or leave it out."
            )


def found_lengths(
    observations: RoomObservations, sweeps: Sequence[SweepStripes], scanner: Scanner
) -> tuple[FoundLength, ...]:
    """The known lengths as a scanner finds them, without those whose ends no single sweep sees."""
    found = _found(observations, sweeps, scanner)
    return tuple(FoundLength(known.metres, known.sigma_m, metres) for _, known, metres, _ in found)


def _found(
    observations: RoomObservations, sweeps: Sequence[SweepStripes], scanner: Scanner
) -> Iterator[tuple[int, KnownLength, float, float]]:
    """Number, known length, length as found, and the sigma of that; see `_length`."""
    for number, known in enumerate(observations.lengths, 1):
        found = _length(known, observations, sweeps, scanner)
        if found is not None:
            yield number, known, *found


def _sigma_of_calibration(
    known: KnownLength, observations: RoomObservations, sweeps: Sequence[SweepStripes], stored: Scanner
) -> float:
    """Standard deviation of the length that the stored calibration causes [m]."""
    # Both ways, so that a bend of the length over a sigma does not count.
    changes = []
    for step in root_of(np.asarray(stored.covariance, np.float64)):
        if np.any(step):
            ends = [_length(known, observations, sweeps, stored.retract(way * step)) for way in (1.0, -1.0)]
            changes.append((ends[0][0] - ends[1][0]) / 2 if ends[0] and ends[1] else 0.0)
    return float(np.linalg.norm(changes))


def _length(
    known: KnownLength, observations: RoomObservations, sweeps: Sequence[SweepStripes], scanner: Scanner
) -> tuple[float, float] | None:
    """A length within the sweep that sees both of its ends best, and its sigma by noise and by walls that are not
    flat, without the calibration [m]."""
    if known.between == "tracks":
        return _between_targets(known, observations, sweeps, scanner)
    points, ends = observations.points, (known.first, known.second)
    seen = [np.bincount(points.sweep[points.surface == end], minlength=len(sweeps)) for end in ends]
    sweep = int(np.argmax(np.minimum(*seen)))
    clouds = []
    for end in ends:
        mine = np.flatnonzero((points.surface == end) & (points.sweep == sweep))
        some = points.take(mine[:: max(1, -(-len(mine) // _POINTS))])
        where, valid = triangulate_points(scanner, some.q, some.laser, sweeps[sweep].angle[some.record])
        clouds.append(where[valid])
    return _between_planes(*clouds) if min(len(cloud) for cloud in clouds) >= 3 else None


def _between_planes(first: Float[np.ndarray, "n 3"], second: Float[np.ndarray, "m 3"]) -> tuple[float, float]:
    """Along the mean normal, midway between the centres, as the adjustment has it."""
    planes = [weighted_plane(cloud, np.ones(len(cloud))) for cloud in (first, second)]
    _, feet = feet_on(planes, (planes[0].centre + planes[1].centre) / 2)
    # Roughness and bend of walls limit how well their mean planes are known.
    both = zip((first, second), planes, strict=True)
    flat = [np.mean(((cloud - plane.centre) @ plane.normal) ** 2) for cloud, plane in both]
    return abs(feet[0] - feet[1]), float(np.sqrt(sum(flat)))


def _between_targets(
    known: KnownLength, observations: RoomObservations, sweeps: Sequence[SweepStripes], scanner: Scanner
) -> tuple[float, float] | None:
    tracks = observations.tracks
    if tracks is None:
        return None
    mine = np.isin(tracks.track, (known.first, known.second))
    fields = ("q", "sigma", "sweep", "record", "track")
    tracks = tracks._replace(**{name: getattr(tracks, name)[mine] for name in fields})
    for sweep in np.unique(tracks.sweep):
        found = named_points(tracks, int(sweep), sweeps, scanner)
        ends = [found.get(tracks.name[track]) for track in (known.first, known.second)]
        if ends[0] is not None and ends[1] is not None:
            between = ends[0][0] - ends[1][0]
            metres = float(np.linalg.norm(between))
            way = between / metres
            return metres, float(np.sqrt(way @ (ends[0][1] + ends[1][1]) @ way))
    return None
