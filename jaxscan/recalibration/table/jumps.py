"""Lost steps: records from which on the table stands elsewhere than its journal says."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscan.leastsq import MEDIAN_TO_SIGMA
from jaxscan.recalibration.observed import SweepStripes
from jaxscan.recalibration.table.patches import FOLD, HALF, SAME, Grid, Plane, fit, normals
from jaxscan.recalibration.table.walls import (
    FLOOR,
    LINES,
    MOST_COST,
    PROFILES,
    TIGHT,
    Rig,
    Rows,
    Sample,
    Walls,
    fit_steps,
    label_points,
    settle,
    take_records,
    take_sample,
    truncated_cost,
    turn,
    wall_equations,
)


LEAST_BREAK = np.deg2rad(0.35)
"""Smaller breaks are lost in the noise of normals, and found by their least squares."""
MOST_TILT = np.deg2rad(1.5)
"""Difference of the tilts of two parts of one wall."""
LEAST_LINES = 5
"""On which the wall is seen on both sides."""
APART = 6
"""Cells between two breaks that are proposed."""
MOST_BREAKS = 3


def propose_steps(sweep: SweepStripes, rig: Rig) -> list[tuple[int, float]]:
    """Records at which walls break by a turn about the axis, and that turn [rad], the largest first.

    Normals before and behind a place are compared line by line, and their median is taken. The edge of a cupboard
    breaks a wall too: every proposal has to be tried.
    """
    sample = take_sample(sweep, rig.scanner, PROFILES, PROFILES * LINES)
    one = sample.stripes.laser == sample.stripes.laser[0]
    index = np.flatnonzero(one)
    records, row = np.unique(sample.record[index], return_inverse=True)
    if len(records) < 4 * HALF + 2:
        return []
    angle = rig.theta[sample.record[index]]
    shape = (len(records), int(sample.column.max()) + 1)
    grid = Grid(np.zeros((*shape, 3)), np.zeros((*shape, 3)), np.zeros(shape, bool))
    cells = row, sample.column[index]
    grid.x[cells], grid.noise[cells] = turn(angle, sample.x[index]), turn(angle, sample.noise[index])
    grid.valid[cells] = True
    size = _breaks(grid)
    found: list[tuple[int, float]] = []
    left = np.abs(size)
    while len(found) < MOST_BREAKS and left.max() > LEAST_BREAK:
        cell = int(np.argmax(left))
        found.append((int(records[cell]), float(size[cell])))
        left[max(cell - APART, 0) : cell + APART + 1] = 0.0
    return found


def _breaks(grid: Grid) -> Float[np.ndarray, " profiles"]:
    """The turn that makes one wall of its parts before each profile and from it on; 0 where there are none [rad]."""
    normal, flat = normals(grid)
    upright = np.hypot(normal[..., 0], normal[..., 1])
    azimuth, tilt = np.arctan2(normal[..., 1], normal[..., 0]), np.arcsin(np.clip(normal[..., 2], -1, 1))
    distance = np.sum(normal * grid.x, axis=-1)
    size = np.linalg.norm(grid.x, axis=-1)
    # Windows end at the place, and begin at it.
    first, second = np.s_[: -2 * HALF - 1], np.s_[2 * HALF + 1 :]
    turned = (azimuth[first] - azimuth[second] + np.pi) % (2 * np.pi) - np.pi
    same = (
        flat[first]
        & flat[second]
        & (np.minimum(upright[first], upright[second]) > 0.5)
        & (np.abs(turned) < FOLD)
        & (np.abs(tilt[first] - tilt[second]) < MOST_TILT)
        & (np.abs(distance[first] - distance[second]) < SAME * np.maximum(size[first], size[second]))
    )
    enough = np.count_nonzero(same, axis=1) >= LEAST_LINES
    breaks = np.zeros(len(flat))
    with np.errstate(invalid="ignore"):
        middle = np.nanmedian(np.where(same, turned, np.nan)[enough], axis=1)
    breaks[HALF + 1 : HALF + 1 + len(enough)][enough] = middle
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


class Place(NamedTuple):
    """Where a step lies."""

    record: int
    """The first record after it that is the most likely."""
    first: int
    """The first records that are possible, ..."""
    last: int
    """... up to this."""


def place_step(sweep: SweepStripes, rig: Rig, number: int) -> Place:
    """The record of a step whose size is roughly known.

    The points of each record near it are compared with the walls about it, once as the table stood before the step and
    once as after. No derivative is used, and no wall is sought among the records in doubt.

    Args:
        sweep: The sweep.
        rig: Its step lies within NEIGHBOURS records of the true one.
        number: Of the step in the rig.
    """
    record, size = rig.steps[number]
    low, high = _limits(rig, number)
    before, after = rig.theta.copy(), rig.theta.copy()
    before[record:] -= size
    after[:record] += size
    walls = _walls_near(sweep, rig, record, (low, high))
    near = take_records(sweep, rig.scanner, (low, high), MANY_LINES)
    if not walls or len(near.x) == 0:
        return Place(record, record, record)
    count = high - low
    change = np.bincount(near.record - low, _costs(near, before, walls) - _costs(near, after, walls), count)
    # Of a step at `low`, low + 1 ... high: all records from there on stand as after it.
    cost = np.concatenate([[0.0], np.cumsum(change)])
    best = int(np.argmin(cost))
    possible = np.flatnonzero(cost < cost[best] + UNSURE)
    return Place(low + best, low + int(possible[0]), low + int(possible[-1]))


def _limits(rig: Rig, number: int) -> tuple[int, int]:
    """Records between which a step is sought: other steps are left where they are."""
    record = rig.steps[number][0]
    others = [other for k, (other, _) in enumerate(rig.steps) if k != number]
    low = max([1, record - NEIGHBOURS, *(other + 1 for other in others if other <= record)])
    high = min([len(rig.theta) - 1, record + NEIGHBOURS, *(other - 1 for other in others if other > record)])
    return min(low, record), max(high, record)


def _walls_near(sweep: SweepStripes, rig: Rig, record: int, doubt: tuple[int, int]) -> list[tuple[Plane, float]]:
    """Planes about a step, without the records in doubt, and how far points are from each beside noise [m]."""
    sample = take_sample(sweep, rig.scanner, WALL_PROFILES, WALL_POINTS)
    label = label_points(sample, rig.theta)
    angle = rig.theta[sample.record]
    x = turn(angle, sample.x)
    close = np.abs(angle - rig.theta[record]) < AROUND
    sure = (sample.record < doubt[0]) | (sample.record >= doubt[1])
    walls = []
    for wall in np.unique(label[close & (label >= 0)]):
        on = (label == wall) & close
        # A wall that is seen in the records in doubt alone must do with them.
        mine = on & sure if np.count_nonzero(on & sure) >= LEAST_POINTS else on
        plane = fit(x[mine]) if np.count_nonzero(mine) >= LEAST_POINTS else None
        if plane is not None:
            walls.append((plane, MEDIAN_TO_SIGMA * float(np.median(np.abs(x[mine] @ plane.normal - plane.distance)))))
    return walls


def _costs(
    sample: Sample, theta: Float[np.ndarray, " records"], walls: list[tuple[Plane, float]]
) -> Float[np.ndarray, " points"]:
    """Squared error of each point from the nearest wall in sigmas, at most MOST_COST."""
    angle = theta[sample.record]
    x, noise = turn(angle, sample.x), turn(angle, sample.noise)
    least = np.full(len(x), MOST_COST)
    for plane, scatter in walls:
        sigma = np.hypot(noise @ plane.normal, FLOOR * np.linalg.norm(x, axis=1))
        error = (x @ plane.normal - plane.distance) / np.maximum(sigma, scatter)
        least = np.minimum(least, error**2)
    return least


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
