"""Sweeps and a scanner to surfaces of the room and the points on them.

Flat regions of every sweep are found; those of one wall are joined; and of the stripes on them so many are chosen, away
from borders and corners, that they are spread evenly and their noise is independent.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.errors import CalibrationError
from jaxscan.geometry import Scanner, transform
from jaxscan.measurement.planes import facing, weighted_plane
from jaxscan.recalibration.grid import spread_over
from jaxscan.recalibration.observed import SurfacePoints, Surfaces, SweepStripes
from jaxscan.recalibration.segment.regions import Region, cells_of, flat_regions
from jaxscan.recalibration.triangulate import triangulate_points


def label_planes(sweep: SweepStripes, scanner: Scanner) -> Int[np.ndarray, "profiles lines"]:
    """Number of the plane of one sweep that each point of its grid lies on, with the scanner as it is; -1: on none.

    Raises:
        CalibrationError: If no plane is found.
    """
    labels, count = np.full(sweep.centre.shape, -1, np.int32), 0
    for cells in cells_of(sweep, scanner):
        grid = np.full(cells.valid.size, -1, np.int32)
        for region in flat_regions(cells, scanner):
            grid[region.cells] = count
            count += 1
        labels[np.ix_(cells.profiles, cells.lines)] = cells.spread(grid.reshape(cells.valid.shape))
    if not count:
        raise CalibrationError(_no_plane([sweep]))
    return np.where(sweep.valid, labels, -1)


def _no_plane(sweeps: Sequence[SweepStripes]) -> str:
    names = ", ".join(sweep.name for sweep in sweeps)
    return (
        f"{names}: found no plane, expected flat walls of 0.2 m or more: sweep a room with free walls, check that the "
        "table's steps per turn are those of the calibration, or calibrate with boards"
    )


def observe_surfaces(
    sweeps: Sequence[SweepStripes], scanner: Scanner, stations: Float[np.ndarray, "stations 4 4"], most: int = 40_000
) -> tuple[SurfacePoints, Surfaces]:
    """Planes of the room, and points on them that are spread evenly and whose noise is independent.

    Args:
        sweeps: Stripes of each sweep, known faults of the angles corrected.
        scanner: The calibrated rig; its covariance says how far it may bend a wall that is flat.
        stations: T_room_scanner of every station.
        most: The largest number of points.

    Returns:
        The points, in the order of the sweeps, and the planes with most points first.

    Raises:
        CalibrationError: If no plane is found.
    """
    pieces: list[Piece] = []
    found: list[Candidates] = []
    for number, sweep in enumerate(sweeps):
        pose = np.asarray(stations[sweep.station], np.float64)
        regions = [region for cells in cells_of(sweep, scanner) for region in flat_regions(cells, scanner)]
        own = [_piece(number, sweep.station, region, pose) for region in regions]
        pieces += own
        found += [_candidates(one, own, sweep, scanner, pose) for one in own]
    surface = _join(pieces) if pieces else np.zeros(0, int)
    every = [
        one._replace(points=one.points._replace(surface=np.full(len(one.p), number)))
        for one, number in zip(found, surface, strict=True)
    ]
    chosen = _choose(_joined(every), most) if every else np.zeros(0, int)
    if len(chosen) == 0:
        raise CalibrationError(_no_plane(sweeps))
    points, p = _joined(every).points.take(chosen), _joined(every).p[chosen]
    names, counts = np.unique(points.surface, return_counts=True)
    names = names[np.argsort(-counts, kind="stable")]
    renumbered = np.full(surface.max() + 1, -1)
    renumbered[names] = np.arange(len(names))
    planes = []
    for name in names:
        own_points = p[points.surface == name]
        towards = pieces[int(np.flatnonzero(surface == name)[0])].normal
        planes.append(facing(weighted_plane(own_points, np.ones(len(own_points))), towards))
    normals, centres = np.stack([plane.normal for plane in planes]), np.stack([plane.centre for plane in planes])
    surfaces = Surfaces(normals, (normals * centres).sum(1), centres)
    return points._replace(surface=renumbered[points.surface]), surfaces


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
_BIN_M = 0.1
"""Size of the squares over which points are spread evenly; at least that of those in which it is seen whether parts lie
over each other [m]."""
_HOME_M = 0.15
"""Gap between the first and the last profiles of a sweep in which no edge is expected [m]."""
_OVER = 0.25
"""Share of the smaller part that lies over the other, from which they lie over each other."""
_STATION_M, _STATION_RAD = 0.01, 3e-3
"""Standard deviations of the given pose of a station."""
_SAMPLES, _MORE = 300, 4000
_LOCAL_M, _LOCAL = 0.4, 20
"""A step shows in the points within this distance of the place between two parts; and least number of each part."""


class Piece(NamedTuple):
    """A flat region in the frame of the room, with some of its points and more of them [m]."""

    sweep: int
    station: int
    region: Region
    normal: Float[np.ndarray, "3"]
    distance: float
    centre: Float[np.ndarray, "3"]
    axes: Float[np.ndarray, "2 3"]
    points: Float[np.ndarray, "samples 3"]
    dense: Float[np.ndarray, "more 3"]
    noise: float
    """Standard deviation of a cell along the normal [m]."""
    phi: float


def _piece(sweep: int, station: int, region: Region, pose: Float[np.ndarray, "4 4"]) -> Piece:
    """A flat region of a sweep, of one station, with T_room_scanner."""
    plane, cells = region.plane, region.grid
    sampled = lambda count: np.asarray(transform(pose, cells.p.reshape(-1, 3)[spread_over(region.cells, count)]))
    normal, centre = pose[:3, :3] @ plane.normal, np.asarray(transform(pose, plane.centre))
    return Piece(
        sweep,
        station,
        region,
        normal,
        float(normal @ centre),
        centre,
        plane.axes @ pose[:3, :3].T,
        sampled(_SAMPLES),
        sampled(_MORE),
        float(np.median(cells.across(plane.normal).ravel()[region.cells])),
        float(cells.phi.ravel()[region.cells].mean()),
    )


def _join(pieces: Sequence[Piece]) -> Int[np.ndarray, " pieces"]:
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
    """Whether two pieces are one surface (None: undecided), and a rank: the surest first."""
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
    tilt = one.axes.T @ one.region.plane.taken[1:]
    return np.concatenate([(one.region.plane.taken[0] + (at - one.centre) @ tilt)[None], axes @ tilt])


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
    if a.sweep != b.sweep or a.region.grid.laser != b.region.grid.laser:
        return False
    rows, columns = a.region.grid.valid.shape
    ends = [(one.region.cells.min() // columns <= 1, one.region.cells.max() // columns >= rows - 2) for one in (a, b)]
    return bool((ends[0][0] and ends[1][1]) or (ends[0][1] and ends[1][0]))


def _over(a: Piece, b: Piece) -> float:
    """Share of the smaller piece that lies over the other; in one turn of one laser nothing does."""
    if a.sweep == b.sweep and a.region.grid.laser == b.region.grid.laser and abs(a.phi - b.phi) < np.pi:
        return 0.0
    sides = [np.ptp(one.points @ a.axes.T, axis=0) for one in (a, b)]
    # So large that the samples leave no square of a piece empty.
    size = max(_BIN_M, float(np.sqrt(max(side.prod() for side in sides) / (_SAMPLES / 6))))
    squares = []
    for one in (a, b):
        at = np.round(one.points @ a.axes.T / size).astype(np.int64)
        squares.append({tuple(square) for square in at.tolist()})
    return len(squares[0] & squares[1]) / min(len(squares[0]), len(squares[1]))


_CORNER_M, _CORNER = 0.2, 0.1
"""Distance from another wall within which points are left out, because light comes back from it and smoothing rounds
[m]; but no more than this share of their own wall's width."""
_NEAR_M = 0.3
"""How far another wall may end from a corner that it makes [m]."""
_CROSSING = 0.94
"""Cosine of the angle below which two planes make a corner."""
_TRIES = 6
_ALL = 16
"""Stripes of a cell up to which all of them may be used, and not one alone."""
_DENSE = 200
"""Profiles of a sweep from which they are dense."""
_RIM, _RIM_SIGMAS, _RIM_M = 4, 3.0, 1e-3
"""Cells beside a region that may belong to it, and their distance from its plane: in standard deviations, and [m]."""
_OUTLIER, _OUTLIER_M = 4.0, 2e-3
"""Standard deviations, and distance beside them [m], from which a stripe does not belong to its wall."""
_LEAST = 30
"""Points of a surface at least."""


