"""Lost steps: records from which on the table stands elsewhere than its journal says."""

import numpy as np
from jaxtyping import Float

from jaxscan.leastsq import MEDIAN_TO_SIGMA
from jaxscan.recalibration.observed import SweepStripes
from jaxscan.recalibration.table.breaks import propose_steps
from jaxscan.recalibration.table.place import NEIGHBOURS, place_step
from jaxscan.recalibration.table.regression import Rows, fit_steps
from jaxscan.recalibration.table.walls import (
    TIGHT,
    Rig,
    Walls,
    label_points,
    settle,
    take_sample,
    truncated_cost,
    wall_equations,
)


MOST_JUMPS = 12
MOST_PROFILES, MOST_POINTS = 8_000, 60_000
"""In which a step is looked for."""
LAST_TIMES, MANY_POINTS = 4, 24_000
"""With which the sizes of all steps are found in the end."""
LEAST_Z = 7.0
"""How many of its sigmas a step must have, with some thousand places where chance could make one."""
PLACED = (4, 3, 3)
"""Steps of least squares before the record of a step is sought once more, until it stays."""
LEAST_GAIN = 0.3
"""By how much a large step lowers the truncated cost, for each point [1]."""
LEAST_STEP = np.deg2rad(0.02)
"""Smaller steps are no full step of any usual table."""
MOST_STEP = np.deg2rad(10.0)
"""Larger ones are no lost steps."""
PLAIN_BREAK = np.deg2rad(1.0)
"""A larger one breaks its wall plainly: where no break showed it, it must bring points to walls to be believed."""


def find_steps(sweep: SweepStripes, start: Rig) -> Rig:
    """The rig with the steps that its walls show, one after another: those that break walls, then the small ones."""
    rig = settle(sweep, start, 3, TIGHT)
    vain: list[int] = []
    while len(rig.steps) < MOST_JUMPS:
        # A large step divides walls, and no linear equation tells its size: breaks are tried one by one.
        known = [*vain, *(record for record, _ in rig.steps)]
        breaks = [place for place in propose_steps(sweep, rig) if _is_far(place[0], known)]
        found = _best(sweep, rig, [_with_step(sweep, start, rig, place) for place in breaks])
        if found is None:
            vain += [record for record, _ in breaks]
            small = _stands_out(sweep, rig, robust=True)
            found = None if small is None else _with_step(sweep, start, rig, small)
            if found is not None and abs(found.steps[-1][1]) > PLAIN_BREAK:
                found = _best(sweep, rig, [found])
        if found is None:
            large = _stands_out(sweep, rig, robust=False)
            found = None if large is None else _best(sweep, rig, [_with_step(sweep, start, rig, large)])
        if found is None:
            break
        # With one step known, a break that was tried in vain may be believed.
        rig, vain = found, []
    return settle(sweep, _begin(start, rig.steps), LAST_TIMES, TIGHT, MANY_POINTS) if rig.steps else rig


def step_sigmas(sweep: SweepStripes, rig: Rig) -> Float[np.ndarray, " steps"]:
    """Standard deviation of each step of the rig [rad]."""
    if not rig.steps:
        return np.zeros(0)
    sample = take_sample(sweep, rig.scanner, MOST_PROFILES, MANY_POINTS)
    walls = wall_equations(sample, label_points(sample, rig.theta), rig, TIGHT)
    n = walls.rows.nuisance
    covariance = np.linalg.inv(n.T @ n + np.diag(1.0 / walls.prior.sigma**2))
    widened = inflation(walls.rows, walls.rows.error, len(rig.theta))
    return widened * np.sqrt(np.diag(covariance)[-len(rig.steps) :])


def _begin(start: Rig, steps: tuple[tuple[int, float], ...]) -> Rig:
    """The first rig with steps: numbers that took over a part of a step before it was known are forgotten."""
    theta = start.theta.copy()
    for record, size in steps:
        theta[record:] += size
    return start._replace(theta=theta, steps=steps)


def _is_far(record: int, others: list[int]) -> bool:
    return all(abs(record - other) > NEIGHBOURS for other in others)


def _stands_out(sweep: SweepStripes, rig: Rig, robust: bool) -> tuple[int, float] | None:
    """The record and size of the step that most stands out of the errors; None where none does."""
    sample = take_sample(sweep, rig.scanner, MOST_PROFILES, MOST_POINTS)
    z, size = _tested(wall_equations(sample, label_points(sample, rig.theta), rig, TIGHT, robust), len(rig.theta))
    place = int(np.argmax(z))
    return None if z[place] < LEAST_Z or abs(size[place]) < LEAST_STEP else (place, float(size[place]))


def _with_step(sweep: SweepStripes, start: Rig, rig: Rig, place: tuple[int, float]) -> Rig:
    """The rig with one more step, settled, at the record that its points tell."""
    steps = (*rig.steps, place)
    for times in PLACED:
        # With the step mended, walls are whole across it, and tell its size and then its record.
        more = settle(sweep, _begin(start, steps), times, TIGHT)
        record = place_step(sweep, more, len(steps) - 1).record
        moved, steps = record != steps[-1][0], (*more.steps[:-1], (record, more.steps[-1][1]))
        if not moved:
            break
    theta = more.theta.copy()
    theta[more.steps[-1][0] :] -= more.steps[-1][1]
    theta[record:] += more.steps[-1][1]
    return more._replace(theta=theta, steps=steps)


def _tested(walls: Walls, records: int) -> tuple[Float[np.ndarray, " records"], Float[np.ndarray, " records"]]:
    """Sigmas of a step at each record, and its size [rad]."""
    test, left = fit_steps(walls.rows, records, walls.prior)
    return np.abs(test.size) / test.sigma / inflation(walls.rows, left, records), test.size


def _best(sweep: SweepStripes, rig: Rig, tried: list[Rig]) -> Rig | None:
    """Of rigs with one more step the one that brings the most points to walls, if clearly more than without it."""
    if not tried:
        return None
    before, points = truncated_cost(sweep, rig)
    costs = [truncated_cost(sweep, one)[0] if abs(one.steps[-1][1]) < MOST_STEP else np.inf for one in tried]
    best = int(np.argmin(costs))
    return tried[best] if before - costs[best] > LEAST_GAIN * points else None


def inflation(rows: Rows, left: Float[np.ndarray, " rows"], records: int) -> float:
    """Factor by which sums of errors over neighbouring records scatter more than independent noise would [1].

    The scatter is that between stretches of records one after another, for several lengths of them, by the median: a
    step, or the edge of a cupboard, is in few of them.
    """
    score = np.bincount(rows.record, rows.turn * left, records)
    power = np.bincount(rows.record, rows.turn**2, records)
    worst = 1.0
    for length in (1, 2, 4, 8, 16, 32):
        whole = records // length
        if whole < 16:
            break
        angle = _blocks(score, length, whole) / np.maximum(_blocks(power, length, whole), 1e-12)
        known = _blocks(power, length, whole)
        pairs = (known[1:] > 0) & (known[:-1] > 0)
        if np.count_nonzero(pairs) < 8:
            break
        difference = np.diff(angle)[pairs] / np.sqrt(1.0 / known[1:][pairs] + 1.0 / known[:-1][pairs])
        worst = max(worst, MEDIAN_TO_SIGMA * float(np.median(np.abs(difference))))
    return worst


def _blocks(values: np.ndarray, length: int, whole: int) -> np.ndarray:
    return values[: whole * length].reshape(whole, length).sum(axis=1)
