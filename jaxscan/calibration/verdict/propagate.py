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

from jaxscan.calibration.settings import CalibrationSettings
from jaxscan.calibration.verdict import limits
from jaxscan.calibration.verdict.quality import (
    DepthSigma,
    GoodTo,
    LaserLengths,
    Lengths,
    LengthSigma,
    ModelTest,
)
from jaxscan.geometry import (
    AbstractCamera,
    AbstractMotion,
    LinearStage,
    Rig,
    Scanner,
    Still,
    Turntable,
    lit_points,
    points,
    root_of,
)


DEPTHS_M = (0.1, 0.15, 0.25, 0.4, 0.6, 1.0, 1.5, 2.5, 4.0, 6.0, 10.0, 15.0, 25.0)
"""Depths at which a rig is judged, where it reaches them [m]."""
HALF_TURN_DEPTHS_M = (1.91, 3.075)
"""Depths of two opposite walls, seen half a turn apart: rooms about 3.8 and 6.1 m wide [m]."""
TRAVEL_M = 0.5
"""Travel over which a linear stage is judged [m]."""
# As long, for its depth, as 300 mm at 2.5 m, by which scanners of rooms are compared.
_LENGTH_SHARE = 0.12
_COMMON_DEPTH_M = 2.5
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


def spread(
    moved: Rig | AbstractCamera, steps: Float[np.ndarray, "steps params"], measure: Callable[[Any], np.ndarray]
) -> Float[np.ndarray, "steps ..."]:
    r"""Half of the change of a measurement from back to forth along each step.

    With the covariance $C = \sum_k s_k s_k^T$ and $f$ a measurement, its variance is the sum of the squares of
    $(f(+s_k) - f(-s_k)) / 2$, to first order $J C J^T$. Nothing is differentiated.

    Args:
        moved: What has `retract`.
        steps: In its minimal coordinates; each counts as one standard deviation.
        measure: Of it, at fixed pixels and angles.

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
    per_pixel: float
    """Change of the depth over one pixel [m / px]."""

    def middle(self) -> Float[np.ndarray, "2"]:
        """Pixel of the point nearest the optical axis."""
        return self.q[np.argmin(np.abs(self.along))]


def lit_lines(scanner: Scanner, laser: int, depths: Sequence[float]) -> list[Lit]:
    """The stripe of one sheet on planes at several depths [m]; no depths, no stripes."""
    if not len(depths):
        return []
    size = np.array([scanner.camera.width, scanner.camera.height])
    tangents = np.linspace(-_WIDEST_TANGENT, _WIDEST_TANGENT, _SAMPLES)
    every = np.array([near * depth for depth in depths for near in (1.0, _NEARBY)])
    along = np.repeat(depths, 2)[:, None] * tangents
    q, seen = _stripe(scanner, laser, np.repeat(every, _SAMPLES), along.ravel())
    q, seen = q.reshape(len(depths), 2, _SAMPLES, 2), np.all(seen.reshape(len(depths), 2, _SAMPLES), axis=1)
    found = []
    for number, depth in enumerate(depths):
        at, shift = _at_lines(q[number, 0], seen[number], along[2 * number], q[number, 1], size)
        found.append((depth, at, (_NEARBY - 1.0) * depth / shift))
    # Interpolated to a tenth of a line; the pixels there are computed exactly.
    count = [len(at) for _, at, _ in found]
    q, seen = _stripe(scanner, laser, np.repeat(depths, count), np.concatenate([at for _, at, _ in found]))
    kept = seen & ((q >= -0.5) & (q <= size - 0.5)).all(-1)
    ends = np.cumsum(count)
    parts = [slice(end - size, end) for end, size in zip(ends, count, strict=True)]
    return [
        Lit(depth, q[part][kept[part]], at[kept[part]], float(worth))
        for (depth, at, worth), part in zip(found, parts, strict=True)
    ]


def _at_lines(
    q: np.ndarray, seen: np.ndarray, along: np.ndarray, q_nearby: np.ndarray, size: np.ndarray
) -> tuple[np.ndarray, float]:
    """Where along a sampled stripe the lines of the image are, and how far it shifts to the depth nearby [px]."""
    inside = seen & ((q >= 0) & (q <= size - 1)).all(-1)
    if inside.sum() < 2:
        return np.zeros(0), 1.0
    axis = int(np.ptp(q[inside, 1]) >= np.ptp(q[inside, 0]))
    middle = np.flatnonzero(inside)[inside.sum() // 2 + np.array([-1, 0])]
    tangent = q[middle[1]] - q[middle[0]]
    # A motion along the stripe is not seen.
    shift = np.abs(np.linalg.det([tangent, q_nearby[middle[0]] - q[middle[0]]])) / np.linalg.norm(tangent)
    order = np.argsort(q[seen, axis])
    across, along = q[seen, axis][order], along[seen][order]
    lines = np.arange(size[axis])
    lines = lines[(lines >= across[0]) & (lines <= across[-1])]
    return np.interp(lines, across, along), float(shift)


def _stripe(scanner: Scanner, laser: int, depth: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of the points of a sheet at depths, and whether the camera sees them there."""
    sheet, camera = scanner.laser(laser), scanner.camera
    # In the plane z = depth the sheet is a line at a distance from the optical axis, but for its bow.
    steepness = float(np.hypot(sheet.normal[0], sheet.normal[1]))
    if steepness <= 1e-6:
        return np.zeros((len(depth), 2)), np.zeros(len(depth), bool)
    beside = np.asarray(sheet.normal[:2]) / steepness
    points = lambda at: np.column_stack([np.outer(at, beside) + np.outer(along, [-beside[1], beside[0]]), depth])
    at = (sheet.distance - sheet.normal[2] * depth) / steepness
    # Each round leaves the slope of the bow, less than a hundredth, of the error before.
    for _ in range(4):
        at = at - sheet.offset(points(at)) / steepness
    p = points(at)
    q = np.asarray(camera.project(p))
    # Far outside its field of view a lens model may fold back into the image.
    same = np.linalg.norm(camera.unproject(q) - p / np.linalg.norm(p, axis=1, keepdims=True), axis=1) < 1e-6
    return q, np.asarray(same & (np.abs(sheet.offset(p)) < 1e-6 * depth))


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