class Candidates(NamedTuple):
    """Stripes that may be used: in the room [m], with the lines over which their noise is shared."""

    points: SurfacePoints
    p: Float[np.ndarray, "points 3"]
    shared: Float[np.ndarray, " points"]
    profile: Int[np.ndarray, " points"]


def _candidates(
    piece: Piece, others: Sequence[Piece], sweep: SweepStripes, scanner: Scanner, pose: Float[np.ndarray, "4 4"]
) -> Candidates:
    """Stripes of a piece and its rim, without corners with the other pieces of its sweep."""
    cells, plane = piece.region.grid, piece.region.plane
    members = np.flatnonzero(_claimed(piece.region, others).ravel())
    i, j = np.unravel_index(members, cells.valid.shape)
    i, j = i[:, None] * cells.block[0], j[:, None] * cells.block[1]
    if cells.block[0] * cells.block[1] <= _ALL:
        row, line = (part.ravel() for part in np.mgrid[: cells.block[0], : cells.block[1]])
        row, line = i + row, j + line
    else:
        # A fixed seed: the same input gives the same result.
        rng = np.random.default_rng(0)
        row = i + rng.integers(0, cells.block[0], (len(i), _TRIES))
        line = j + rng.integers(0, cells.block[1], (len(i), _TRIES))
    inside = (row < len(cells.profiles)) & (line < len(cells.lines))
    profile = cells.profiles[np.minimum(row, len(cells.profiles) - 1)]
    line = cells.lines[np.minimum(line, len(cells.lines) - 1)]
    good = inside & sweep.valid[profile, line] & (sweep.sigma[profile, line] > 0)
    if cells.block[0] * cells.block[1] > _ALL:
        good &= np.arange(_TRIES) == good.argmax(1)[:, None]
    kept = members[np.nonzero(good)[0]]
    profile, line = profile[good], line[good]
    q, record, laser = sweep.pixels(profile, line), sweep.record[profile], sweep.laser[profile]
    p, exists = triangulate_points(scanner, q, laser, sweep.angle[record])
    sigma = sweep.sigma[profile, line].astype(np.float64)
    noise = np.abs(cells.slope.reshape(-1, 3)[kept] @ plane.normal) * sigma
    error = plane.error(p, piece.region.bend[piece.region.place[kept]])
    good = exists & (np.abs(error) < _OUTLIER * np.maximum(noise, 1.5 * np.median(noise)) + _OUTLIER_M)
    good &= ~_at_corners(piece, others, p)
    points = SurfacePoints(q, sigma, np.full(len(q), piece.sweep), record, line, laser, np.zeros(len(q), int))
    shared = np.maximum(sweep.shared_lines[profile, line].astype(np.float64), 1.0)
    return Candidates(points.take(good), np.asarray(transform(pose, p))[good], shared[good], profile[good])


