"""A calibration's covariance in millimetres and pixels: depths, points, lengths and rays, free of any gauge.

Standard deviations of parameters say little: they are strongly correlated, and the place of the
frame does not matter. So everything here is measured again with the rig moved by one standard
deviation along each independent direction of its covariance, at fixed pixels and table angles:
lengths between points that were scanned, distances from the camera, rays after the best rotation.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscan.calibration.result import DepthSigma, GoodTo, GoodToPart, LaserLengths, Lengths, LengthSigma, ModelTest
from jaxscan.geometry import AbstractCamera, LinearStage, Rig, Scanner, Turntable, lit_points, points, root_of
from jaxscan.geometry.motions import ANGLE_PARAMETERS


DEPTHS_M = (0.1, 0.15, 0.25, 0.4, 0.6, 1.0, 1.5, 2.5, 4.0, 6.0, 10.0, 15.0, 25.0)
"""Depths at which a rig is judged, where it reaches them [m]."""
HALF_TURN_DEPTHS_M = (1.91, 3.075)
"""Depths of two opposite walls, seen half a turn apart: rooms about 3.8 and 6.1 m wide [m]."""
TRAVEL_M = 0.5
"""Travel over which a linear stage is judged [m]."""
# Length over depth: that of 300 mm at 2.5 m, by which scanners of rooms are compared.
_LENGTH_SHARE = 0.12
_COMMON_DEPTH_M = 2.5
# A wall 4 m long from 2.5 m away: its length, and the depth of its ends, for its distance.
_WALL_SHARE = 1.6
_WALL_ENDS = float(np.hypot(1.0, _WALL_SHARE / 2))
# Beyond the depth where one pixel is worth more than this share of it, nobody scans.
_MAX_PIXEL_SHARE = 0.02
# An object on a table: it ends within this share of the axis' depth from the axis.
_OBJECT_SHARE = 0.15
# Neighbouring rows know the same: this many of them, evenly spread, stand for all.
_LINES = 64
_TURN_LINES = 8
_TURN_STOPS = 24
# Half the opening over which a stripe is looked for: 72 degrees to either side of the optical axis.
_WIDEST_TANGENT = 3.0
_SAMPLES = 512
_NEARBY = 1.001
# Places of the image at which rays are compared, columns and rows.
_GRID = (16, 12)
# Rays are moved by this part of a step, so that the next order is a millionth also of steps that are large.
_SMALL = 1e-3
# A lens model that does not come back to a pixel does not reach it.
_RETURNS_PX = 1e-2
# A wide lens is judged up to the angle at which its image first shrinks to this share of the scale in the middle. About
# there real ones end in the dark, while powers of the angle turn back or run off: a step of a coefficient that only the
# rim would show is thousands of pixels beyond it, where no ray comes from.
_LEAST_SCALE = 0.5
_SIDES = ((1, 0), (0, 1), (-1, 0), (0, -1))
_ANGLES = np.radians(np.arange(180.0))


def spread(
    moved: Rig | AbstractCamera, steps: Float[np.ndarray, "steps params"], measure: Callable[[Any], np.ndarray]
) -> Float[np.ndarray, "steps ..."]:
    r"""Half of the change of a measurement from back to forth along each step.

    With the covariance $C = \sum_k s_k s_k^T$ and $f$ a measurement, its variance is the sum of the squares of
    $(f(+s_k) - f(-s_k)) / 2$, to first order $J C J^T$. Nothing is differentiated.

    Args:
        moved: What has `retract`.
        steps: In its minimal coordinates; each counts as one standard deviation.
        measure: The measurement, at fixed pixels and angles.

    Source: mrcal's projection uncertainty, carried over to points.
    """
    changes = [measure(moved.retract(step)) - measure(moved.retract(-step)) for step in steps]
    return np.reshape(changes, (len(steps), *np.shape(measure(moved)))) / 2.0


def _sigma(changes: np.ndarray) -> np.ndarray:
    """Standard deviation of what changes so along each step [steps, ...]."""
    return np.sqrt(np.sum(changes**2, axis=0))


def _root(scanner: Scanner) -> np.ndarray:
    if scanner.covariance is None:
        raise ValueError("The scanner has no covariance, so nothing can be said about its lengths.")
    return root_of(np.asarray(scanner.covariance, np.float64))


class Lit(NamedTuple):
    """The stripe on a plane z = `depth`, once for each line of the image that it crosses.

    Lines are rows of the image, or its columns if the stripe spans more of them than of rows.
    """

    depth: float
    """z in the camera frame [m]."""
    q: Float[np.ndarray, "lines 2"]
    """(u, v) [px] by ascending line; empty where that depth is nowhere in the image."""
    along: Float[np.ndarray, " lines"]
    """Where each lies along the stripe, counted from beside the optical axis [m]."""
    per_pixel: float = np.inf
    """Change of the depth over one pixel [m / px]."""

    def middle(self) -> Float[np.ndarray, "2"]:
        """Pixel of the point nearest the optical axis."""
        return self.q[np.argmin(np.abs(self.along))]


def lit_lines(scanner: Scanner, laser: int, depth: float) -> Lit:
    """The stripe of one sheet on a plane at a depth [m]."""
    size = np.array([scanner.camera.width, scanner.camera.height])
    along = depth * np.linspace(-_WIDEST_TANGENT, _WIDEST_TANGENT, _SAMPLES)
    (q, seen), (near, also) = (_stripe(scanner, laser, at, along) for at in (depth, _NEARBY * depth))
    seen = seen & also
    inside = np.flatnonzero(seen & ((q >= 0) & (q <= size - 1)).all(-1))
    if len(inside) < 2:
        return Lit(depth, np.zeros((0, 2)), np.zeros(0))
    axis = int(np.ptp(q[inside, 1]) >= np.ptp(q[inside, 0]))
    before, middle = inside[len(inside) // 2 + np.array([-1, 0])]
    tangent = q[middle] - q[before]
    # A motion along the stripe is not seen.
    shift = np.abs(np.linalg.det([tangent, near[before] - q[before]])) / np.linalg.norm(tangent)
    order = np.flatnonzero(seen)[np.argsort(q[seen, axis])]
    lines = np.arange(size[axis])
    lines = lines[(lines >= q[order[0], axis]) & (lines <= q[order[-1], axis])]
    # Interpolated to a tenth of a line; the pixels there are computed exactly.
    at = np.interp(lines, q[order, axis], along[order])
    q, seen = _stripe(scanner, laser, depth, at)
    kept = seen & ((q >= -0.5) & (q <= size - 0.5)).all(-1)
    return Lit(depth, q[kept], at[kept], float((_NEARBY - 1.0) * depth / shift))


def _stripe(scanner: Scanner, laser: int, depth: float, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of the points of a sheet at a depth, and whether the camera sees them there."""
    sheet, camera = scanner.laser(laser), scanner.camera
    # In the plane z = depth the sheet is a line at a distance from the optical axis, but for its bow.
    steepness = float(np.hypot(sheet.normal[0], sheet.normal[1]))
    if steepness <= 1e-6:
        return np.zeros((len(along), 2)), np.zeros(len(along), bool)
    x, y = np.asarray(sheet.normal[:2]) / steepness
    points = lambda at: np.stack([at * x - along * y, at * y + along * x, np.full(len(along), depth)], 1)
    at = np.full(len(along), (sheet.distance - sheet.normal[2] * depth) / steepness)
    # Each round leaves the slope of the bow, less than a hundredth, of the error before.
    for _ in range(4):
        at = at - sheet.offset(points(at)) / steepness
    p = points(at)
    q = np.asarray(camera.project(p))
    # Far outside its field of view a lens model may fold back into the image.
    same = np.linalg.norm(camera.unproject(q) - p / np.linalg.norm(p, axis=1, keepdims=True), axis=1) < 1e-6
    return q, np.asarray(same & (np.abs(sheet.offset(p)) < 1e-6 * depth))


