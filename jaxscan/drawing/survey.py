"""The contents of drawings of a room: its outline, the openings of its walls, and its surfaces."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from jaxscan.geometry import Scanner
from jaxscan.measurement.grid import Quads, quads_of
from jaxscan.measurement.outline import Opening, RoomOutline, Side, find_openings, measure_outline
from jaxscan.measurement.outline.cells import distance_to, is_within
from jaxscan.measurement.samples import Cloud, places_of


WALL_M = 0.06
"""Surfaces nearer than this to a wall are drawn as the wall or as what hangs on it [m]."""


@dataclass(frozen=True)
class Survey:
    """A room that was measured, in the frame of its plan [m]."""

    outline: RoomOutline
    openings: list[list[list[Opening]]]
    quads: Quads
    p: np.ndarray
    """Points of the cells [cells, 3]."""
    eye: np.ndarray
    """Where they were seen from [cells, 3]."""

    def frame_words(self) -> str:
        """Where origin and x of the plan are in the cloud."""
        frame = self.outline.frame
        origin = " ".join(f"{value:.3f}" for value in frame.back(np.zeros(3)))
        turned = np.degrees(np.arctan2(frame.rotation[0, 1], frame.rotation[0, 0]))
        return f"origin at {origin} m of the cloud, x turned by {turned:.2f}°"

    def walls(self) -> Iterator["Wall"]:
        """All sides of all loops, from corner to corner on the floor."""
        for loop, corners, openings in zip(self.outline.loops, self.outline.corners(), self.openings, strict=True):
            at = np.array([corner.at[:2] for corner in corners])
            yield from map(Wall, loop, at, np.roll(at, -1, 0), openings)

    def is_inside(self, p: np.ndarray) -> np.ndarray:
        """Which points [n, 2 or 3] are within the outline, and not on a wall [n]."""
        clear = is_within([np.array([corner.at[:2] for corner in loop]) for loop in self.outline.corners()], p)
        for wall in self.walls():
            if wall.side.seen:
                clear &= distance_to(wall.start, wall.end, p[:, :2]) > WALL_M
        return clear


class Wall(NamedTuple):
    """A side of the outline."""

    side: Side
    start: np.ndarray
    """Its first corner [2], m."""
    end: np.ndarray
    """Its last corner [2], m; the room is on the left of the way there."""
    openings: list[Opening]

    @property
    def along(self) -> np.ndarray:
        """Unit vector from the first corner to the last [2]."""
        return np.asarray((self.end - self.start) / np.linalg.norm(self.end - self.start))

    @property
    def inward(self) -> np.ndarray:
        """Unit vector into the room [2]."""
        return np.array([-self.along[1], self.along[0]])


def survey_room(cloud: Cloud, *, scanner: Scanner | None = None) -> Survey:
    """Measure all that drawings of a room show.

    Args:
        cloud: The room, scanned from within, with its grid.
        scanner: The scanner it was made with; its covariance gives the systematic part of sigmas.

    Returns:
        The room, in the frame of its plan.

    Raises:
        MeasurementError: If there is no floor, no walls around the scanner, or no grid.
    """
    quads = quads_of(cloud)
    outline = measure_outline(cloud, scanner=scanner)
    places = places_of(cloud)
    lines = np.asarray(cloud.xyz).shape[1]
    eye = np.repeat(places.pose[places.number, :3, 3], lines, 0)
    p = np.asarray(cloud.xyz, np.float64).reshape(-1, 3)
    openings = find_openings(cloud, outline, scanner=scanner)
    return Survey(outline, openings, quads, outline.frame.of(p), outline.frame.of(eye))


def outward(at: np.ndarray, distance_m: float) -> np.ndarray:
    """The corners of a loop [n, 2] moved out of the room, so that each side is displaced by a distance [n, 2], m."""
    along = np.roll(at, -1, 0) - at
    along /= np.linalg.norm(along, axis=1)[:, None]
    out = np.stack([along[:, 1], -along[:, 0]], 1)
    before = np.roll(out, 1, 0)
    # Between sides that are almost parallel the corner would be far away.
    share = np.maximum(1.0 + (before * out).sum(1), 0.2)
    return at + distance_m * (before + out) / share[:, None]