def _joined(found: Sequence[Candidates]) -> Candidates:
    points = SurfacePoints(*map(np.concatenate, zip(*(one.points for one in found), strict=True)))
    return Candidates(points, *map(np.concatenate, zip(*(one[1:] for one in found), strict=True)))


def _choose(found: Candidates, most: int) -> Int[np.ndarray, " chosen"]:
    """At most `most` candidates: balanced over surfaces, even over their area, independent in their noise."""
    surface = found.points.surface
    independent = np.flatnonzero(_far_apart(found.points.sweep, found.profile, found.points.line, found.shared))
    independent = np.random.default_rng(1).permutation(independent)
    rank = _rank(found.p[independent], surface[independent])
    names, counts = np.unique(surface[independent], return_counts=True)
    areas = np.array([len(np.unique(_squares(found.p[independent][surface[independent] == k]))) for k in names])
    share = _shares(np.sqrt(areas.astype(float)), counts, most)
    chosen = []
    for name, number in zip(names, share, strict=True):
        own = independent[surface[independent] == name]
        own = own[np.argsort(rank[surface[independent] == name], kind="stable")]
        if len(own) >= _LEAST:
            chosen.append(own[:number])
    return np.sort(np.concatenate(chosen)) if chosen else np.zeros(0, int)


def _claimed(region: Region, others: Sequence[Piece]) -> Bool[np.ndarray, "rows columns"]:
    """Cells that are surely of a region.

    Where profiles are dense, these are the inner ones, whose eight neighbours belong to it too: a curved wall may begin
    at the border. Where they are few, neighbourhoods are full only well inside a wall, so cells beside the region that
    lie on its plane and belong to no other count too.
    """
    from scipy.ndimage import binary_dilation, binary_erosion  # type: ignore[import-untyped]

    cells, plane = region.grid, region.plane
    mask, taken = np.zeros((2, *cells.valid.shape), bool)
    mask.ravel()[region.cells] = True
    if len(mask) >= _DENSE:
        # The grid's own ends are no borders.
        return np.asarray(binary_erosion(mask, np.ones((3, 3)), border_value=1))
    for other in others:
        if other.region.grid is cells and other.region is not region:
            taken.ravel()[other.region.cells] = True
    noise = cells.across(plane.normal).ravel()
    typical = float(np.median(noise[region.cells]))
    for _ in range(_RIM):
        new = np.flatnonzero((binary_dilation(mask) & ~mask & cells.valid & ~taken).ravel())
        error = np.abs(plane.error(cells.p.reshape(-1, 3)[new], region.bend[region.place[new]]))
        mask.ravel()[new[error < _RIM_SIGMAS * np.maximum(noise[new], typical) + _RIM_M]] = True
    return mask