def stripe_pixels(scanner: Scanner, laser: int, depth: float) -> Float[np.ndarray, "lines 2"]:
    """Where the stripe of one depth is seen: one pixel for each row of the image that it crosses.

    One for each column, if the stripe at that depth runs along the rows of the image.

    Returns:
        (u, v) [px] by ascending row or column; empty where that depth is nowhere in the image.
    """
    return lit_lines(scanner, laser, depth).q


def stripe_depths(scanner: Scanner, laser: int, q: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, " points"]:
    """Depth z in the camera frame of stripe points seen at pixels `q` [m]."""
    return np.asarray(lit_points(scanner.rig, q, laser)[0])[:, 2]


def depth_sigma(scanner: Scanner, laser: int, q: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, " points"]:
    """Standard deviation that the calibration causes in `stripe_depths` [m].

    Raises:
        ValueError: If the scanner has no covariance.
    """
    return _sigma(spread(scanner.rig, _root(scanner), lambda rig: np.asarray(lit_points(rig, q, laser)[0])[:, 2]))


class Length(NamedTuple):
    """The distance between two stripe points, each seen at a fixed pixel and table angle."""

    name: str
    """"along the stripe", "across the sweep" or "half a turn"."""
    depth: float
    """Depth of the points in the camera frame of their own angle [m]."""
    laser: int
    q: np.ndarray
    """Pixels of the two points [2, 2]."""
    angle: np.ndarray
    """Table angles [rad] or positions of the stage [m] of the two points [2]."""


