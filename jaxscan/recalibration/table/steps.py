"""A wrong number of steps per turn, and lost steps: records from which on the table stands elsewhere.

With the right number of steps per turn, points lie on few planes.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscan.leastsq import MEDIAN_TO_SIGMA
from jaxscan.measurement.planes import Plane, weighted_plane
from jaxscan.recalibration.observed import SweepStripes
from jaxscan.recalibration.table.walls import (
    FLOOR,
    FOLD,
    HALF,
    LINES,
    MOST_COST,
    PROFILES,
    SAME,
    TIGHT,
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


SEEDS, SPAN, REACH, LEAST_REACH = 48, np.deg2rad(8.0), 3, 2
"""Places from which planes are proposed; the turn over which one is fitted; profiles on each side of the middle, and
fewer where steps are coarse."""
EVALUATED = 160
"""Profiles on which proposed planes are tried."""
CLOSE = 0.01
"""Part of the range within which a point is on a plane, beside noise."""
PLANES = 8
LEAST_SHARE = 0.02
LEAST_TURN = np.deg2rad(40.0)
"""A shorter sweep does not tell a factor from a bend of the walls."""
BETTER = 1.4
"""How much more concentrated points must be than with the journal's angles [1]."""
LEAST_SCORE = 0.06
"""Concentration of points on four planes that hold half of them [1]."""
NEAR = 1.2
"""Ratio of two first values that least squares would bring to one place."""
SURE = (0.01, 0.15)
"""Nothing else is tried where least squares stays so near to a factor of 1, and so concentrates points [1, 1]."""
STARTS, TIMES = 3, 6
"""First values that are refined, and steps of least squares for each."""
FARTHEST = 64.0


def candidates() -> Float[np.ndarray, " factors"]:
    """Ratios of usual numbers of steps per turn, of gears, and a fine scale between 1/4 and 4."""
    powers = 2.0 ** np.arange(-6, 7)
    gears = np.array([a / b for a in range(1, 6) for b in range(1, 6)])
    fine = np.exp(np.arange(-np.log(4.0), np.log(4.0), 0.06))
    both = np.unique(np.round(np.concatenate([powers, 0.9 * powers, gears, fine]), 9))
    return both[(both <= FARTHEST) & (both >= 1.0 / FARTHEST)]


def concentration(sample: Sample, theta: Float[np.ndarray, " records"]) -> float:
    """Sum of the squared shares that planes have of all points, each point on one plane [1]."""
    if len(sample.x) == 0:
        return 0.0
    x, noise = sample.turned(theta)
    profiles, place = np.unique(sample.profile, return_inverse=True)
    angle = np.zeros(len(profiles))
    angle[place] = theta[sample.record]
    planes = _propose(x, place, angle)
    if not planes:
        return 0.0
    normal, distance = np.stack([plane.normal for plane in planes]), np.array([plane.distance for plane in planes])
    tried = np.isin(place, np.linspace(0, len(profiles) - 1, min(EVALUATED, len(profiles))).round().astype(int))
    x, noise = x[tried], noise[tried]
    size = np.linalg.norm(x, axis=1)
    step = np.linalg.norm(noise, axis=1)
    along = noise / np.maximum(step, 1e-12)[:, None]
    # In terms of the range: a plane through the sheet itself, where all profiles would lie, gains nothing.
    limit = CLOSE * size + 3.0 * step
    left, score = np.ones(len(x), bool), 0.0
    on = np.abs(normal @ x.T - distance[:, None]) < np.abs(normal @ along.T) * limit
    # Counted as a product, which is exact below 2^24 points.
    share = on.astype(np.float32)
    for _ in range(PLANES):
        count = share @ left.astype(np.float32)
        best = int(np.argmax(count))
        mine = left & on[best]
        if mine.mean() < LEAST_SHARE:
            break
        # Once more with all points that agree.
        plane = weighted_plane(x[mine], np.ones(mine.sum()))
        again = left & (np.abs(x @ plane.normal - plane.distance) < np.abs(along @ plane.normal) * limit)
        mine = again if again.sum() > mine.sum() else mine
        score += mine.mean() ** 2
        left &= ~mine
    return float(score)


def find_factor(sweep: SweepStripes, rig: Rig) -> float:
    """The factor of the journal's angles with which points lie on the fewest planes; 1 where none is better.

    A scan over usual ratios gives first values, also with a poor calibration, which bends walls much as a wrong factor
    does; least squares with the whole rig free brings them nearer.
    """
    if len(np.unique(sweep.record)) < 2 * REACH + 1:
        return 1.0
    # Between coarse steps no plane fits into the turn with the journal's own angles, and any smaller factor would look
    # better.
    if np.median(np.abs(np.diff(rig.theta))) > SPAN / (2 * LEAST_REACH):
        return 1.0
    own, best_score = _fitted(sweep, rig, 1.0)
    best = _ratio(own, rig)
    if abs(best - 1.0) < SURE[0] and best_score > SURE[1]:
        return 1.0
    sample = take_sample(sweep, rig.scanner, 1_200, 9_600)
    factors = candidates()
    scores = np.array([concentration(sample, factor * rig.theta) for factor in factors])
    found = own
    for _ in range(STARTS):
        k = int(np.argmax(scores))
        if scores[k] <= 0:
            break
        other, score = _fitted(sweep, rig, float(factors[k]))
        if score > BETTER * best_score:
            found, best_score = other, score
        scores[np.abs(np.log(factors / factors[k])) < np.log(NEAR)] = 0.0
    if best_score < LEAST_SCORE or np.ptp(found.theta) < LEAST_TURN:
        return 1.0
    factor = _ratio(found, rig)
    return factor if abs(factor - 1.0) >= SURE[0] else 1.0


