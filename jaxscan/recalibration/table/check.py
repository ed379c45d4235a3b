"""Whether the table stood where its journal says: from the walls of ordinary sweeps."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jaxscan.geometry import Scanner, Turntable
from jaxscan.recalibration.observed import SweepStripes, Tracks
from jaxscan.recalibration.result import TableFindings
from jaxscan.recalibration.settings import RecalibrationSettings
from jaxscan.recalibration.table.factor import find_factor
from jaxscan.recalibration.table.jumps import find_steps, step_sigmas
from jaxscan.recalibration.table.names import say_factor, say_jump, usual_ratio
from jaxscan.recalibration.table.walls import LOOSE, Rig, settle, start_rig, truncated_cost


LEAST_FACTOR = 0.02
"""Departures of a factor from 1 below this are errors of the gain, which an adjustment finds by itself [1]."""


ALIKE, FEW_STEPS, AS_GOOD = 0.1, 3, 0.2
"""Factors so near to 1 [1] are compared with so few lost steps, by the truncated cost of a point [1]."""


def check_angles(
    sweeps: Sequence[SweepStripes],
    scanner: Scanner,
    settings: RecalibrationSettings,
    tracks: Tracks | None = None,
) -> TableFindings:
    """Finds a wrong number of steps per turn, and steps that the table lost.

    Args:
        sweeps: Sweeps of a room.
        scanner: The stored scanner; a poor one will do.
        settings: How the scanner is recalibrated.
        tracks: Features seen in several images; not used yet: walls alone decide.

    Returns:
        Faults, corrections of the angles that repair them, and a sentence for each. Without walls nothing is found.
    """
    del settings, tracks
    factor, jumps, sentences, corrections = 1.0, [], [], []
    for number, sweep in enumerate(sweeps):
        correction = np.zeros(len(sweep.angle))
        corrections.append(correction)
        table = scanner.turntable
        if not isinstance(table, Turntable) or table.carries != "scanner" or not sweep.valid.any():
            continue
        found, steps = _faults(sweep, scanner, table)
        if found != 1.0:
            factor = found
            sentences.append(say_factor(sweep.name, found))
        correction += (found - 1.0) * sweep.angle
        way = np.sign(float(table.gain)) * np.sign(sweep.angle[-1] - sweep.angle[0])
        seen = np.unique(sweep.record)
        for record, size, sigma in sorted(steps):
            jumps.append((number, record, size / float(table.gain)))
            correction[record:] += size / float(table.gain)
            before = seen[seen < record]
            between = (int(before[-1]) if len(before) else 0, record)
            size_deg, sigma_deg = float(np.rad2deg(way * size)), float(np.rad2deg(sigma))
            sentences.append(say_jump(sweep.name, between, size_deg, sigma_deg))
    return TableFindings(factor, tuple(jumps), tuple(corrections), tuple(sentences))


def _faults(sweep: SweepStripes, scanner: Scanner, table: Turntable) -> tuple[float, list[tuple[int, float, float]]]:
    """Factor of the journal's angles, and steps about the axis: first record, angle and its sigma [rad]."""
    own = table_angles(table, sweep.angle)
    factor = find_factor(sweep, start_rig(scanner, own))
    rig = find_steps(sweep, _settled(sweep, scanner, table, factor))
    if 0.0 < abs(factor - 1.0) < ALIKE:
        # A step bends its wall as a factor near to 1 does: the simpler explanation is taken where it is as good.
        plain = find_steps(sweep, _settled(sweep, scanner, table, 1.0))
        (cost, points), (other, _) = truncated_cost(sweep, rig), truncated_cost(sweep, plain)
        if 0 < len(plain.steps) <= FEW_STEPS and other < cost + AS_GOOD * points:
            rig, factor = plain, 1.0
    sigmas = step_sigmas(sweep, rig)
    steps = [(record, size, float(sigma)) for (record, size), sigma in zip(rig.steps, sigmas, strict=True)]
    if factor == 1.0:
        # No other factor makes walls flatter, and the stored gain is known better than a free one of a few walls.
        return 1.0, steps
    # With the steps known, and the gain free, once more.
    free = settle(sweep, rig, 3, LOOSE)
    stepless = free.theta.copy()
    for record, size in free.steps:
        stepless[record:] -= size
    precise = float(own @ stepless / (own @ own)) if own.any() else 1.0
    if abs(precise - 1.0) < LEAST_FACTOR:
        return 1.0, steps
    pair = usual_ratio(precise)
    return (precise if pair is None else pair[0] / pair[1]), steps


def _settled(sweep: SweepStripes, scanner: Scanner, table: Turntable, factor: float) -> Rig:
    if factor == 1.0:
        return start_rig(scanner, table_angles(table, sweep.angle))
    rough = settle(sweep, start_rig(scanner, table_angles(table, factor * sweep.angle)), 4, LOOSE)
    # From here on the gain stays near to the one found.
    return rough._replace(table=np.zeros_like(rough.table))


def table_angles(table: Turntable, phi: Float[np.ndarray, " records"]) -> Float[np.ndarray, " records"]:
    """Angles about the axis at the table's angles `phi` [rad]."""
    c1, s1, c2, s2 = np.asarray(table.harmonics, np.float64)
    first = c1 * (np.cos(phi) - 1.0) + s1 * np.sin(phi)
    second = c2 * (np.cos(2.0 * phi) - 1.0) + s2 * np.sin(2.0 * phi)
    return float(table.gain) * phi + first + second