def predict_lengths(scanner: Scanner) -> Lengths:
    """Standard deviations that the calibration causes in lengths that people measure; noise of the stripe is on top.

    Args:
        scanner: With its covariance.

    Returns:
        For every laser the depths that the rig reaches, and its `typical_lengths`; those out of
        reach or out of the image are left out, so both may be empty.

    Raises:
        ValueError: If the scanner has no covariance.

    Source: ASTM E3125 for the choice.
    """
    steps, lasers = _root(scanner), []
    for index, name in enumerate(scanner.laser_names):
        reached = _in_reach(scanner, index)
        lengths = _typical(scanner, index, reached)
        measured = zip(lengths, measure_lengths(scanner, lengths), _length_sigma(scanner, lengths, steps), strict=True)
        described = tuple(
            LengthSigma(length.name, length.depth, float(value), 1000.0 * float(sigma))
            for length, value, sigma in measured
        )
        lasers.append(LaserLengths(name, _at_depths(scanner, index, reached, steps), described))
    return Lengths(tuple(lasers))


def stripe_pixels(scanner: Scanner, laser: int, depth: float) -> Float[np.ndarray, "lines 2"]:
    """Where the stripe of one depth is seen: one pixel for each row of the image that it crosses.

    One for each column, if the stripe at that depth runs along the rows of the image.

    Args:
        scanner: Camera and sheets; its covariance is not used.
        laser: Which sheet.
        depth: z in the camera frame [m].

    Returns:
        (u, v) [px] by ascending row or column; empty where that depth is nowhere in the image.
    """
    return lit_lines(scanner, laser, (depth,))[0].q


