"""The record at which a lost step lies: where points change from the walls as seen before it to those after."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscan.leastsq import MEDIAN_TO_SIGMA
from jaxscan.recalibration.observed import SweepStripes
from jaxscan.recalibration.table.patches import Plane, fit
from jaxscan.recalibration.table.walls import (
    FLOOR,
    MOST_COST,
    Rig,
    Sample,
    label_points,
    take_records,
    take_sample,
    turn,
)


NEIGHBOURS = 10
"""Records on each side of a step that was found in which it is sought once more."""
AROUND = np.deg2rad(20.0)
"""Turn on each side of a step in which the walls are fitted by which its record is told."""
LEAST_POINTS = 12
"""On a wall there."""
MANY_LINES = 120
PROFILES, POINTS = 720, 12_000
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
    sample = take_sample(sweep, rig.scanner, PROFILES, POINTS)
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
