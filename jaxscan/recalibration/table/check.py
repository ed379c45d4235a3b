"""Whether the table stood where its journal says: from the walls of ordinary sweeps."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jaxscan.geometry import Scanner, Turntable
from jaxscan.recalibration.observed import SweepStripes
from jaxscan.recalibration.result import TableFindings
from jaxscan.recalibration.table.factor import SURE, find_factor
from jaxscan.recalibration.table.jumps import find_steps, step_sigmas
from jaxscan.recalibration.table.names import say_factor, say_jump, usual_ratio
from jaxscan.recalibration.table.place import Place, place_step
from jaxscan.recalibration.table.walls import LOOSE, Rig, settle, start_rig, truncated_cost


LEAST_FACTOR = 0.02
"""Departures of a factor from 1 below this are errors of the gain, which an adjustment finds by itself [1]."""


COARSEST = np.deg2rad(1.75)
"""Distance of records up to which faults are sought [rad]: between farther ones furniture looks like a lost step."""
ALIKE, FEW_STEPS, AS_GOOD = 0.3, 3, 0.2
"""Factors so near to 1 [1] are compared with so few lost steps, by the truncated cost of a point [1]."""


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
        for (record, first, last), size, sigma in sorted(steps):
            jumps.append((number, record, size / float(table.gain)))
            correction[record:] += size / float(table.gain)
            before = seen[seen < first]
            between = (int(before[-1]) if len(before) else 0, last)
            size_deg, sigma_deg = float(np.rad2deg(way * size)), float(np.rad2deg(sigma))
            sentences.append(say_jump(sweep.name, between, size_deg, sigma_deg))
    return TableFindings(factor, tuple(jumps), tuple(corrections), tuple(sentences))


def _faults(sweep: SweepStripes, scanner: Scanner, table: Turntable) -> tuple[float, list[tuple[Place, float, float]]]:
    """Factor of the journal's angles, and steps about the axis: their place, angle and its sigma [rad]."""
    own = np.asarray(table.angle(sweep.angle))
    factor = find_factor(sweep, start_rig(scanner, own))
    if abs(factor - 1.0) >= ALIKE:
        rig = find_steps(sweep, _settled(sweep, scanner, table, factor))
    else:
        factor, rig = _steps_or_factor(sweep, scanner, table, factor)
    sigmas = step_sigmas(sweep, rig)
    places = [place_step(sweep, rig, number) for number in range(len(rig.steps))]
    places = [place._replace(record=record) for place, (record, _) in zip(places, rig.steps, strict=True)]
    steps = [(place, size, float(sigma)) for place, (_, size), sigma in zip(places, rig.steps, sigmas, strict=True)]
    if factor == 1.0:
        # No other factor makes walls flatter, and the stored gain is known better than a free one of a few walls.
        return 1.0, steps
    precise = _free_factor(sweep, rig, own)
    if abs(precise - 1.0) < LEAST_FACTOR:
        return 1.0, steps
    pair = usual_ratio(precise)
    return (precise if pair is None else pair[0] / pair[1]), steps


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
    free = settle(sweep, rig, 3, LOOSE)
    stepless = free.theta.copy()
    for record, size in free.steps:
        stepless[record:] -= size
    return float(own @ stepless / (own @ own)) if own.any() else 1.0


def _settled(sweep: SweepStripes, scanner: Scanner, table: Turntable, factor: float) -> Rig:
    if factor == 1.0:
        return start_rig(scanner, np.asarray(table.angle(sweep.angle)))
    rough = settle(sweep, start_rig(scanner, np.asarray(table.angle(factor * sweep.angle))), 4, LOOSE)
    # From here on the gain stays near to the one found.
    return rough._replace(table=np.zeros_like(rough.table))