def stripe_depths(scanner: Scanner, laser: int, q: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, " points"]:
    """Depth z in the camera frame of stripe points seen at pixels `q` [m]."""
    return np.asarray(lit_points(scanner.rig, q, laser)[0])[:, 2]


def depth_sigma(scanner: Scanner, laser: int, q: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, " points"]:
    """Standard deviation that the calibration causes in `stripe_depths` [m].

    Raises:
        ValueError: If the scanner has no covariance.
    """
    return _sigma(spread(scanner.rig, _root(scanner), lambda rig: np.asarray(lit_points(rig, q, laser)[0])[:, 2]))


def typical_lengths(scanner: Scanner, laser: int) -> list[Length]:
    """Lengths that people ask for, as far as the rig reaches them.

    300 mm at 2.5 m (or as long for its depth at the middle one of the depths in reach), along the
    stripe of one image and across the sweep; and between two points half a turn apart: opposite
    walls of two rooms, or two sides of an object on the table.
    """
    return _typical(scanner, laser, _in_reach(scanner, laser))


def measure_lengths(scanner: Scanner, lengths: list[Length]) -> Float[np.ndarray, " lengths"]:
    """The lengths as this scanner measures them at their pixels and angles [m]."""
    return _measured(scanner.rig, lengths)


def length_sigma(scanner: Scanner, lengths: list[Length]) -> Float[np.ndarray, " lengths"]:
    """Standard deviation that the calibration causes in `measure_lengths` [m].

    Raises:
        ValueError: If the scanner has no covariance.
    """
    return _length_sigma(scanner, lengths, _root(scanner))


def _length_sigma(scanner: Scanner, lengths: list[Length], steps: np.ndarray) -> np.ndarray:
    return _sigma(spread(scanner.rig, steps, lambda rig: _measured(rig, lengths)))


def _measured(rig: Rig, lengths: list[Length]) -> np.ndarray:
    """[lengths], metres."""
    if not lengths:
        return np.zeros(0)
    q, angle = (np.concatenate(parts) for parts in zip(*((one.q, one.angle) for one in lengths), strict=True))
    p = np.asarray(points(rig, q, np.repeat([length.laser for length in lengths], 2), angle))
    return np.linalg.norm(p[1::2] - p[0::2], axis=-1)


def _typical(scanner: Scanner, laser: int, reached: list[Lit]) -> list[Length]:
    if not reached:
        return []
    lit = _middle(reached)
    found = [
        _along_stripe(laser, lit, _LENGTH_SHARE * lit.depth),
        _across_sweep(scanner, laser, lit, _LENGTH_SHARE * lit.depth),
        *_half_turns(scanner, laser, reached[-1].depth),
    ]
    return [length for length in found if length is not None]


def _half_turns(scanner: Scanner, laser: int, farthest: float) -> list[Length | None]:
    """Between opposite walls, or two sides of an object; none without a table."""
    table = scanner.turntable
    halves: tuple[float, ...] = HALF_TURN_DEPTHS_M
    if not isinstance(table, Turntable):
        return []
    if table.carries == "object":
        halves = ((1.0 - _OBJECT_SHARE) * float(table.point[2]),)
    elif farthest < max(halves):
        halves = (farthest,)
    return [_half_turn(laser, lit) for lit in lit_lines(scanner, laser, halves)]


