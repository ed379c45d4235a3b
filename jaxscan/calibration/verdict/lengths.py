"""A calibration's covariance in millimetres: depths, points and lengths, free of any gauge.

Standard deviations of parameters say little: they are strongly correlated, and the place of the
frame does not matter. So everything here is a length between points that were scanned, or a
distance from the camera, at fixed pixels and table angles.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscan.calibration.verdict.lit import Lit, lit_lines
from jaxscan.calibration.verdict.propagate import both_ways, camera_points, change, scan_points, sigma_of, sigma_steps
from jaxscan.calibration.verdict.quality import DepthSigma, LaserLengths, Lengths, LengthSigma
from jaxscan.geometry import AbstractMotion, LinearStage, Scanner, Still, Turntable


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
    r"""Standard deviations that the calibration causes in lengths that people measure.

    With the covariance $C = L L^T$ and $l_k$ the columns of $L$, the variance of a length $f$ is
    $\sum_k [(f(+l_k) - f(-l_k)) / 2]^2$, every point at its fixed pixel and angle: to first order
    $J C J^T$. Noise of the stripe itself comes on top.

    Args:
        scanner: With its covariance.

    Returns:
        For every laser the depths that the rig reaches, and its `typical_lengths`; those out of
        reach or out of the image are left out, so both may be empty.

    Raises:
        ValueError: If the scanner has no covariance.

    Source: mrcal's projection uncertainty, carried over to lengths; ASTM E3125 for the choice.
    """
    steps = sigma_steps(scanner)
    lasers = []
    for index, name in enumerate(scanner.laser_names):
        reached = lit_in_reach(scanner, index)
        lengths = _typical(scanner, index, reached)
        values = _lengths(scanner, lengths, steps)
        described = tuple(
            LengthSigma(length.name, length.depth, float(value), 1000.0 * float(sigma))
            for length, value, sigma in zip(lengths, values[0], sigma_of(values), strict=True)
        )
        lasers.append(LaserLengths(name, _at_depths(scanner, index, reached, steps), described))
    return Lengths(tuple(lasers))


def lit_in_reach(scanner: Scanner, laser: int) -> list[Lit]:
    """The stripe at those of `DEPTHS_M` where it is in the image and its pixels still mean something.

    A table that carries the object is never looked at far beyond itself.
    """
    table = scanner.turntable
    limit = 2.0 * float(table.point[2]) if isinstance(table, Turntable) and table.carries == "object" else np.inf
    candidates = lit_lines(scanner, laser, [depth for depth in DEPTHS_M if depth <= limit])
    return [lit for lit in candidates if len(lit.q) and lit.per_pixel <= _MAX_PIXEL_SHARE * lit.depth]


def working_depth(scanner: Scanner, laser: int) -> float | None:
    """The depth at which people judge a rig [m]; None where none is in reach.

    It is 2.5 m, or the middle one of those in reach; of an object on a table its near side.
    """
    reached = lit_in_reach(scanner, laser)
    if not reached:
        return None
    if isinstance(table := scanner.turntable, Turntable) and table.carries == "object":
        return (1.0 - _OBJECT_SHARE) * float(table.point[2])
    return _middle(reached).depth


def point_error(scanner: Scanner, laser: int, depth: float, steps: Float[np.ndarray, "steps params"]) -> float | None:
    """Error of points at a depth [mm] as `DepthSigma.sigma_point_mm` has it, or of their range without a motion.

    Args:
        scanner: Its covariance is not used.
        laser: Which sheet.
        depth: Of the points [m].
        steps: In the minimal coordinates; each counts as one standard deviation.

    Returns:
        The error; None where that depth is nowhere in the image.
    """
    (lit,) = lit_lines(scanner, laser, (depth,))
    if not len(lit.q):
        return None
    (found,) = _at_depths(scanner, laser, [lit], both_ways(steps))
    return found.sigma_range_mm if isinstance(scanner.turntable, Still) else found.sigma_point_mm


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
    return camera_points(scanner.rig, q, laser)[:, 2]


def depth_sigma(scanner: Scanner, laser: int, q: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, " points"]:
    """Standard deviation that the calibration causes in `stripe_depths` [m].

    Raises:
        ValueError: If the scanner has no covariance.
    """
    return sigma_of(scan_points(scanner, sigma_steps(scanner), q, laser)[..., 2])


def typical_lengths(scanner: Scanner, laser: int) -> list[Length]:
    """Lengths that people ask for, as far as the rig reaches them.

    300 mm at 2.5 m (or as long for its depth at the middle one of the depths in reach), along the
    stripe of one image and across the sweep; and between two points half a turn apart: opposite
    walls of two rooms, or two sides of an object on the table.
    """
    return _typical(scanner, laser, lit_in_reach(scanner, laser))


def measure_lengths(scanner: Scanner, lengths: list[Length]) -> Float[np.ndarray, " lengths"]:
    """The lengths as this scanner measures them at their pixels and angles [m]."""
    return _lengths(scanner, lengths, np.zeros((1, len(scanner.parameter_names()))))[0]


def length_sigma(scanner: Scanner, lengths: list[Length]) -> Float[np.ndarray, " lengths"]:
    """Standard deviation that the calibration causes in `measure_lengths` [m].

    Raises:
        ValueError: If the scanner has no covariance.
    """
    return sigma_of(_lengths(scanner, lengths, sigma_steps(scanner)))


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


def _lengths(scanner: Scanner, lengths: list[Length], steps: np.ndarray) -> np.ndarray:
    """[steps, lengths], metres."""
    if not lengths:
        return np.zeros((len(steps), 0))
    q, angle = (np.concatenate(parts) for parts in zip(*((one.q, one.angle) for one in lengths), strict=True))
    p = scan_points(scanner, steps, q, np.repeat([length.laser for length in lengths], 2), angle)
    return np.linalg.norm(p[:, 1::2] - p[:, 0::2], axis=-1)


def _at_depths(scanner: Scanner, laser: int, reached: list[Lit], steps: np.ndarray) -> tuple[DepthSigma, ...]:
    lines = [_some(lit.q, _LINES) for lit in reached]
    turned = [_some(lit.q, _TURN_LINES) for lit in reached]
    stops = _stops(scanner.turntable)
    q = [part for one, other in zip(lines, turned, strict=True) for part in (one, np.tile(other, (len(stops), 1)))]
    angle = [
        part for one, other in zip(lines, turned, strict=True) for part in (0.0 * one[:, 0], stops.repeat(len(other)))
    ]
    if not q:
        return ()
    p = scan_points(scanner, steps, np.concatenate(q), laser, np.concatenate(angle))
    parts = np.split(p, np.cumsum([len(part) for part in q])[:-1], axis=1)
    return tuple(
        DepthSigma(
            depth_m=lit.depth,
            lines=len(lit.q),
            sigma_depth_mm=1000.0 * _rms(sigma_of(still[..., 2])),
            sigma_range_mm=1000.0 * _rms(sigma_of(np.linalg.norm(still, axis=-1))),
            sigma_point_mm=1000.0 * _shape_sigma(turning),
        )
        for lit, still, turning in zip(reached, parts[0::2], parts[1::2], strict=True)
    )


def _stops(motion: AbstractMotion) -> np.ndarray:
    """Positions of a motion at which points stand for a whole cloud [rad or m]."""
    if isinstance(motion, Turntable):
        return 2.0 * np.pi * np.arange(_TURN_STOPS) / _TURN_STOPS
    return np.linspace(-0.5 * TRAVEL_M, 0.5 * TRAVEL_M, _TURN_STOPS) if isinstance(motion, LinearStage) else np.zeros(1)


def _shape_sigma(p: np.ndarray) -> float:
    """Root mean square error of points [steps, n, 3], their best common rigid motion removed [m]."""
    arm = p[0] - p[0].mean(0)
    turns = np.stack([np.cross(axis, arm).ravel() for axis in np.eye(3)], axis=-1)
    shifts = np.tile(np.eye(3), (len(arm), 1))
    motions, _ = np.linalg.qr(np.concatenate([shifts, turns], axis=-1))
    moved = change(p).reshape(len(p) // 2, arm.size)
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
    point = camera_points(scanner.rig, lit.middle()[None], laser)[0]
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
