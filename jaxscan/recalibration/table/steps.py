"""Steps that a table lost: records from which on it stands elsewhere; found one after another, placed, and named.

With the right angles points lie on few planes. A large step breaks walls, and is proposed by the turn between the
normals before and behind a place; a small one bends them, and stands out of the errors of a least squares.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscan.geometry import Scanner, Turntable
from jaxscan.leastsq import MEDIAN_TO_SIGMA
from jaxscan.measurement.planes import Plane
from jaxscan.recalibration.observed import SweepStripes
from jaxscan.recalibration.result import TableFindings
from jaxscan.recalibration.table.walls import (
    FLOOR,
    FOLD,
    HALF,
    LINES,
    MOST_COST,
    PROFILES,
    SAME,
    Equations,
    Rig,
    Sample,
    fit_steps,
    flat_windows,
    fold,
    iterate_fit,
    label_points,
    robust_plane,
    take_records,
    take_sample,
    truncated_cost,
    wall_equations,
)


FULL_STEPS = {
    1.8: "one full step of a motor with 200 steps per turn on the axis",
    0.9: "one full step of a motor with 400 steps per turn on the axis",
    0.2: "one full step of a motor with 200 steps per turn behind a gear of 9",
    0.1125: "one full step of a motor with 200 steps per turn behind a gear of 16",
    0.1: "one full step of a motor with 200 steps per turn behind a gear of 18",
}
"""Usual full steps of a table [deg]."""
# Part of a full step by which a lost one may differ from it, beside its sigmas.
STEP_TOLERANCE, STEP_SIGMAS = 0.05, 2.5
# Distance of records up to which steps are sought [rad]: between farther ones furniture looks like a lost step.
COARSEST = np.deg2rad(1.75)
# Standard deviations of a sum of steps, of which each is many, up to which they undo each other.
UNDONE = 3.0


class LostStep(NamedTuple):
    """A step that was found."""

    record: int
    """The first record after it that is the most likely; `first` to `last` are possible."""
    first: int
    last: int
    size: float
    """About the axis [rad]."""
    sigma: float


def check_angles(sweeps: Sequence[SweepStripes], scanner: Scanner) -> TableFindings:
    """Finds steps that the table lost.

    Args:
        sweeps: Sweeps of a room.
        scanner: The stored scanner; a poor one will do.

    Returns:
        The steps, corrections of the angles that repair them, and a sentence for each. Without walls, and in sweeps
        whose records are more than 1.75 degrees apart, nothing is found.
    """
    jumps, sentences = [], []
    corrections = tuple(np.zeros(len(sweep.angle)) for sweep in sweeps)
    table = scanner.turntable
    for number, sweep in enumerate(sweeps):
        seen = np.unique(sweep.record)
        apart = np.abs(np.diff(sweep.angle[seen]))
        if not isinstance(table, Turntable) or not sweep.valid.any() or not len(apart) or np.median(apart) > COARSEST:
            continue
        rig = find_steps(sweep, Rig.start(scanner, np.asarray(table.angle(sweep.angle))))
        way = np.sign(float(table.gain)) * np.sign(sweep.angle[-1] - sweep.angle[0])
        for step in lasting(lost_steps(sweep, rig)):
            size = step.size / float(table.gain)
            jumps.append((number, step.record, size))
            corrections[number][step.record :] += size
            before = seen[seen < step.first]
            between = (int(before[-1]) if len(before) else 0, step.last)
            degrees = float(np.rad2deg(way * step.size)), float(np.rad2deg(step.sigma))
            sentences.append(say_jump(sweep.name, between, *degrees))
    return TableFindings(tuple(jumps), corrections, tuple(sentences))


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
"""A larger one breaks its wall plainly. If no break showed it, it must bring points onto walls to be accepted."""


def find_steps(sweep: SweepStripes, start: Rig) -> Rig:
    """The rig with the steps that its walls show, one after another: those that break walls, then the small ones."""
    rig = iterate_fit(sweep, start, 3)
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
        # With one step known, a break that was rejected before may be accepted.
        rig, vain = found, []
    return iterate_fit(sweep, _begin(start, rig.steps), LAST_TIMES, MANY_POINTS) if rig.steps else rig


def lost_steps(sweep: SweepStripes, rig: Rig) -> list[LostStep]:
    """The steps of a rig with their places and standard deviations."""
    if not rig.steps:
        return []
    sample = take_sample(sweep, rig.scanner, MOST_PROFILES, MANY_POINTS)
    walls = wall_equations(sample, label_points(sample, rig.theta), rig)
    sigmas = np.sqrt(np.diag(walls.covariance())[-len(rig.steps) :]) * inflation(walls, walls.error, len(rig.theta))
    places = [_place_step(sweep, rig, number)[1:] for number in range(len(rig.steps))]
    each = zip(rig.steps, places, sigmas, strict=True)
    return [LostStep(record, *place, size, float(sigma)) for (record, size), place, sigma in each]


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
    rows = wall_equations(sample, label_points(sample, rig.theta), rig, robust)
    test = fit_steps(rows, len(rig.theta))
    z = np.abs(test.size) / test.sigma / inflation(rows, test.left, len(rig.theta))
    place = int(np.argmax(z))
    return None if z[place] < LEAST_Z or abs(test.size[place]) < LEAST_STEP else (place, float(test.size[place]))


def _with_step(sweep: SweepStripes, start: Rig, rig: Rig, place: tuple[int, float]) -> Rig:
    """The rig with one more step, settled, at the record that its points tell."""
    steps = (*rig.steps, place)
    for times in PLACED:
        # With the step corrected, walls are whole across it, and give its size and then its record.
        more = iterate_fit(sweep, _begin(start, steps), times)
        record = _place_step(sweep, more, len(steps) - 1)[0]
        moved, steps = record != steps[-1][0], (*more.steps[:-1], (record, more.steps[-1][1]))
        if not moved:
            break
    theta = more.theta.copy()
    theta[more.steps[-1][0] :] -= more.steps[-1][1]
    theta[record:] += more.steps[-1][1]
    return more._replace(theta=theta, steps=steps)


def _best(sweep: SweepStripes, rig: Rig, tried: list[Rig]) -> Rig | None:
    """Of rigs with one more step the one that brings the most points to walls, if clearly more than without it."""
    if not tried:
        return None
    before, points = truncated_cost(sweep, rig)
    costs = [truncated_cost(sweep, one)[0] if abs(one.steps[-1][1]) < MOST_STEP else np.inf for one in tried]
    best = int(np.argmin(costs))
    return tried[best] if before - costs[best] > LEAST_GAIN * points else None


def inflation(rows: Equations, left: Float[np.ndarray, " rows"], records: int) -> float:
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
        score_of, known = (part[: whole * length].reshape(whole, length).sum(axis=1) for part in (score, power))
        angle = score_of / np.maximum(known, 1e-12)
        pairs = (known[1:] > 0) & (known[:-1] > 0)
        if np.count_nonzero(pairs) < 8:
            break
        difference = np.diff(angle)[pairs] / np.sqrt(1.0 / known[1:][pairs] + 1.0 / known[:-1][pairs])
        worst = max(worst, MEDIAN_TO_SIGMA * float(np.median(np.abs(difference))))
    return worst


LEAST_BREAK = np.deg2rad(0.35)
"""Smaller breaks are lost in the noise of normals, and found by their least squares."""
BREAK_TILT = np.deg2rad(1.5)
"""Difference of the tilts of the parts of a wall before and behind a break, at most."""
LEAST_LINES = 5
"""On which the wall is seen on both sides."""
APART, MOST_BREAKS = 6, 3
"""Cells between two breaks that are proposed, and how many are."""


def propose_steps(sweep: SweepStripes, rig: Rig) -> list[tuple[int, float]]:
    """Records at which walls break by a turn about the axis, and that turn [rad], the largest first.

    Normals before and behind a place are compared line by line, and their median is taken. The edge of a cupboard
    breaks a wall too: every proposal has to be tried.
    """
    sample = take_sample(sweep, rig.scanner, PROFILES, PROFILES * LINES)
    own = np.flatnonzero(sample.laser == sample.laser[0])
    records, row = np.unique(sample.record[own], return_inverse=True)
    if len(records) < 4 * HALF + 2:
        return []
    shape = (len(records), int(sample.column.max()) + 1)
    x, noise, valid = np.zeros((*shape, 3)), np.zeros((*shape, 3)), np.zeros(shape, bool)
    cells = row, sample.column[own]
    (x[cells], noise[cells]), valid[cells] = (field[own] for field in sample.turned(rig.theta)), True
    size = _breaks(x, noise, valid)
    found: list[tuple[int, float]] = []
    left = np.abs(size)
    while len(found) < MOST_BREAKS and left.max() > LEAST_BREAK:
        cell = int(np.argmax(left))
        found.append((int(records[cell]), float(size[cell])))
        left[max(cell - APART, 0) : cell + APART + 1] = 0.0
    return found


def _breaks(x: np.ndarray, noise: np.ndarray, valid: np.ndarray) -> Float[np.ndarray, " profiles"]:
    """The turn that makes one wall of its parts before each profile and from it on; 0 where there are none [rad]."""
    normal, flat = flat_windows(x, noise, valid)
    upright = np.hypot(normal[..., 0], normal[..., 1])
    distance, size = np.sum(normal * x, axis=-1), np.linalg.norm(x, axis=-1)
    # Windows end at the place, and begin at it.
    first, second = np.s_[: -2 * HALF - 1], np.s_[2 * HALF + 1 :]
    turned, tilt = fold(normal[first], normal[second])
    same = (
        flat[first]
        & flat[second]
        & (np.minimum(upright[first], upright[second]) > 0.5)
        & (np.abs(turned) < FOLD)
        & (np.abs(tilt) < BREAK_TILT)
        & (np.abs(distance[first] - distance[second]) < SAME * np.maximum(size[first], size[second]))
    )
    breaks = np.zeros(len(flat))
    for profile in np.flatnonzero(np.count_nonzero(same, axis=1) >= LEAST_LINES):
        breaks[profile + HALF + 1] = np.median(turned[profile][same[profile]])
    return breaks


NEIGHBOURS = 10
"""Records on each side of a step that was found in which it is sought once more."""
AROUND = np.deg2rad(20.0)
"""Turn on each side of a step in which the walls are fitted by which its record is told."""
LEAST_POINTS = 12
"""On a wall there."""
MANY_LINES = 120
WALL_PROFILES, WALL_POINTS = 720, 12_000
"""With which walls are found."""
UNSURE = 9.0
"""A record is possible whose squared errors in sigmas exceed those of the best by so much."""


def _place_step(sweep: SweepStripes, rig: Rig, number: int) -> tuple[int, int, int]:
    """The likeliest first record after a step whose size is roughly known, and from where to where it may be.

    The points of each record near it are compared with the walls about it, once as the table stood before the step and
    once as after. No derivative is used, and no wall is sought among the records in doubt.
    """
    record, size = rig.steps[number]
    # Other steps are left where they are.
    others = [other for k, (other, _) in enumerate(rig.steps) if k != number]
    low = max([1, record - NEIGHBOURS, *(other + 1 for other in others if other <= record)])
    high = min([len(rig.theta) - 1, record + NEIGHBOURS, *(other - 1 for other in others if other > record)])
    low, high = min(low, record), max(high, record)
    before, after = rig.theta.copy(), rig.theta.copy()
    before[record:] -= size
    after[:record] += size
    walls = _walls_near(sweep, rig, record, (low, high))
    near = take_records(sweep, rig.scanner, (low, high), MANY_LINES)
    if not walls or len(near.x) == 0:
        return record, record, record
    change = np.bincount(near.record - low, _costs(near, before, walls) - _costs(near, after, walls), high - low)
    # Of a step at `low`, low + 1 ... high: all records from there on stand as after it.
    cost = np.concatenate([[0.0], np.cumsum(change)])
    best = int(np.argmin(cost))
    possible = np.flatnonzero(cost < cost[best] + UNSURE)
    return low + best, low + int(possible[0]), low + int(possible[-1])


def _walls_near(sweep: SweepStripes, rig: Rig, record: int, doubt: tuple[int, int]) -> list[tuple[Plane, float]]:
    """Planes about a step, without the records in doubt, and how far points are from each beside noise [m]."""
    sample = take_sample(sweep, rig.scanner, WALL_PROFILES, WALL_POINTS)
    label = label_points(sample, rig.theta)
    x, _ = sample.turned(rig.theta)
    close = np.abs(rig.theta[sample.record] - rig.theta[record]) < AROUND
    sure = (sample.record < doubt[0]) | (sample.record >= doubt[1])
    walls = []
    for wall in np.unique(label[close & (label >= 0)]):
        on = (label == wall) & close
        # A wall that is seen in the records in doubt alone must do with them.
        mine = on & sure if np.count_nonzero(on & sure) >= LEAST_POINTS else on
        plane = robust_plane(x[mine]) if np.count_nonzero(mine) >= LEAST_POINTS else None
        if plane is not None:
            walls.append((plane, MEDIAN_TO_SIGMA * float(np.median(np.abs(x[mine] @ plane.normal - plane.distance)))))
    return walls


def _costs(
    sample: Sample, theta: Float[np.ndarray, " records"], walls: list[tuple[Plane, float]]
) -> Float[np.ndarray, " points"]:
    """Squared error of each point from the nearest wall in sigmas, at most MOST_COST."""
    x, noise = sample.turned(theta)
    least = np.full(len(x), MOST_COST)
    for plane, scatter in walls:
        sigma = np.hypot(noise @ plane.normal, FLOOR * np.linalg.norm(x, axis=1))
        error = (x @ plane.normal - plane.distance) / np.maximum(sigma, scatter)
        least = np.minimum(least, error**2)
    return least
