"""Flat regions of all sweeps in one frame, and which of them are one surface."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxscan.recalibration.segment.cells import Cells
from jaxscan.recalibration.segment.regions import BentPlane, Region


_ALIKE = np.cos(np.radians(6.0))
"""Cosine of the angle between two parts of one surface, at most."""
_STEP_M, _TILT = 1.5e-3, 3e-3
"""Differences of two parts of one surface that are allowed beside their uncertainty [m, rad]."""
_SIGMAS = 3.0
_SURE_M = 2.5e-3
"""Uncertainty (of so many sigmas) of a difference up to which a step of 5 mm between two parts would be seen [m]."""
_SAME_M = 0.04
"""Difference of two parts that lie over each other at most [m]: two surfaces are not seen at one place."""
_GAP_M = 1.5
"""Distance of two parts of one surface at most [m]."""
_BIN_M = 0.15
"""Size of the squares in which it is seen whether parts lie over each other, at least [m]."""
_HOME_M = 0.15
"""Gap between the first and the last profiles of a sweep in which no edge is expected [m]."""
_OVER = 0.25
"""Share of the smaller part that lies over the other, from which they lie over each other."""
_STATION_M, _STATION_RAD = 0.01, 3e-3
"""Standard deviations of the given pose of a station."""
_SAMPLES, _MORE = 300, 4000
_LOCAL_M, _LOCAL = 0.4, 20
"""Around the place between two parts, points within this distance, of each part at least so many, show a step."""


class Piece(NamedTuple):
    """A flat region, in the frame of the room."""

    sweep: int
    station: int
    cells: Cells
    region: Region
    normal: Float[np.ndarray, "3"]
    distance: float
    centre: Float[np.ndarray, "3"]
    axes: Float[np.ndarray, "2 3"]
    points: Float[np.ndarray, "samples 3"]
    """Some of its points [m]."""
    dense: Float[np.ndarray, "more 3"]
    """More of them."""
    noise: float
    """Standard deviation of a cell along the normal [m]."""
    phi: float
    """Mean angle of the table [rad]."""

    @property
    def plane(self) -> BentPlane:
        """In the scanner's own frame."""
        return self.region.plane


def piece(sweep: int, station: int, cells: Cells, region: Region, pose: Float[np.ndarray, "4 4"]) -> Piece:
    """A region in the frame of the room.

    Args:
        sweep: Its number.
        station: Of the sweep.
        cells: The grid.
        region: A flat part of it.
        pose: T_room_scanner.
    """
    rotation, shift = pose[:3, :3], pose[:3, 3]
    plane = region.plane

    def sampled(count: int) -> np.ndarray:
        some = region.cells[np.unique(np.linspace(0, len(region.cells) - 1, count).round().astype(int))]
        return cells.p.reshape(-1, 3)[some] @ rotation.T + shift

    normal, centre = rotation @ plane.normal, rotation @ plane.centre + shift
    return Piece(
        sweep,
        station,
        cells,
        region,
        normal,
        float(normal @ centre),
        centre,
        plane.axes @ rotation.T,
        sampled(_SAMPLES),
        sampled(_MORE),
        float(np.median(cells.across(plane.normal).ravel()[region.cells])),
        float(cells.phi.ravel()[region.cells].mean()),
    )


def join(pieces: Sequence[Piece]) -> Int[np.ndarray, " pieces"]:
    """The surface of every piece; parts of one wall have the same.

    Two pieces are joined where they lie over each other or are neighbours, and where their planes agree at the place
    between them within the uncertainty by noise and calibration; neighbours only where that uncertainty is so small
    that a step would show.
    """
    agree: list[tuple[float, int, int]] = []
    apart = np.zeros((len(pieces), len(pieces)), bool)
    for i, a in enumerate(pieces):
        for j in range(i):
            b = pieces[j]
            if a.normal @ b.normal < _ALIKE:
                apart[i, j] = apart[j, i] = True
                continue
            same, rank = _same(a, b)
            if same is None:
                continue
            if same:
                agree.append((rank, i, j))
            else:
                apart[i, j] = apart[j, i] = True
    groups = [[k] for k in range(len(pieces))]
    of = list(range(len(pieces)))
    for _, i, j in sorted(agree):
        one, other = groups[of[i]], groups[of[j]]
        if one is other or apart[np.ix_(one, other)].any():
            continue
        for k in other:
            of[k] = of[i]
        one.extend(other)
    return np.unique(of, return_inverse=True)[1]