def _middle(reached: list[Lit]) -> Lit:
    return next((each for each in reached if each.depth == _COMMON_DEPTH_M), reached[len(reached) // 2])


def _in_reach(scanner: Scanner, laser: int) -> list[Lit]:
    """The stripe at those of `DEPTHS_M` where it is in the image and its pixels still mean something.

    A table that carries the object is never looked at far beyond itself.
    """
    table = scanner.turntable
    limit = 2.0 * float(table.point[2]) if isinstance(table, Turntable) and table.carries == "object" else np.inf
    candidates = lit_lines(scanner, laser, [depth for depth in DEPTHS_M if depth <= limit])
    return [lit for lit in candidates if len(lit.q) and lit.per_pixel <= _MAX_PIXEL_SHARE * lit.depth]


def _at_depths(scanner: Scanner, laser: int, reached: list[Lit], steps: np.ndarray) -> tuple[DepthSigma, ...]:
    if not reached:
        return ()
    stops, still = _stops(scanner.turntable), [_some(lit.q, _LINES) for lit in reached]
    turning = [np.tile(_some(lit.q, _TURN_LINES), (len(stops), 1)) for lit in reached]
    angle = np.concatenate([np.repeat(stops, len(q) // len(stops)) for q in turning])
    q_still, q_turning = np.concatenate(still), np.concatenate(turning)

    def measure(rig: Rig) -> np.ndarray:
        # Before the camera where it stands still, and all around.
        parts = lit_points(rig, q_still, laser)[0], points(rig, q_turning, laser, angle)
        return np.concatenate([np.asarray(part) for part in parts])

    ends = np.cumsum([len(q) for q in (*still, *turning)])[:-1]
    p, changes = np.split(measure(scanner.rig), ends), np.split(spread(scanner.rig, steps, measure), ends, axis=1)
    found = []
    for index, lit in enumerate(reached):
        here, change, around = p[index], changes[index], len(reached) + index
        unit = here / np.linalg.norm(here, axis=1, keepdims=True)
        found.append(
            DepthSigma(
                depth_m=lit.depth,
                lines=len(lit.q),
                sigma_depth_mm=1000.0 * _rms(_sigma(change[..., 2])),
                sigma_range_mm=1000.0 * _rms(_sigma(np.sum(change * unit, axis=-1))),
                sigma_point_mm=1000.0 * _shape_sigma(p[around], changes[around]),
            )
        )
    return tuple(found)


def _stops(motion: AbstractMotion) -> np.ndarray:
    """Positions of a motion at which points stand for a whole cloud [rad or m]."""
    if isinstance(motion, Turntable):
        return 2.0 * np.pi * np.arange(_TURN_STOPS) / _TURN_STOPS
    return np.linspace(-0.5 * TRAVEL_M, 0.5 * TRAVEL_M, _TURN_STOPS) if isinstance(motion, LinearStage) else np.zeros(1)


def _shape_sigma(p: np.ndarray, changes: np.ndarray) -> float:
    """Root mean square error of points [n, 3] by changes [steps, n, 3], their best common rigid motion removed [m]."""
    arm = p - p.mean(0)
    turns = np.stack([np.cross(axis, arm).ravel() for axis in np.eye(3)], axis=-1)
    motions, _ = np.linalg.qr(np.concatenate([np.tile(np.eye(3), (len(arm), 1)), turns], axis=-1))
    moved = changes.reshape(len(changes), arm.size)
    moved = moved - (moved @ motions) @ motions.T
    return float(np.sqrt(np.sum(moved**2) / len(arm)))


def _along_stripe(laser: int, lit: Lit, length: float) -> Length | None:
    """Two points of one image, as near to the optical axis as the image lets them be."""
    if len(lit.q) == 0 or np.ptp(lit.along) < length:
        return None
    middle = np.clip(0.0, lit.along.min() + length / 2, lit.along.max() - length / 2)
    at, order = middle + length / 2 * np.array([-1.0, 1.0]), np.argsort(lit.along)
    # Between neighbouring lines the stripe is straight to far less than a pixel.
    ends = np.stack([np.interp(at, lit.along[order], lit.q[order, i]) for i in range(2)], axis=-1)
    return Length("along the stripe", lit.depth, laser, ends, np.zeros(2))


def _across_sweep(scanner: Scanner, laser: int, lit: Lit, length: float) -> Length | None:
    """The middle of the stripe, turned or moved so far that the point moves by the length; None without a motion."""
    table = scanner.turntable
    if isinstance(table, LinearStage):
        moved = np.array([0.0, length / float(table.gain)])
        return Length("across the sweep", lit.depth, laser, np.tile(lit.middle(), (2, 1)), moved)
    if not isinstance(table, Turntable):
        return None
    point = np.asarray(lit_points(scanner.rig, lit.middle()[None], laser)[0])[0]
    radius = float(np.linalg.norm(np.cross(np.asarray(table.direction), point - np.asarray(table.point))))
    if length > 2.0 * radius:
        return None
    turn = 2.0 * np.arcsin(length / (2.0 * radius)) / abs(float(table.gain))
    return Length("across the sweep", lit.depth, laser, np.tile(lit.middle(), (2, 1)), np.array([0.0, turn]))


def _half_turn(laser: int, lit: Lit) -> Length | None:
    if len(lit.q) == 0:
        return None
    return Length("half a turn", lit.depth, laser, np.tile(lit.middle(), (2, 1)), np.array([0.0, np.pi]))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _some(values: np.ndarray, count: int) -> np.ndarray:
    return values[np.unique(np.linspace(0, len(values) - 1, count).round().astype(int))]


def measure_good_to(
    camera: AbstractCamera,
    scanner: Scanner | None,
    statistical: Float[np.ndarray, "steps params"],
    structure: Sequence[tuple[ModelTest, np.ndarray]],
    at_m: float | None,
) -> tuple[GoodTo, tuple[ModelTest, ...]]:
    """The error of rays and of scanned points, and the part of each cause.

    Args:
        camera: The calibrated camera, with its size.
        scanner: The calibrated rig; None of a camera alone.
        statistical: Steps of noise, in the minimal coordinates of the rig, those of the camera first.
        structure: The tests, each with the steps of its structure, none where there is none.
        at_m: Depth of the points [m]; None: as people judge such a rig.

    Returns:
        The errors, and the tests with their parts of them.
    """
    groups = [statistical, *(steps for _, steps in structure)]
    px = [ray_error(camera, steps[:, : len(camera.parameter_names())]) for steps in groups]
    mm, depth = _at_work(scanner, groups, at_m)
    tests = [
        replace(test, effect_px=px[index], effect_mm=mm[index] if mm else None) if len(steps) else test
        for index, (test, steps) in enumerate(structure, 1)
    ]
    whole = lambda parts: float(np.linalg.norm(parts)) if parts else None
    return GoodTo(whole(mm), mm[0] if mm else None, depth, whole(px), px[0]), tuple(tests)


def ray_error(camera: AbstractCamera, steps: Float[np.ndarray, "steps params"]) -> float:
    """Distance of rays from where they should be, root mean square over the image after the best rotation [px].

    Args:
        camera: With its size.
        steps: In its minimal coordinates; each counts as one standard deviation.
    """
    q = image_places(camera)
    ray = np.asarray(camera.unproject(q))
    moved = spread(camera, _SMALL * steps, lambda some: np.asarray(some.project(ray))) / _SMALL
    turns = np.asarray(camera.slopes(ray)) @ np.stack([np.cross(axis, ray) for axis in np.eye(3)], -1)
    reached = np.linalg.norm(np.asarray(camera.project(ray)) - q, axis=1) < _RETURNS_PX
    reached &= np.isfinite(moved).all((0, 2)) & np.isfinite(turns).all((1, 2))
    count = int(np.count_nonzero(reached))
    turns, moved = turns[reached].reshape(-1, 3), moved[:, reached].reshape(len(steps), 2 * count).T
    left = moved - turns @ np.linalg.lstsq(turns, moved, rcond=None)[0]
    return float(np.sqrt(np.sum(left**2) / max(count, 1)))


def image_places(camera: AbstractCamera) -> Float[np.ndarray, "places 2"]:
    """Pixels all over the image."""
    u, v = (
        (np.arange(count) + 0.5) / count * size - 0.5
        for count, size in zip(_GRID, (camera.width, camera.height), strict=True)
    )
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)


def focal_share(camera: AbstractCamera, steps: Float[np.ndarray, "steps params"]) -> float:
    """Standard deviation of the focal length over it [1]: of the scale in the middle of the image, of any model.

    Args:
        camera: The calibrated camera.
        steps: In the minimal coordinates, those of the camera first; each counts as one standard deviation.
    """
    scale = lambda moved: np.trace(np.asarray(moved.slopes(np.array([0.0, 0.0, 1.0])))[:, :2])
    changes = spread(camera, _SMALL * steps[:, : len(camera.parameter_names())], scale) / _SMALL
    return float(np.linalg.norm(changes) / scale(camera))


def refusal(
    good_to: GoodTo,
    camera: AbstractCamera,
    settings: CalibrationSettings,
    *,
    has_sheets: bool = True,
    focal: float = 0.0,
) -> str | None:
    """Why a calibration cannot be used, its focal length known to a share of it; None where it can."""
    mm, px, at_m = good_to.sigma_mm, good_to.sigma_px, good_to.at_m
    if mm is None and settings.limit_mm is not None:
        if not has_sheets:
            return f"{settings.limit_mm:g} mm were asked, and without a laser sheet there are no points"
        where = "within reach" if settings.at_m is None else f"in the image at {settings.at_m:g} m"
        return f"{settings.limit_mm:g} mm were asked, and no stripe is {where}"
    if mm is not None and settings.limit_mm is not None and mm > settings.limit_mm:
        return f"{settings.limit_mm:g} mm were asked"
    if px is not None and settings.limit_px is not None and px > settings.limit_px:
        return f"{settings.limit_px:g} px were asked, and its rays are good to {px:.2g} px"
    if focal > limits.UNKNOWN_FOCAL:
        return (
            f"its focal length is known to {100 * focal:.2g} % only, which makes no camera: tilt the board by 20 to "
            "45 degrees in different directions"
        )
    share = f"{100 * limits.USELESS_SHARE:.0f} %"
    if mm is not None and at_m is not None and mm > 1e3 * limits.USELESS_SHARE * at_m:
        return f"points that are off by more than {share} of their distance are of no use"
    if px is not None and px > limits.USELESS_SHARE * 0.5 * (float(camera.fx) + float(camera.fy)):
        return f"rays that are off by more than {share} of the focal length are of no use"
    return None


def _at_work(
    scanner: Scanner | None, groups: Sequence[np.ndarray], at_m: float | None
) -> tuple[list[float], float | None]:
    """Errors of scanned points for each group of steps [mm], of the laser that is worst, and their depth [m].

    Without a motion, errors of their range. A rig is judged at 2.5 m, or at the middle one of the depths in reach; that
    of an object on a table at its near side.
    """
    worst: list[float] = []
    worst_depth = None
    if scanner is None:
        return worst, worst_depth
    for laser in range(len(scanner.laser_names)):
        depth, table = at_m, scanner.turntable
        if depth is None and (reached := _in_reach(scanner, laser)):
            depth = _middle(reached).depth
            if isinstance(table, Turntable) and table.carries == "object":
                depth = (1.0 - _OBJECT_SHARE) * float(table.point[2])
        lit = None if depth is None else lit_lines(scanner, laser, (depth,))[0]
        if lit is None or not len(lit.q):
            continue
        found = [_at_depths(scanner, laser, [lit], steps)[0] for steps in groups]
        errors = [one.sigma_range_mm if isinstance(table, Still) else one.sigma_point_mm for one in found]
        if np.linalg.norm(errors) > np.linalg.norm(worst):
            worst, worst_depth = errors, depth
    return worst, worst_depth