def typical_lengths(scanner: Scanner, laser: int) -> list[Length]:
    """Lengths of common interest, as far as the rig reaches them.

    300 mm at 2.5 m (or as long for its depth at the middle one of the depths in reach), along the
    stripe of one image and across the sweep; and between two points half a turn apart: opposite
    walls of two rooms, or two sides of an object on the table.
    """
    return _typical(scanner, laser, _in_reach(scanner, laser))


def _typical(scanner: Scanner, laser: int, reached: list[Lit]) -> list[Length]:
    table, found = scanner.turntable, list[Length]()
    if not reached:
        return found
    lit = _middle(reached)
    length, twice = _LENGTH_SHARE * lit.depth, lambda one: np.tile(one.middle(), (2, 1))
    if np.ptp(lit.along) >= length:
        # The length lies as near to the optical axis as the image allows.
        middle = np.clip(0.0, lit.along.min() + length / 2, lit.along.max() - length / 2)
        at, order = middle + length / 2 * np.array([-1.0, 1.0]), np.argsort(lit.along)
        # Between neighbouring lines the stripe is straight to far less than a pixel.
        ends = np.stack([np.interp(at, lit.along[order], lit.q[order, i]) for i in range(2)], axis=-1)
        found.append(Length("along the stripe", lit.depth, laser, ends, np.zeros(2)))
    move, halves = np.inf, list[float]()
    if isinstance(table, LinearStage):
        move = length / float(table.gain)
    elif isinstance(table, Turntable):
        # Turned so far that the point in the middle of the stripe moves by the length.
        radius = _radius(scanner, table, laser, lit)
        if length <= 2.0 * radius:
            move = 2.0 * np.arcsin(length / (2.0 * radius)) / abs(float(table.gain))
        farthest = reached[-1].depth
        halves = list(HALF_TURN_DEPTHS_M) if farthest >= max(HALF_TURN_DEPTHS_M) else [farthest]
        halves = [_near_side(table)] if table.carries == "object" else halves
    if np.isfinite(move):
        found.append(Length("across the sweep", lit.depth, laser, twice(lit), np.array([0.0, move])))
    opposite = [lit_lines(scanner, laser, depth) for depth in halves]
    return found + [
        Length("half a turn", one.depth, laser, twice(one), np.array([0.0, np.pi])) for one in opposite if len(one.q)
    ]


def _radius(scanner: Scanner, table: Turntable, laser: int, lit: Lit) -> float:
    """Distance of the point in the middle of the stripe from the axis of the scanner's table [m]."""
    point = np.asarray(lit_points(scanner.rig, lit.middle()[None], laser)[0])[0]
    return float(np.linalg.norm(np.cross(np.asarray(table.direction), point - np.asarray(table.point))))