def _same(a: Piece, b: Piece) -> tuple[bool | None, float]:
    """Whether two pieces are one surface (None: it cannot be said), and a rank: the surest first."""
    away = np.linalg.norm(a.points[:, None] - b.points[None], axis=-1)
    i, j = np.unravel_index(np.argmin(away), away.shape)
    gap = float(away[i, j])
    over = _over(a, b)
    at = (a.points[i] + b.points[j]) / 2 if over < _OVER else (a.points.mean(0) + b.points.mean(0)) / 2
    step = (a.distance - a.normal @ at) - (b.distance - b.normal @ at)
    tilt = a.axes @ (a.normal - b.normal)
    by_a, by_b = _moves(a, at, a.axes), _moves(b, at, a.axes)
    if a.station == b.station:
        doubt = np.sqrt(((by_a - by_b) ** 2).sum(1))
    else:
        # The calibration is the same, but the poses are their own.
        pose = sum((_pose_moves(one, at, a.axes) ** 2).sum(1) for one in (a, b) if one.station > 0)
        doubt = np.sqrt(((by_a - by_b) ** 2).sum(1) + pose)
    size = np.sqrt(np.ptp(b.points @ a.axes.T, axis=0).min() * np.ptp(a.points @ a.axes.T, axis=0).min())
    sigma = np.hypot(a.noise / np.sqrt(len(a.region.cells)), b.noise / np.sqrt(len(b.region.cells)))
    own = _SIGMAS * sigma * np.array([1.0, 3.0 / size, 3.0 / size])
    limit = _SIGMAS * doubt + own + np.array([_STEP_M, _TILT, _TILT])
    if np.any(np.abs(np.append(step, tilt)) > limit):
        return False, 0.0
    if a.sweep == b.sweep and over < _OVER and _step_between(a, b, at):
        return False, 0.0
    together = over >= _OVER or (gap < _HOME_M and _meet(a, b))
    if together:
        return (True, abs(step)) if abs(step) < _SAME_M else (None, 0.0)
    if _SIGMAS * doubt[0] > _SURE_M or gap > _GAP_M:
        return None, 0.0
    return True, 1.0 + gap


def _moves(one: Piece, at: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """How each likely step of the calibration shifts the plane at a point, and tilts it along axes, [3, directions]."""
    tilt = one.axes.T @ one.plane.taken[1:]
    return np.concatenate([(one.plane.taken[0] + (at - one.centre) @ tilt)[None], axes @ tilt])


def _pose_moves(one: Piece, at: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """The same for the six directions of the pose of a station."""
    turned = np.cross(np.eye(3), one.normal)
    shift = np.concatenate([_STATION_M * one.normal, _STATION_RAD * (np.cross(np.eye(3), at) @ one.normal)])
    return np.concatenate([shift[None], np.concatenate([np.zeros((2, 3)), _STATION_RAD * axes @ turned.T], 1)])


def _step_between(a: Piece, b: Piece, at: np.ndarray) -> bool:
    """Whether the points on both sides of a place lie on different levels; a calibration bends them together."""
    sides = [one.dense[np.linalg.norm(one.dense - at, axis=1) < _LOCAL_M] for one in (a, b)]
    if min(map(len, sides)) < _LOCAL:
        return False
    p = np.concatenate(sides) - at
    side = np.repeat([0.0, 1.0], [len(sides[0]), len(sides[1])])
    design = np.column_stack([np.ones(len(p)), p @ a.axes.T, side])
    inverse = np.linalg.pinv(design.T @ design)
    height = float((inverse @ design.T @ (p @ a.normal))[3])
    return abs(height) > _STEP_M + _SIGMAS * max(a.noise, b.noise) * float(np.sqrt(inverse[3, 3]))


def _meet(a: Piece, b: Piece) -> bool:
    """Whether one begins where the other ends: at the first and the last profiles of one sweep."""
    if a.sweep != b.sweep or a.cells.laser != b.cells.laser:
        return False
    rows, columns = a.cells.valid.shape
    ends = [(one.region.cells.min() // columns <= 1, one.region.cells.max() // columns >= rows - 2) for one in (a, b)]
    return bool((ends[0][0] and ends[1][1]) or (ends[0][1] and ends[1][0]))


def _over(a: Piece, b: Piece) -> float:
    """Share of the smaller piece that lies over the other; in one turn of one laser nothing does."""
    if a.sweep == b.sweep and a.cells.laser == b.cells.laser and abs(a.phi - b.phi) < np.pi:
        return 0.0
    sides = [np.ptp(one.points @ a.axes.T, axis=0) for one in (a, b)]
    # So large that the samples leave no square of a piece empty.
    size = max(_BIN_M, float(np.sqrt(max(side.prod() for side in sides) / (_SAMPLES / 6))))
    squares = []
    for one in (a, b):
        at = np.round(one.points @ a.axes.T / size).astype(np.int64)
        squares.append({tuple(square) for square in at.tolist()})
    return len(squares[0] & squares[1]) / min(len(squares[0]), len(squares[1]))
