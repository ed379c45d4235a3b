"""Known lengths by the places of their ends, as lengths between surfaces or targets."""

from collections.abc import Sequence

import numpy as np

from jaxscan.errors import CalibrationError
from jaxscan.geometry import Scanner
from jaxscan.recalibration.adjust import triangulate_points
from jaxscan.recalibration.given import MeasuredLength, Place
from jaxscan.recalibration.observed import KnownLength, RoomObservations, Tracks


# An end that is farther than this from every surface was not meant.
_NEAR_M = 0.3


def place_lengths(
    lengths: Sequence[MeasuredLength], observations: RoomObservations, scanner: Scanner, stations: np.ndarray
) -> tuple[KnownLength, ...]:
    """The surfaces or targets between which lengths were measured.

    Args:
        lengths: By the places of their ends.
        observations: Surfaces with points on them, and tracks.
        scanner: With which the points are placed.
        stations: T_room_scanner of every station.

    Raises:
        CalibrationError: If an end is near no surface, no target has its name, or both ends are the same.
    """
    if not lengths:
        return ()
    points = observations.points
    angle = np.concatenate(observations.angles)[_starts(observations)[points.sweep] + points.record]
    poses = np.asarray(stations)[np.asarray(observations.station)[points.sweep]]
    room, valid = triangulate_points(scanner, points.q, points.laser, angle, poses)
    found = []
    for number, length in enumerate(lengths):
        name = length.name or f"known length {number + 1}"
        kinds = [isinstance(place, str) for place in (length.first, length.second)]
        if kinds[0] != kinds[1]:
            raise CalibrationError(f"{name}: one end is a target, the other a point; expected two of one kind.")
        if kinds[0]:
            ends = [_target(name, place, observations.tracks) for place in (length.first, length.second)]
        else:
            own = points.surface[valid]
            ends = [_surface(name, place, room[valid], own) for place in (length.first, length.second)]
        if ends[0] == ends[1]:
            raise CalibrationError(f"{name}: both ends are on one surface or target; expected two.")
        metres, sigma = float(length.metres), float(length.sigma_m)
        found.append(KnownLength(metres, sigma, "tracks" if kinds[0] else "surfaces", *ends))
    return tuple(found)


def _starts(observations: RoomObservations) -> np.ndarray:
    return np.cumsum([0, *(len(angle) for angle in observations.angles)])[:-1]


def _target(name: str, place: Place, tracks: Tracks | None) -> int:
    known = () if tracks is None else tracks.name
    if place not in known:
        some = ", ".join(sorted({each for each in known if each})[:8]) or "none"
        raise CalibrationError(f"{name}: no target is called {place}; found {some}.")
    return known.index(str(place))


def _surface(name: str, place: Place, room: np.ndarray, surface: np.ndarray) -> int:
    away = np.linalg.norm(room - np.asarray(place, np.float64), axis=1)
    nearest = int(np.argmin(away)) if len(away) else -1
    if nearest < 0 or away[nearest] > _NEAR_M:
        where = ", ".join(f"{float(x):.2f}" for x in np.asarray(place))
        far = f"; the nearest is {away[nearest]:.2f} m away" if nearest >= 0 else ""
        raise CalibrationError(
            f"{name}: no surface within {_NEAR_M:g} m of ({where}) m{far}; "
            "give a point on the wall as measured in the cloud."
        )
    return int(surface[nearest])