class _Wall(NamedTuple):
    """Many lengths of one kind, all around: what a calibration is judged by."""

    at_m: float
    """How far from the camera the wall is, or the depth of the points [m]."""
    length_m: float
    q: Float[np.ndarray, "ends 2"]
    """Pixels of the ends, two after two [px]."""
    angle: Float[np.ndarray, " ends"]
    """Table angle [rad] or position [m] of each."""

    def sigma_mm(self, rig: Rig, laser: int, steps: np.ndarray) -> float:
        """Root mean square standard deviation of the lengths by some steps [mm]."""

        def measure(rig: Rig) -> np.ndarray:
            p = np.asarray(points(rig, self.q, np.full(len(self.q), laser), self.angle))
            return np.linalg.norm(p[1::2] - p[0::2], axis=-1)

        return 1e3 * float(np.sqrt(np.mean(_sigma(spread(rig, _SMALL * steps, measure) / _SMALL) ** 2)))


def _wall(scanner: Scanner, laser: int, depth: float) -> _Wall | None:
    """A wall 4 m long from 2.5 m away, or as long for its distance; of an object, a quarter turn at a depth."""
    motion, lit = scanner.turntable, lit_lines(scanner, laser, depth)
    if not isinstance(motion, LinearStage | Turntable) or not len(lit.q):
        return None
    begins = 2.0 * np.pi * np.arange(_TURN_STOPS) / _TURN_STOPS
    if isinstance(motion, LinearStage):
        length, begins, move = TRAVEL_M, np.array([-0.5 * TRAVEL_M]), TRAVEL_M / float(motion.gain)
    elif motion.carries == "object":
        length, move = np.sqrt(2.0) * _radius(scanner, motion, laser, lit), 0.5 * np.pi
    else:
        far = lit_lines(scanner, laser, _WALL_ENDS * depth)
        # Where the ends would be out of reach, the wall is nearer.
        depth, lit = (depth, far) if len(far.q) else (depth / _WALL_ENDS, lit)
        diameter = 2.0 * _radius(scanner, motion, laser, lit)
        length = min(_WALL_SHARE * depth, diameter)
        move = 2.0 * np.arcsin(length / diameter) / abs(float(motion.gain))
    first = lit.q[np.unique(np.linspace(0, len(lit.q) - 1, _TURN_LINES).round().astype(int))]
    pairs = np.stack([first, np.roll(first, len(first) // 2, axis=0)], axis=1)
    q = np.tile(pairs, (len(begins), 1, 1)).reshape(-1, 2)
    angle = np.repeat(begins, len(first))[:, None] + np.array([0.0, move])
    return _Wall(depth, float(length), q, angle.ravel())


def _judged_depth(scanner: Scanner, laser: int) -> float | None:
    """2.5 m, or the middle one of the depths in reach; of an object on a table its near side; None where none is."""
    table, reached = scanner.turntable, _in_reach(scanner, laser)
    if not reached:
        return None
    return _near_side(table) if isinstance(table, Turntable) and table.carries == "object" else _middle(reached).depth


def measure_lengths(scanner: Scanner, lengths: Sequence[Length]) -> Float[np.ndarray, " lengths"]:
    """The lengths as this scanner measures them at their pixels and angles [m]."""
    return _measured(scanner.rig, lengths)


def length_sigma(scanner: Scanner, lengths: Sequence[Length]) -> Float[np.ndarray, " lengths"]:
    """Standard deviation that the calibration causes in `measure_lengths` [m].

    Raises:
        ValueError: If the scanner has no covariance.
    """
    return _sigma(spread(scanner.rig, _root(scanner), lambda rig: _measured(rig, lengths)))


def _measured(rig: Rig, lengths: Sequence[Length]) -> np.ndarray:
    if not lengths:
        return np.zeros(0)
    q, angle = (np.concatenate(parts) for parts in zip(*((one.q, one.angle) for one in lengths), strict=True))
    p = np.asarray(points(rig, q, np.repeat([length.laser for length in lengths], 2), angle))
    return np.linalg.norm(p[1::2] - p[0::2], axis=-1)


def predict_lengths(scanner: Scanner, at_m: float | None = None) -> Lengths:
    """Standard deviations that the calibration causes in lengths that people measure; noise of the stripe is on top.

    Returns:
        For every laser the depths that the rig reaches, the wall by which it is judged, and its `typical_lengths`;
        those out of reach or out of the image are left out, so both may be empty.

    Raises:
        ValueError: If the scanner has no covariance.

    Source: ASTM E3125 for the choice.
    """
    steps, lasers = _root(scanner), []
    for index, name in enumerate(scanner.laser_names):
        reached = _in_reach(scanner, index)
        lengths = _typical(scanner, index, reached)
        measured = zip(lengths, measure_lengths(scanner, lengths), length_sigma(scanner, lengths), strict=True)
        told = [LengthSigma(one.name, one.depth, float(value), 1e3 * float(sigma)) for one, value, sigma in measured]
        depth = _judged_depth(scanner, index) if at_m is None else at_m
        wall = None if depth is None else _wall(scanner, index, depth)
        if wall is not None:
            told.insert(0, LengthSigma("wall", wall.at_m, wall.length_m, wall.sigma_mm(scanner.rig, index, steps)))
        lasers.append(LaserLengths(name, _at_depths(scanner, index, reached, steps), tuple(told)))
    return Lengths(tuple(lasers))


def _near_side(table: Turntable) -> float:
    """Depth of the near side of an object on a table [m]."""
    return (1.0 - _OBJECT_SHARE) * float(table.point[2])


def _middle(reached: list[Lit]) -> Lit:
    return next((each for each in reached if each.depth == _COMMON_DEPTH_M), reached[len(reached) // 2])


def _in_reach(scanner: Scanner, laser: int) -> list[Lit]:
    """The stripe at those of `DEPTHS_M` where it is in the image and its pixels still mean something."""
    table = scanner.turntable
    limit = 2.0 * float(table.point[2]) if isinstance(table, Turntable) and table.carries == "object" else np.inf
    candidates = [lit_lines(scanner, laser, depth) for depth in DEPTHS_M if depth <= limit]
    return [lit for lit in candidates if len(lit.q) and lit.per_pixel <= _MAX_PIXEL_SHARE * lit.depth]


def _at_depths(scanner: Scanner, laser: int, reached: Sequence[Lit], steps: np.ndarray) -> tuple[DepthSigma, ...]:
    """The errors of the steps at some depths."""
    if not reached:
        return ()
    motion, stops = scanner.turntable, np.zeros(1)
    if isinstance(motion, Turntable):
        stops = 2.0 * np.pi * np.arange(_TURN_STOPS) / _TURN_STOPS
    elif isinstance(motion, LinearStage):
        stops = np.linspace(-0.5 * TRAVEL_M, 0.5 * TRAVEL_M, _TURN_STOPS)
    some = lambda lit, count: lit.q[np.unique(np.linspace(0, len(lit.q) - 1, count).round().astype(int))]
    # Before the camera where it stands still, and all around.
    still, around = [some(lit, _LINES) for lit in reached], [some(lit, _TURN_LINES) for lit in reached]
    turning = np.concatenate([np.tile(q, (len(stops), 1)) for q in around])
    angle, standing = np.concatenate([np.repeat(stops, len(q)) for q in around]), np.concatenate(still)

    def measure(rig: Rig) -> np.ndarray:
        return np.concatenate([np.asarray(lit_points(rig, standing, laser)[0]), points(rig, turning, laser, angle)])

    ends = np.cumsum([*map(len, still), *(len(q) * len(stops) for q in around)])[:-1]
    p, changes = np.split(measure(scanner.rig), ends), np.split(spread(scanner.rig, steps, measure), ends, axis=1)
    rms, found = lambda change: 1e3 * float(np.sqrt(np.mean(_sigma(change) ** 2))), []
    for number, lit in enumerate(reached):
        unit = p[number] / np.linalg.norm(p[number], axis=1, keepdims=True)
        depth, range_ = rms(changes[number][..., 2]), rms(np.sum(changes[number] * unit, axis=-1))
        turned = _shape_sigma(p[len(reached) + number], changes[len(reached) + number])
        found.append(DepthSigma(lit.depth, len(lit.q), depth, range_, 1e3 * turned))
    return tuple(found)


def _shape_sigma(p: np.ndarray, changes: np.ndarray) -> float:
    """Root mean square error of points [n, 3] by changes [steps, n, 3], their best common rigid motion removed [m]."""
    arm = p - p.mean(0)
    turns = np.stack([np.cross(axis, arm).ravel() for axis in np.eye(3)], axis=-1)
    motions, _ = np.linalg.qr(np.concatenate([np.tile(np.eye(3), (len(arm), 1)), turns], axis=-1))
    moved = changes.reshape(len(changes), arm.size)
    moved = moved - (moved @ motions) @ motions.T
    return float(np.sqrt(np.sum(moved**2) / len(arm)))


def measure_good_to(
    camera: AbstractCamera,
    rig: Scanner | None,
    statistical: Float[np.ndarray, "steps params"],
    structure: Sequence[tuple[ModelTest, np.ndarray]],
    at_m: float | None,
) -> tuple[GoodTo, tuple[ModelTest, ...]]:
    """The error of rays and of a wall's length, and the part of each cause.

    Args:
        camera: The calibrated camera, with its size.
        rig: The calibrated scanner; None of a camera alone.
        statistical: Steps of noise, in the minimal coordinates of the rig, those of the camera first.
        structure: The tests, each with the steps of its structure, none where there is none.
        at_m: Distance of the wall [m]; None: 2.5 m, or the middle one of the depths in reach; of an object on a table
            its near side.

    Returns:
        The errors, those of the laser that is worst, and the tests with their parts of them.
    """
    groups = [statistical, *(steps for _, steps in structure)]
    px = [ray_error(camera, steps[:, : len(camera.parameter_names())]) for steps in groups]
    mm, shares = list[float](), tuple[GoodToPart, ...]()
    far: float | None = None
    length: float | None = None
    for scanner, laser in [] if rig is None else [(rig, laser) for laser in range(len(rig.laser_names))]:
        depth = _judged_depth(scanner, laser) if at_m is None else at_m
        error = None if depth is None else _error_at(scanner, laser, depth)
        if error is None:
            continue
        at, ends, measure = error
        found = [measure(steps) for steps in groups]
        if np.linalg.norm(found) > np.linalg.norm(mm):
            mm, far, length = found, at, ends
            shares = tuple(GoodToPart(name, measure(steps)) for name, steps in _by_part(scanner, statistical))
    tests = [
        replace(test, effect_px=px[index], effect_mm=mm[index] if mm else None) if len(steps) else test
        for index, (test, steps) in enumerate(structure, 1)
    ]
    whole = lambda parts: float(np.linalg.norm(parts)) if parts else None
    statistical_mm = mm[0] if mm else None
    return GoodTo(whole(mm), statistical_mm, far, whole(px), px[0], length, shares, edge_deg(camera)), tuple(tests)


def _error_at(
    scanner: Scanner, laser: int, depth: float
) -> tuple[float, float | None, Callable[[np.ndarray], float]] | None:
    """Distance and length of a wall [m], and its error by some steps [mm]; without a motion that of the range."""
    wall = _wall(scanner, laser, depth)
    if wall is not None:
        return wall.at_m, wall.length_m, lambda steps: wall.sigma_mm(scanner.rig, laser, steps)
    lit = lit_lines(scanner, laser, depth)
    if not len(lit.q):
        return None
    return depth, None, lambda steps: _at_depths(scanner, laser, [lit], steps)[0].sigma_range_mm


def _by_part(scanner: Scanner, steps: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Steps of noise, parted by the part of the rig that is not known.

    The covariance is $C = C_1 + C_2 + ...$, where $C_1$ is what would go if the first part were known exactly, $C_2$
    what would go if the second were known as well, and so on: the squares of errors add up.
    """
    layout, left = scanner.layout(), steps.T @ steps
    motion = layout.names[layout.turntable]
    number = np.arange(len(layout.names))
    of_angles = np.isin(layout.names, [name for name in motion if name in ANGLE_PARAMETERS])
    of = lambda part: np.isin(number, number[part]) & ~of_angles
    parts = {"angles": of_angles, "axis": of(layout.turntable), "sheet": of(layout.lasers), "camera": of(layout.camera)}
    found = []
    for name, own in parts.items():
        size = np.sqrt(np.clip(np.diag(left), 0.0, None))
        own = own & (size > 0)
        if own.any():
            unit = np.where(size > 0, size, 1.0)
            scaled = left / np.outer(unit, unit)
            inverse = np.linalg.pinv(scaled[np.ix_(own, own)], rcond=1e-12, hermitian=True)
            explained = np.outer(unit, unit) * (scaled[:, own] @ inverse @ scaled[own])
            found.append((name, root_of(0.5 * (explained + explained.T))))
            # Exactly: what rounding leaves has no scale, and would be taken for a direction.
            left = np.where(own[:, None] | own, 0.0, left - explained)
    return found


def ray_error(camera: AbstractCamera, steps: Float[np.ndarray, "steps params"]) -> float:
    """Distance of rays from where they should be, root mean square over the image after the best rotation [px]."""
    _, ray = image_places(camera)
    moved = spread(camera, _SMALL * steps, lambda some: np.asarray(some.project(ray))) / _SMALL
    turns = np.asarray(camera.slopes(ray)) @ np.stack([np.cross(axis, ray) for axis in np.eye(3)], -1)
    reached = np.isfinite(moved).all((0, 2)) & np.isfinite(turns).all((1, 2))
    count = int(np.count_nonzero(reached))
    turns, moved = turns[reached].reshape(-1, 3), moved[:, reached].reshape(len(steps), 2 * count).T
    left = moved - turns @ np.linalg.lstsq(turns, moved, rcond=None)[0]
    return float(np.sqrt(np.sum(left**2) / max(count, 1)))


def image_places(camera: AbstractCamera) -> tuple[Float[np.ndarray, "places 2"], Float[np.ndarray, "places 3"]]:
    """Pixels all over the image that the lens reaches within its `edge_deg`, and their rays."""
    q, ray, edge = *_all_places(camera), edge_deg(camera)
    reached = np.linalg.norm(np.asarray(camera.project(ray)) - q, axis=1) < _RETURNS_PX
    reached &= _off_axis_deg(ray) < (np.inf if edge is None else edge)
    return q[reached], ray[reached]


def edge_deg(camera: AbstractCamera) -> float | None:
    """Angle to the optical axis beyond which a lens is not judged [degrees]; None where the image has nothing there."""
    if not camera.wide:
        # Its sensor is lit into the corners, whatever a fit makes of them.
        return None
    away = np.stack([np.sin(_ANGLES), np.zeros(len(_ANGLES)), np.cos(_ANGLES)], axis=-1)
    scale = np.linalg.norm(np.diff(np.asarray(camera.project(away)), axis=0), axis=1)
    small = np.degrees(_ANGLES[:-1][~(scale > _LEAST_SCALE * scale[0])])
    return float(small[0]) if len(small) and np.any(_off_axis_deg(_all_places(camera)[1]) >= small[0]) else None


def field_radius(camera: AbstractCamera) -> float:
    """Distance from the middle of the image to the farthest of its pixels within `edge_deg` [px]."""
    half, edge = np.array([camera.width, camera.height]) / 2.0, edge_deg(camera)
    if edge is None:
        return float(np.linalg.norm(half))
    ray = [[np.sin(np.radians(edge)) * x, np.sin(np.radians(edge)) * y, np.cos(np.radians(edge))] for x, y in _SIDES]
    ends = np.linalg.norm(np.asarray(camera.project(np.array(ray))) - half + 0.5, axis=1)
    return min(float(np.linalg.norm(half)), float(ends.max()))


def _all_places(camera: AbstractCamera) -> tuple[np.ndarray, np.ndarray]:
    u, v = (
        (np.arange(count) + 0.5) / count * size - 0.5
        for count, size in zip(_GRID, (camera.width, camera.height), strict=True)
    )
    q = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    return q, np.asarray(camera.unproject(q))


def _off_axis_deg(ray: np.ndarray) -> np.ndarray:
    return np.degrees(np.arctan2(np.hypot(ray[:, 0], ray[:, 1]), ray[:, 2]))


def focal_share(camera: AbstractCamera, steps: Float[np.ndarray, "steps params"]) -> float:
    """Relative standard deviation of the focal length [1]: of the scale in the middle of the image, for any model."""
    scale = lambda moved: np.trace(np.asarray(moved.slopes(np.array([0.0, 0.0, 1.0])))[:, :2])
    changes = spread(camera, _SMALL * steps[:, : len(camera.parameter_names())], scale) / _SMALL
    return float(np.linalg.norm(changes) / scale(camera))