def _ratio(found: Rig, rig: Rig) -> float:
    return float(rig.theta @ found.theta / (rig.theta @ rig.theta))


def _fitted(sweep: SweepStripes, rig: Rig, factor: float) -> tuple[Rig, float]:
    """The rig refined from angles by a factor, and how concentrated points then are on planes."""
    start = Rig.start(rig.scanner, factor * rig.theta)
    sample = take_sample(sweep, rig.scanner, 1_200, 9_600)
    before = concentration(sample, start.theta)
    found = iterate_fit(sweep, start, TIMES)
    after = concentration(take_sample(sweep, found.scanner, 1_200, 9_600), found.theta)
    return (found, after) if after >= before else (start, before)


def _propose(x: np.ndarray, place: np.ndarray, angle: np.ndarray) -> list[Plane]:
    """Planes through windows of some profiles, SPAN wide."""
    # Points are in the order of their profiles.
    starts = np.searchsorted(place, np.arange(len(angle) + 1))
    step = np.median(np.abs(np.diff(angle))) if len(angle) > 1 else 0.0
    if step == 0:
        return []
    apart = max(1, round(SPAN / (2 * REACH) / step))
    reach = apart * int(np.clip(SPAN / 2 / step, LEAST_REACH, REACH))
    if 2 * reach + 1 > len(angle):
        return []
    middles = np.unique(np.linspace(reach, len(angle) - 1 - reach, SEEDS).round().astype(int))
    windows = [range(middle - reach, middle + reach + 1, apart) for middle in middles]
    found = [np.concatenate([x[starts[k] : starts[k + 1]] for k in window]) for window in windows]
    return [weighted_plane(rows, np.ones(len(rows))) for rows in found if len(rows) >= 12]


LEAST_BREAK = np.deg2rad(0.35)
"""Smaller breaks are lost in the noise of normals, and found by their least squares."""
BREAK_TILT = np.deg2rad(1.5)
"""Difference of the tilts of the parts of a wall before and behind a break, at most."""
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
    """The record of a step whose size is roughly known: the likeliest first record after it, and from where to where it
    may be.

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
        return record, record, record
    count = high - low
    change = np.bincount(near.record - low, _costs(near, before, walls) - _costs(near, after, walls), count)
    # Of a step at `low`, low + 1 ... high: all records from there on stand as after it.
    cost = np.concatenate([[0.0], np.cumsum(change)])
    best = int(np.argmin(cost))
    possible = np.flatnonzero(cost < cost[best] + UNSURE)
    return low + best, low + int(possible[0]), low + int(possible[-1])


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
    rig = iterate_fit(sweep, start, 3, TIGHT)
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
    return iterate_fit(sweep, _begin(start, rig.steps), LAST_TIMES, TIGHT, MANY_POINTS) if rig.steps else rig


class LostStep(NamedTuple):
    """A step that was found."""

    record: int
    """The first record after it that is the most likely."""
    first: int
    """The first records that are possible, ..."""
    last: int
    """... up to this."""
    size: float
    """About the axis [rad]."""
    sigma: float
    """Its standard deviation [rad]."""


def lost_steps(sweep: SweepStripes, rig: Rig) -> list[LostStep]:
    """The steps of a rig with their places and standard deviations."""
    if not rig.steps:
        return []
    sample = take_sample(sweep, rig.scanner, MOST_PROFILES, MANY_POINTS)
    walls = wall_equations(sample, label_points(sample, rig.theta), rig, TIGHT)
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
    sample, records = take_sample(sweep, rig.scanner, MOST_PROFILES, MOST_POINTS), len(rig.theta)
    return standing_out(wall_equations(sample, label_points(sample, rig.theta), rig, TIGHT, robust), records)


def standing_out(rows: Equations, records: int) -> tuple[int, float] | None:
    """The record and size [rad] of the step that most stands out of the errors of some equations, if one does."""
    test = fit_steps(rows, records)
    z = np.abs(test.size) / test.sigma / inflation(rows, test.left, records)
    place = int(np.argmax(z))
    return None if z[place] < LEAST_Z or abs(test.size[place]) < LEAST_STEP else (place, float(test.size[place]))


def _with_step(sweep: SweepStripes, start: Rig, rig: Rig, place: tuple[int, float]) -> Rig:
    """The rig with one more step, settled, at the record that its points tell."""
    steps = (*rig.steps, place)
    for times in PLACED:
        # With the step mended, walls are whole across it, and tell its size and then its record.
        more = iterate_fit(sweep, _begin(start, steps), times, TIGHT)
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
