"""The plan of a capture: positions, frames, space and time; and the controller's settings."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import count

from jaxscan.errors import ConfigError
from jaxscan.stripes import level_exposures
from scanrig.config import RigConfig
from scanrig.controllers import Settings


RESERVE = 1.1
"""Space required, as a multiple of the uncompressed size of the frames."""
_OVERHEAD_S = 0.03
"""Time of a step beside motion and exposures: link and disk."""


@dataclass(frozen=True)
class Target:
    """A record to take."""

    record: int
    """Its number; with several lasers `RigConfig.laser_of` gives its laser."""
    position: int
    turn: int
    """Its pass, or its placement."""


@dataclass(frozen=True)
class Estimate:
    """Frames, space and time of a capture."""

    frames: int
    bytes: int
    """Space, with a reserve."""
    seconds: float


def nearest(angle_deg: Fraction | float, microsteps_per_turn: int) -> int:
    """The position nearest to an angle [microsteps]; halves are rounded up."""
    return math.floor(exactly(angle_deg) * microsteps_per_turn / 360 + Fraction(1, 2))


def exactly(angle: Fraction | float) -> Fraction:
    """A decimal number as an exact fraction: 0.1 is one tenth."""
    return angle if isinstance(angle, Fraction) else Fraction(repr(float(angle)))


def angle_deg(position: int, microsteps_per_turn: int) -> float:
    """The table's angle at a position, unwrapped [deg from home]."""
    return 360 * position / microsteps_per_turn


def plan_sweep(config: RigConfig) -> tuple[tuple[Target, ...], tuple[str, ...]]:
    """The records of a sweep in order, at each step one for each laser, and sentences that people should read.

    Step k of K in a full turn of N microsteps is at (2 k N + K) div (2 K): each position is computed by itself, so that
    rounding errors do not add up.

    Raises:
        ConfigError: If two steps have the same position, or the table would leave its limits.
    """
    sweep, n = config.sweep, config.microsteps_per_turn
    step = exactly(sweep.turn_deg) / sweep.steps
    pass_ = [nearest(exactly(sweep.start_deg) + k * step, n) for k in range(sweep.steps)]
    if len(set(pass_)) < len(pass_):
        raise ConfigError(
            f"sweep.steps: found {sweep.steps} steps in {abs(sweep.turn_deg):g} deg, expected at most "
            f"{abs(exactly(sweep.turn_deg)) * n // 360}: a turn has {n} microsteps."
        )
    _within_limits(config, pass_, "sweep")
    notes = []
    in_microsteps = abs(step) * n / 360
    if in_microsteps.denominator != 1:
        notes.append(
            f"A step of {float(abs(step)):g} deg is {float(in_microsteps):.4f} microsteps: steps are up to "
            f"{180 / n:.4f} deg off the plan; their true angles are recorded."
        )
    each = [(turn, to) for turn in range(sweep.turns) for to in pass_ for _ in config.laser]
    return tuple(Target(record, to, turn) for record, (turn, to) in enumerate(each)), tuple(notes)


def placement_positions(config: RigConfig) -> tuple[tuple[int, ...], ...]:
    """Positions of the table for each placement of the board [microsteps]: its angles around its bearing.

    Raises:
        ConfigError: If two angles have the same position, or the table would leave its limits.
    """
    n, plan = config.microsteps_per_turn, config.calibration
    bearings = [exactly(plan.bearings_deg[k % len(plan.bearings_deg)]) for k in range(plan.placements)]
    positions = tuple(tuple(nearest(at + exactly(angle), n) for angle in plan.angles_deg) for at in bearings)
    if any(len(set(stops)) < len(stops) for stops in positions):
        raise ConfigError("calibration.angles_deg: found two at the same microstep, expected different ones.")
    _within_limits(config, [0, *(stop for stops in positions for stop in stops)], "calibration")
    return positions


def placement_bearing(config: RigConfig, number: int) -> int:
    """Where the table points while the board is placed for a placement, counted from 0 [microsteps]."""
    bearings = config.calibration.bearings_deg
    return nearest(bearings[number % len(bearings)], config.microsteps_per_turn)