def _at_corners(piece: Piece, others: Sequence[Piece], p: Float[np.ndarray, "points 3"]) -> Bool[np.ndarray, " points"]:
    near = np.zeros(len(p), bool)
    width = np.ptp((piece.points - piece.centre) @ piece.axes.T, axis=0).max()
    margin = min(_CORNER_M, _CORNER * float(width))
    for other in others:
        plane = other.region.plane
        if abs(plane.normal @ piece.region.plane.normal) > _CROSSING:
            continue
        along = (p - plane.centre) @ plane.axes.T
        reach = (other.points - other.centre) @ other.axes.T
        beside = (along > reach.min(0) - _NEAR_M) & (along < reach.max(0) + _NEAR_M)
        near |= (np.abs(p @ plane.normal - plane.distance) < margin) & beside.all(1)
    return near


def _squares(p: np.ndarray) -> Int[np.ndarray, " points"]:
    """Number of the cube that each point lies in; on a plane they are about squares."""
    at = np.floor(p / _BIN_M).astype(np.int64)
    at -= at.min(0)
    size = at.max(0) + 1
    return (at[:, 0] * size[1] + at[:, 1]) * size[2] + at[:, 2]


def _rank(p: np.ndarray, surface: np.ndarray) -> Int[np.ndarray, " points"]:
    """How many points of the same square of the same surface come before each."""
    square = _squares(p)
    key = surface.astype(np.int64) * (square.max(initial=0) + 1) + square
    order = np.argsort(key, kind="stable")
    ordered = key[order]
    starts = np.flatnonzero(np.append(True, ordered[1:] != ordered[:-1])) if len(key) else np.zeros(0, int)
    lengths = np.diff(np.append(starts, len(key)))
    rank = np.empty(len(key), int)
    rank[order] = np.arange(len(key)) - np.repeat(starts, lengths)
    return rank


def _shares(wish: np.ndarray, most: np.ndarray, total: int) -> Int[np.ndarray, " surfaces"]:
    """Numbers in proportion to `wish`, each at most its own limit, at most `total` together."""
    share = np.zeros(len(wish))
    open_ = np.ones(len(wish), bool)
    while open_.any():
        left = total - share[~open_].sum()
        share[open_] = left * wish[open_] / wish[open_].sum()
        over = open_ & (share >= most)
        if not over.any():
            break
        share[over] = most[over]
        open_ &= ~over
    return np.floor(share + 1e-9).astype(int)


def _far_apart(
    sweep: Int[np.ndarray, " points"],
    profile: Int[np.ndarray, " points"],
    line: Int[np.ndarray, " points"],
    shared: Float[np.ndarray, " points"],
) -> Bool[np.ndarray, " points"]:
    """Points of which no two of one profile are nearer than the lines over which their noise is shared."""
    # Every line in turn, all profiles at once.
    _, own = np.unique(np.stack([sweep, profile]), axis=1, return_inverse=True)
    own = own.reshape(-1)
    last, reach = np.full(own.max(initial=-1) + 1, -np.inf), np.zeros(own.max(initial=-1) + 1)
    kept = np.zeros(len(line), bool)
    order = np.argsort(line, kind="stable")
    for here in np.split(order, np.flatnonzero(np.diff(line[order])) + 1):
        free = line[here] - last[own[here]] >= np.maximum(shared[here], reach[own[here]])
        here = here[free]
        kept[here], last[own[here]], reach[own[here]] = True, line[here], shared[here]
    return kept
