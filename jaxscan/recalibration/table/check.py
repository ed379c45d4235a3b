"""Whether the table stood where its journal says: from the walls of ordinary sweeps; in words."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jaxscan.geometry import Scanner, Turntable
from jaxscan.leastsq import MEDIAN_TO_SIGMA
from jaxscan.recalibration.observed import SweepStripes
from jaxscan.recalibration.result import Adjusted, TableFindings
from jaxscan.recalibration.table.steps import (
    LEAST_STEP,
    MOST_JUMPS,
    SURE,
    LostStep,
    find_factor,
    find_steps,
    lost_steps,
    standing_out,
)
from jaxscan.recalibration.table.walls import LOOSE, Equations, Rig, iterate_fit, truncated_cost


POWER, RATIO = 0.02, 5e-3
"""A factor is a power of two, or a ratio of small numbers, where it is so near to one [1]."""
FULL_STEPS = {
    1.8: "one full step of a motor with 200 steps per turn on the axis",
    0.9: "one full step of a motor with 400 steps per turn on the axis",
    0.2: "one full step of a motor with 200 steps per turn behind a gear of 9",
    0.1125: "one full step of a motor with 200 steps per turn behind a gear of 16",
    0.1: "one full step of a motor with 200 steps per turn behind a gear of 18",
}
"""Usual full steps of a table [deg]."""
STEP_TOLERANCE = 0.05
"""Part of a full step by which a lost one may differ from it, beside its sigmas."""
STEP_SIGMAS = 2.5


def usual_ratio(factor: float) -> tuple[int, int] | None:
    """The ratio of small numbers, or of usual numbers of steps, that is nearest to a factor; None if none is near."""
    powers = [(2**k, 1) for k in range(1, 7)] + [(1, 2**k) for k in range(1, 7)]
    gears = [(a, b) for a in range(1, 13) for b in range(1, 13) if np.gcd(a, b) == 1 and a != b]
    for pairs, tolerance in ((powers, POWER), (gears, RATIO)):
        nearest = min(pairs, key=lambda pair: abs(factor * pair[1] / pair[0] - 1.0))
        if abs(factor * nearest[1] / nearest[0] - 1.0) < tolerance:
            return nearest
    return None


def say_factor(name: str, factor: float) -> str:
    """The sentence for a wrong number of steps per turn."""
    pair = usual_ratio(factor)
    if pair is None:
        return (
            f"{name}: the table turned about {factor:.3f} times as far as its journal says, expected 1; look for a "
            "belt that slips or a wrong gear ratio, set the steps per turn, and capture again"
        )
    up, down = pair
    configured = 3200 if 3200 * down % up == 0 else 3200 * up
    true = configured * down // up
    return (
        f"{name}: the table turned {up / down:.3f} times as far as its journal says, expected 1; for instance {true} "
        f"microsteps per turn where the configuration says {configured}: set microsteps_per_turn of the table to "
        f"{down / up:g} times its value"
    )


def say_jump(name: str, records: tuple[int, int], degrees: float, sigma_deg: float) -> str:
    """The sentence for a lost step between two records; `degrees` is negative where the table lags behind."""
    way, size = ("behind" if degrees < 0 else "ahead"), abs(degrees)
    near = [step for step in FULL_STEPS if abs(size - step) < max(STEP_TOLERANCE * step, STEP_SIGMAS * sigma_deg)]
    likely = min(near, key=lambda step: abs(size - step), default=None)
    cause = ""
    if likely is not None:
        cause = f": {likely:g} degrees are {FULL_STEPS[likely]}, which was {'lost' if degrees < 0 else 'made twice'}"
    return (
        f"{name}: between records {records[0]} and {records[1]} the table comes to stand {size:.4g} +- {sigma_deg:.2g} "
        f"degrees {way}, expected none{cause}; look for an obstacle, a loose pulley, too little current or too "
        "fast a ramp"
    )


LEAST_FACTOR = 0.02
"""Departures of a factor from 1 below this are errors of the gain, which an adjustment finds by itself [1]."""


COARSEST = np.deg2rad(1.75)
"""Distance of records up to which faults are sought [rad]: between farther ones furniture looks like a lost step."""
ALIKE, FEW_STEPS, AS_GOOD = 0.3, 3, 0.2
"""Factors so near to 1 [1] are compared with so few lost steps, by the truncated cost of a point [1]."""
BESIDE = 0.22
"""A factor so near to a power of two is compared with that [1]."""

UNDONE = 3.0
"""Standard deviations of a sum of steps, of which each is many, up to which they undo each other."""


def check_angles(
    sweeps: Sequence[SweepStripes],
    scanner: Scanner,
) -> TableFindings:
    """Finds a wrong number of steps per turn, and steps that the table lost.

    Args:
        sweeps: Sweeps of a room.
        scanner: The stored scanner; a poor one will do.

    Returns:
        Faults, corrections of the angles that repair them, and a sentence for each. Without walls, and in sweeps whose
        records are more than 1.75 degrees apart, nothing is found.
    """
    factor, jumps, sentences, corrections = 1.0, [], [], []
    for number, sweep in enumerate(sweeps):
        correction = np.zeros(len(sweep.angle))
        corrections.append(correction)
        table = scanner.turntable
        if not isinstance(table, Turntable) or table.carries != "scanner" or not sweep.valid.any():
            continue
        apart = np.abs(np.diff(sweep.angle[np.unique(sweep.record)]))
        if len(apart) == 0 or np.median(apart) > COARSEST:
            continue
        found, steps = _faults(sweep, scanner, table)
        if found != 1.0:
            factor = found
            sentences.append(say_factor(sweep.name, found))
        correction += (found - 1.0) * sweep.angle
        way = np.sign(float(table.gain)) * np.sign(sweep.angle[-1] - sweep.angle[0])
        seen = np.unique(sweep.record)
        for record, first, last, size, sigma in lasting(steps):
            jumps.append((number, record, size / float(table.gain)))
            correction[record:] += size / float(table.gain)
            before = seen[seen < first]
            between = (int(before[-1]) if len(before) else 0, last)
            size_deg, sigma_deg = float(np.rad2deg(way * size)), float(np.rad2deg(sigma))
            sentences.append(say_jump(sweep.name, between, size_deg, sigma_deg))
    return TableFindings(factor, tuple(jumps), tuple(corrections), tuple(sentences))


def lasting(steps: Sequence[LostStep]) -> list[LostStep]:
    """Steps in their order, without neighbours that undo each other.

    A part of a wall that stands out looks as if the table turned there and back; steps that a table loses stay lost.
    """
    left = sorted(steps)
    for count in range(2, len(left) + 1):
        for begin in range(len(left) - count + 1):
            some = left[begin : begin + count]
            if abs(sum(step.size for step in some)) < UNDONE * np.sqrt(sum(step.sigma**2 for step in some)):
                return lasting([*left[:begin], *left[begin + count :]])
    return left


def _faults(sweep: SweepStripes, scanner: Scanner, table: Turntable) -> tuple[float, list[LostStep]]:
    """Factor of the journal's angles, and steps about the axis."""
    own = np.asarray(table.angle(sweep.angle))
    factor = find_factor(sweep, Rig.start(scanner, own))
    if abs(factor - 1.0) >= ALIKE:
        factor = _usual(sweep, scanner, table, factor)
        rig = find_steps(sweep, _settled(sweep, scanner, table, factor))
    else:
        factor, rig = _steps_or_factor(sweep, scanner, table, factor)
    steps = lost_steps(sweep, rig)
    if factor == 1.0:
        # No other factor makes walls flatter, and the stored gain is known better than a free one of a few walls.
        return 1.0, steps
    precise = _free_factor(sweep, rig, own)
    if abs(precise - 1.0) < LEAST_FACTOR:
        return 1.0, steps
    pair = usual_ratio(precise)
    return (precise if pair is None else pair[0] / pair[1]), steps


