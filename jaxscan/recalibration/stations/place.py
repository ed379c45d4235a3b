"""First poses of several stations of one room."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from jaxscan.errors import CalibrationError
from jaxscan.geometry import Scanner
from jaxscan.recalibration.observed import SweepStripes, Tracks
from jaxscan.recalibration.stations.pair import Pair, Station, place_pair
from jaxscan.recalibration.stations.view import Landmarks, find_landmarks, look_around, see_space


def place_stations(
    sweeps: Sequence[SweepStripes],
    scanner: Scanner,
    *,
    tracks: Tracks | None = None,
    landmarks: Mapping[int, Landmarks] | None = None,
    start: Mapping[int, np.ndarray] | None = None,
) -> np.ndarray:
    """First poses of the stations, good to a few centimetres and a degree; an adjustment makes them exact.

    Two stations are placed by their walls: guesses that bring walls onto walls are settled on flat patches, and judged
    by all points: where one station looked through, the other must see nothing. A box room fits itself in two ways or
    more; furniture decides, or landmarks, or a first pose. More stations form a tree, best pairs first.

    Args:
        sweeps: Sweeps with the numbers of their stations, 0 to S - 1.
        scanner: The stored scanner.
        tracks: Targets by name that several stations see; features without names are not used.
        landmarks: More points by name, such as middles of known spheres: for each station, its own coordinates [m].
        start: A first pose T_room_scanner for some of the stations, good to half a metre and ten degrees.

    Returns:
        T_room_scanner [S, 4, 4]; the identity for station 0.

    Raises:
        CalibrationError: If a station sees too little of the surfaces that others see, or fits in several places.
    """
    numbers = sorted({sweep.station for sweep in sweeps})
    if numbers != list(range(len(numbers))):
        raise CalibrationError(f"stations: found the numbers {numbers}, expected 0 to {len(numbers) - 1}.")
    poses = np.tile(np.eye(4), (len(numbers), 1, 1))
    if len(numbers) < 2:
        return poses
    known = {0: np.eye(4), **(start or {})}
    stations = [_station(number, sweeps, scanner, tracks, (landmarks or {}).get(number, {})) for number in numbers]
    tried: dict[tuple[int, int], Pair | CalibrationError] = {}
    for a in numbers:
        for b in numbers[a + 1 :]:
            first = np.linalg.inv(known[a]) @ known[b] if a in known and b in known and start else None
            try:
                tried[a, b] = place_pair(stations[a], stations[b], first=first)
            except CalibrationError as problem:
                tried[a, b] = problem
    for found in _tree(tried, len(numbers)):
        poses[found.new] = poses[found.old] @ found.pose
    return poses


class _Step(NamedTuple):
    old: int
    new: int
    pose: np.ndarray
    """T_old_new."""


def _tree(tried: Mapping[tuple[int, int], Pair | CalibrationError], count: int) -> list[_Step]:
    """The way to every station from station 0, over the pairs that see most in common."""
    pairs = {key: pair for key, pair in tried.items() if isinstance(pair, Pair)}
    reached, steps = {0}, []
    while len(reached) < count:
        ways = {key: pair for key, pair in pairs.items() if (key[0] in reached) != (key[1] in reached)}
        if not ways:
            problems = [p for key, p in tried.items() if (key[0] in reached) != (key[1] in reached)]
            raise next(p for p in problems if isinstance(p, CalibrationError))
        (a, b), pair = max(ways.items(), key=lambda item: item[1].share)
        steps.append(_Step(a, b, pair.pose) if a in reached else _Step(b, a, np.linalg.inv(pair.pose)))
        reached.add(steps[-1].new)
    return steps


def _station(
    number: int, sweeps: Sequence[SweepStripes], scanner: Scanner, tracks: Tracks | None, more: Landmarks
) -> Station:
    mine = [k for k, sweep in enumerate(sweeps) if sweep.station == number]
    view = look_around([sweeps[k] for k in mine], scanner)
    marks = {} if tracks is None else find_landmarks(tracks, {k: sweeps[k] for k in mine}, scanner, view)
    return Station(sweeps[mine[0]].name, view, see_space(view), {**marks, **more})