def placed_targets(
    config: RigConfig, positions: Sequence[tuple[int, ...]]
) -> tuple[tuple[tuple[Target, ...], ...], tuple[tuple[Target, ...], ...]]:
    """The records of each free view, and those of each placement; at each position one for each laser."""
    plan, record = config.calibration, count()
    places = [(0,)] * plan.free_views + list(positions)
    targets = tuple(
        tuple(Target(next(record), to, number) for to in stops for _ in config.laser)
        for number, stops in enumerate(places)
    )
    return targets[: plan.free_views], targets[plan.free_views :]


def _within_limits(config: RigConfig, positions: Sequence[int], kind: str) -> None:
    limits = controller_settings(config).limits
    if limits is None:
        return
    low, high = min(*positions, 0), max(*positions, 0)
    if not limits[0] <= low <= high <= limits[1]:
        n = config.microsteps_per_turn
        raise ConfigError(
            f"{kind}: goes from {angle_deg(low, n):g} to {angle_deg(high, n):g} deg, but turntable.limits_deg allows "
            f"{angle_deg(limits[0], n):g} to {angle_deg(limits[1], n):g}."
        )


def controller_settings(config: RigConfig) -> Settings:
    """The controller's settings, in its own units."""
    table, n = config.turntable, config.microsteps_per_turn
    trigger = config.trigger
    limits = None
    if table.limits_deg is not None:
        low, high = (exactly(limit) * n / 360 for limit in table.limits_deg)
        limits = (math.ceil(low), math.floor(high))
    return Settings(
        watchdog_ms=config.controller.watchdog_ms,
        speed=table.rate("speed_deg_s"),
        start_speed=table.rate("start_speed_deg_s"),
        acceleration=table.rate("acceleration_deg_s2"),
        home_speed=table.rate("home_speed_deg_s"),
        backlash=nearest(table.backlash_deg, n),
        reverse=table.reverse,
        settle_ms=table.settle_ms,
        laser_on_ms=max(laser.on_ms for laser in config.laser),
        laser_off_ms=max(laser.off_ms for laser in config.laser),
        exposure_ms=min(trigger.pulse_ms or math.ceil(config.camera.exposure_ms), 5000),
        gap_ms=trigger.gap_ms,
        ready_ms=trigger.ready_ms,
        limits=limits,
        lasers=len(config.laser),
    )


def frame_bytes(config: RigConfig) -> int:
    """Size of one frame as a capture keeps it, uncompressed [bytes]: more than 8 bits as several levels."""
    camera = config.camera
    samples = camera.width * camera.height * (3 if camera.layout == "rgb8" else 1)
    return samples * len(level_exposures(camera.bits))


def move_s(config: RigConfig, microsteps: int) -> float:
    """Duration of a motion: ramp up, full speed if it is long enough, ramp down [s]."""
    settings = controller_settings(config)
    distance, v0, v, a = abs(microsteps), settings.start_speed, settings.speed, settings.acceleration
    ramps = (v * v - v0 * v0) / a
    if distance >= ramps:
        return 2 * (v - v0) / a + (distance - ramps) / v
    return 2 * (math.sqrt(v0 * v0 + a * distance) - v0) / a


def longest_s(config: RigConfig) -> float:
    """Timeout of any motion, homing included: twice the duration of the longest, plus 30 s [s]."""
    turns = max(2.0, config.turntable.home_within_deg / 360)
    return 2 * move_s(config, round(turns * config.microsteps_per_turn)) + 30


def shot_s(config: RigConfig) -> float:
    """Duration of a shot without motion, including the longest waits for the camera's ready line [s]."""
    s = controller_settings(config)
    exposures = 2 * (s.exposure_ms + s.gap_ms + s.ready_ms)
    return (s.settle_ms + s.laser_on_ms + s.laser_off_ms + exposures) / 1000


def estimate(config: RigConfig, positions: Sequence[int]) -> Estimate:
    """Frames, space and time for pairs at these positions, one after the other, from home."""
    frames = 2 * len(positions)
    moves = sum(move_s(config, to - at) for at, to in zip((0, *positions), positions, strict=False))
    ready = 2 * config.trigger.ready_ms / 1000  # A camera is usually ready.
    seconds = moves + len(positions) * (shot_s(config) - ready + _OVERHEAD_S)
    return Estimate(frames, math.ceil(frames * frame_bytes(config) * RESERVE), seconds)