def _usual(sweep: SweepStripes, scanner: Scanner, table: Turntable, factor: float) -> float:
    """A factor, or the power of two beside it where that explains the walls as well: a bent rig imitates the rest."""
    power = 2.0 ** round(float(np.log2(factor)))
    if abs(factor / power - 1.0) > BESIDE:
        return factor
    found, usual = (truncated_cost(sweep, _settled(sweep, scanner, table, one)) for one in (factor, power))
    return power if usual[0] < found[0] + AS_GOOD * found[1] else factor


def _steps_or_factor(sweep: SweepStripes, scanner: Scanner, table: Turntable, factor: float) -> tuple[float, Rig]:
    """A factor near to 1, or none and lost steps: a step bends its wall as such a factor does."""
    start = _settled(sweep, scanner, table, 1.0)
    plain = find_steps(sweep, start)
    few = len(plain.steps) <= FEW_STEPS
    if factor == 1.0 or (few and abs(_free_factor(sweep, plain, start.theta) - 1.0) < SURE[0]):
        return 1.0, plain
    rig = find_steps(sweep, _settled(sweep, scanner, table, factor))
    # The simpler explanation is taken where it is as good.
    (cost, points), (other, _) = truncated_cost(sweep, rig), truncated_cost(sweep, plain)
    if plain.steps and few and other < cost + AS_GOOD * points:
        return 1.0, plain
    return factor, rig


