"""Known lengths by the places of their ends, as lengths between surfaces or targets."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxscan.errors import GivenError
from jaxscan.recalibration.adjust import triangulate_points
from jaxscan.recalibration.adjusted import Start
from jaxscan.recalibration.given import MeasuredLength, Place
from jaxscan.recalibration.observed import KnownLength, RoomObservations, Surfaces, Tracks


# An end that is farther than this from every surface was not meant.
_NEAR_M = 0.3
# A point that is farther than this from the plane of its wall is on something else.
_ON_M = 0.05
# Walls between which there is one length: opposite ones, or steps of one wall.
_PARALLEL = np.cos(np.radians(5.0))


class _Near(NamedTuple):
    """Surfaces, and points on them in the frame of the room."""

    surfaces: Surfaces
    room: np.ndarray
    surface: np.ndarray


def place_lengths(
    lengths: Sequence[MeasuredLength], observations: RoomObservations, start: Start
) -> tuple[KnownLength, ...]:
    """The surfaces or targets between which lengths were measured.

    Args:
        lengths: By the places of their ends.
        observations: Surfaces with points on them, and tracks.
        start: Scanner, stations and angles with which the points are placed.

    Raises:
        GivenError: If an end is near no surface, no target has its name, both ends are the same, or they lie on
            walls that are not parallel.
    """
    if not lengths:
        return ()
    points = observations.points
    corrections = start.corrections or tuple(np.zeros(len(angle)) for angle in observations.angles)
    begin = np.cumsum([0, *(len(angle) for angle in observations.angles)])[points.sweep]
    angle = (np.concatenate(observations.angles) + np.concatenate(corrections))[begin + points.record]
    poses = np.asarray(start.stations)[np.asarray(observations.station)[points.sweep]]
    room, valid = triangulate_points(start.scanner, points.q, points.laser, angle, poses)
    found = []
    for number, length in enumerate(lengths):
        name = length.name or f"known length {number + 1}"
        kinds = [isinstance(place, str) for place in (length.first, length.second)]
        if kinds[0] != kinds[1]:
            raise GivenError(f"{name}: one end is a target, the other a point; expected two of one kind.")
        if kinds[0]:
            ends = [_target(name, place, observations.tracks) for place in (length.first, length.second)]
        else:
            near = _Near(observations.surfaces, room[valid], points.surface[valid])
            ends = [_surface(name, place, near) for place in (length.first, length.second)]
            _check_parallel(name, observations.surfaces, ends)
        if ends[0] == ends[1]:
            raise GivenError(f"{name}: both ends are on one surface or target; expected two.")
        metres, sigma = float(length.metres), float(length.sigma_m)
        if not kinds[0] and observations.surfaces.kind[ends[0]] == "plane":
            metres = _between_centres(length, observations.surfaces, ends)
        found.append(KnownLength(metres, sigma, "tracks" if kinds[0] else "surfaces", *ends))
    return tuple(found)


def _target(name: str, place: Place, tracks: Tracks | None) -> int:
    known = () if tracks is None else tracks.name
    if place not in known:
        some = ", ".join(sorted({each for each in known if each})[:8]) or "none"
        raise GivenError(f"{name}: no target is called {place}; found {some}.")
    return known.index(str(place))


def _surface(name: str, place: Place, near: _Near) -> int:
    point = np.asarray(place, np.float64)
    for number, kind in enumerate(near.surfaces.kind):
        if kind == "sphere" and np.linalg.norm(near.surfaces.centre[number] - point) < near.surfaces.distance[number]:
            return number
    away = np.linalg.norm(near.room - point, axis=1)
    nearest = int(np.argmin(away)) if len(away) else -1
    if nearest < 0 or away[nearest] > _NEAR_M:
        where = ", ".join(f"{x:.2f}" for x in point)
        far = f"; the nearest is {away[nearest]:.2f} m away" if nearest >= 0 else ""
        raise GivenError(
            f"{name}: no surface within {_NEAR_M:g} m of ({where}) m{far}; "
            "give a point on the wall as measured in the cloud."
        )
    number = int(near.surface[nearest])
    normal, distance = near.surfaces.normal[number], float(near.surfaces.distance[number])
    if near.surfaces.kind[number] == "plane" and (off := abs(float(normal @ point) - distance)) > _ON_M:
        raise GivenError(
            f"{name}: found an end {100 * off:.0f} cm off the plane of the nearest flat surface, expected at most "
            f"{100 * _ON_M:.0f} cm; give a point on a wall as measured in the cloud."
        )
    return number


def _check_parallel(name: str, surfaces: Surfaces, ends: Sequence[int]) -> None:
    if any(surfaces.kind[end] != "plane" for end in ends):
        return
    cosine = abs(float(surfaces.normal[ends[0]] @ surfaces.normal[ends[1]]))
    if cosine < _PARALLEL:
        raise GivenError(
            f"{name}: its ends lie on walls at {np.degrees(np.arccos(cosine)):.0f} degrees to each other, expected "
            "parallel ones; give a point on each of two opposite walls."
        )


def _between_centres(length: MeasuredLength, surfaces: Surfaces, ends: Sequence[int]) -> float:
    """The length midway between the centres of both walls, where the adjustment has it [m].

    It was measured midway between the user's points. The walls as they were found tell the difference, which is small
    where they are nearly parallel; to a nanometre.
    """
    a, b = surfaces.normal[ends[0]], surfaces.normal[ends[1]]
    sign = -1.0 if a @ b < 0 else 1.0
    mean = (a + sign * b) / np.linalg.norm(a + sign * b)

    def apart(middle: np.ndarray) -> float:
        first, second = (
            (surfaces.distance[end] - surfaces.normal[end] @ middle) / (surfaces.normal[end] @ mean) for end in ends
        )
        return abs(float(first - second))

    measured = (np.asarray(length.first, np.float64) + np.asarray(length.second, np.float64)) / 2
    centres = (surfaces.centre[ends[0]] + surfaces.centre[ends[1]]) / 2
    return round(float(length.metres) + apart(centres) - apart(measured), 9)


def lost_lengths(lengths: Sequence[KnownLength], kept: Sequence[int]) -> list[str]:
    """A sentence for each length that goes because one of its surfaces is not flat.

    Args:
        lengths: Known ones.
        kept: Numbers of the surfaces that stay.
    """
    return [
        f"known length {number + 1} ({length.metres:.4g} m) is left out, because one of its ends is on a surface that "
        "is not flat: it holds no scale; measure between flat walls"
        for number, length in enumerate(lengths)
        if length.between == "surfaces" and not {length.first, length.second} <= set(kept)
    ]
