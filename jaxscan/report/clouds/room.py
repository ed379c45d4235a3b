"""What a room's picture is marked with: its dimensions, the table's angle 0, and the floor that no camera sees."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from jaxscan.measurement import Dimension, RoomBox
from jaxscan.measurement.samples import Cloud, places_of
from jaxscan.report.clouds.view import room_box


ON_THE_FLOOR_M = 0.06
SMALLEST_HOLE_M = 0.15
MOST_STATIONS = 8
"""Stations that are marked in a picture."""


class Axis(NamedTuple):
    """A direction of a room."""

    direction: np.ndarray
    """Unit vector [3]."""
    low: float
    """Of the nearer wall along the direction [m]."""
    high: float
    dimension: Dimension | None
    """From wall to wall; None where one of the two was not found, and the ends are those of the points."""


@dataclass(frozen=True)
class Room:
    """A room as its picture shows it."""

    axes: tuple[Axis, Axis, Axis]
    """The two horizontal ones, and that which points up."""
    stations: np.ndarray
    """Where the scanner stood, and its x axis [stations, 2, 3]; none for a cloud that was not turned."""
    hole_m: float | None
    """Radius of the floor under the first station that has no points [m]; None where there is none."""

    def at(self, shares: np.ndarray) -> np.ndarray:
        """Places [n, 3], m, by their shares of the way through the room along its axes [n, 3]."""
        along = np.array([axis.low + shares[:, i] * (axis.high - axis.low) for i, axis in enumerate(self.axes)])
        return np.linalg.solve(np.array([axis.direction for axis in self.axes]), along).T

    @property
    def extent(self) -> float:
        """Of its longest side [m]."""
        return max(axis.high - axis.low for axis in self.axes)

    def foot(self, place: np.ndarray) -> np.ndarray:
        """The point of the floor [3], m, below a place [3], m."""
        up = self.axes[2]
        return place + (up.low - up.direction @ place) * up.direction


def room_of(cloud: Cloud, box: RoomBox | None) -> Room:
    """What there is to say about the room of a cloud.

    Args:
        cloud: With one valid point at least, z up.
        box: Its dimensions, where some were measured.
    """
    xyz = np.asarray(cloud.xyz, np.float64)[np.asarray(cloud.valid)]
    axes = _axes(xyz, box)
    places = places_of(cloud)
    stations = np.stack([places.pose[:, :3, 3], places.pose[:, :3, 0]], 1) if is_turned(cloud) else np.zeros((0, 2, 3))
    room = Room(axes, stations[:MOST_STATIONS], None)
    if not len(stations):
        return room
    return Room(axes, room.stations, _hole(xyz, room.foot(stations[0, 0]), axes[2]))


def is_turned(cloud: Cloud) -> bool:
    """Whether the profiles of a cloud point where a table of their angles would have turned them."""
    valid, angle = np.asarray(cloud.valid), np.asarray(cloud.angle, np.float64)
    if np.ptp(angle) == 0:
        return False
    places = places_of(cloud)
    xyz = np.asarray(cloud.xyz, np.float64) - places.pose[places.number][:, None, :3, 3]
    ahead = np.where(valid[..., None], xyz, 0.0).sum(1)
    local = np.einsum("pji,pj->pi", places.pose[places.number][:, :3, :3], ahead)
    azimuth = np.arctan2(local[:, 1], local[:, 0])[valid.any(1)]
    turned = angle[valid.any(1)]
    apart = np.abs([np.mean(np.exp(1j * (azimuth - sense * turned))) for sense in (1.0, -1.0)])
    return bool(apart.max() > 0.8)


def _axes(xyz: np.ndarray, box: RoomBox | None) -> tuple[Axis, Axis, Axis]:
    found = [] if box is None else [side for side in (box.length, box.width, box.height) if side is not None]
    level = [side for side in found if side is not (box and box.height)]
    directions = room_box(xyz)[0] if not level else _upright(level[0].direction)
    axes = []
    for direction in directions:
        side = max(found, key=lambda each: abs(each.direction @ direction), default=None)
        if side is None or box is None or abs(side.direction @ direction) < 0.8:
            low, high = np.percentile(xyz @ direction, [0.5, 99.5])
            axes.append(Axis(direction, float(low), float(high), None))
            continue
        exact = side.direction * np.sign(side.direction @ direction)
        middle = float(exact @ box.centre_m)
        axes.append(Axis(exact, middle - 0.5 * side.value_m, middle + 0.5 * side.value_m, side))
    return axes[0], axes[1], axes[2]


def _upright(along: np.ndarray) -> np.ndarray:
    """Two horizontal directions, the first near `along`, and the vertical [3, 3]."""
    level = np.array([along[0], along[1], 0.0]) / np.linalg.norm(along[:2])
    return np.array([level, [-level[1], level[0], 0.0], [0.0, 0.0, 1.0]])


def _hole(xyz: np.ndarray, foot: np.ndarray, up: Axis) -> float | None:
    floor = xyz[np.abs(xyz @ up.direction - up.low) < ON_THE_FLOOR_M]
    if len(floor) < 100:
        return None
    apart = floor - foot
    radius = float(np.percentile(np.linalg.norm(apart - np.outer(apart @ up.direction, up.direction), axis=1), 0.5))
    return radius if radius > SMALLEST_HOLE_M else None


def dimension_text(side: Dimension) -> str:
    """A dimension with the digits of `jaxscan measure room`: its value, and one standard deviation."""
    return f"{side.value_m:.4f} m ± {1e3 * side.sigma_m:.2f} mm"