def _free_factor(sweep: SweepStripes, rig: Rig, own: Float[np.ndarray, " records"]) -> float:
    """The factor of the angles `own` with the steps of the rig known, and the gain free."""
    free = iterate_fit(sweep, rig, 3, LOOSE)
    stepless = free.theta.copy()
    for record, size in free.steps:
        stepless[record:] -= size
    return float(own @ stepless / (own @ own)) if own.any() else 1.0


def _settled(sweep: SweepStripes, scanner: Scanner, table: Turntable, factor: float) -> Rig:
    if factor == 1.0:
        return Rig.start(scanner, np.asarray(table.angle(sweep.angle)))
    rough = iterate_fit(sweep, Rig.start(scanner, np.asarray(table.angle(factor * sweep.angle))), 4, LOOSE)
    # From here on the gain stays near to the one found.
    return rough._replace(table=np.zeros_like(rough.table))


WAVES = 3
"""Errors that repeat up to so many times per turn are no lost steps."""
LEAST_RECORDS = 24


def say_lost_steps(adjusted: Adjusted, names: Sequence[str]) -> list[str]:
    """Sentences for the jumps in the corrections of an adjustment with one angle per step.

    Args:
        adjusted: Its corrections follow the sweeps of its observations.
        names: Names of the sweeps.
    """
    each = zip(names, adjusted.observations.angles, adjusted.corrections, adjusted.correction_sigma, strict=True)
    return [
        say_jump(name, (record - 1, record), float(np.rad2deg(size)), float(np.rad2deg(sigma[record])))
        for name, angle, correction, sigma in each
        for record, size in sorted(jumps_in(angle, correction, sigma))
    ]


def jumps_in(
    angle: Float[np.ndarray, " records"],
    correction: Float[np.ndarray, " records"],
    sigma: Float[np.ndarray, " records"],
) -> list[tuple[int, float]]:
    """Record and angle [rad] of each jump in the corrections of one sweep.

    Their stated sigmas hold the errors that all records share, and a step does not see those: the scatter between
    neighbours, which one step does not change, sets the scale.
    """
    count = len(correction)
    if count < LEAST_RECORDS or not np.any(sigma > 0):
        return []
    # Neighbours scatter by this, with the median so that steps do not count.
    scatter = MEDIAN_TO_SIGMA * float(np.median(np.abs(np.diff(correction)))) / np.sqrt(2.0)
    scale = np.full(count, max(scatter, 1e-3 * LEAST_STEP))
    waves = [wave(h * angle) for h in range(1, WAVES + 1) for wave in (np.sin, np.cos)]
    nuisance = [np.ones(count), angle, *waves]
    found: list[int] = []
    # Steps that are known stay free in size.
    columns_of = lambda: np.stack([*nuisance, *(1.0 * (np.arange(count) >= record) for record in found)], axis=-1)
    while len(found) < MOST_JUMPS:
        columns = columns_of()
        free = np.zeros(columns.shape[1]), np.ones(columns.shape[1])
        rows = Equations(correction / scale, 1.0 / scale, columns / scale[:, None], np.arange(count), *free)
        step = standing_out(rows, count)
        if step is None:
            break
        found.append(step[0])
    sizes = np.linalg.lstsq(columns_of(), correction)[0][len(nuisance) :]
    return [(record, float(size)) for record, size in zip(found, sizes, strict=True)]
