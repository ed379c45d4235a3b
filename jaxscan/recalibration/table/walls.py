"""The walls of a sweep as equations for the angles of its records."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxscan.geometry import Scanner
from jaxscan.leastsq import MEDIAN_TO_SIGMA
from jaxscan.recalibration.observed import SweepStripes
from jaxscan.recalibration.table.patches import Grid, find_patches, fit
from jaxscan.recalibration.table.regression import Prior, Rows, solve
from jaxscan.recalibration.table.sheet import Stripes, move, parameter_slopes, parameter_spread, sheet_points


PROFILES, LINES = 240, 30
"""Of the grid of each laser on which patches are found."""
FLOOR = 1e-4
"""Standard deviation of a point from its wall, beside noise, as a part of its range."""
HARMONICS = 3
"""Errors of the table that repeat up to so many times per turn are no lost steps."""
STEP_SPREAD = 0.1
"""How large a lost step may be [rad]."""
LOOSE, TIGHT = (0.02, 3e-3), (1e-3, 7e-4)
"""How far gain and waves may be from the calibration's: where the factor is sought, and where steps are [1, rad]."""


FEW_POINTS, FEW_LINES = 6_000, 15
"""With which the rig is refined."""
MOST_COST = 25.0
"""Of one point in `truncated_cost`."""
ROBUST = 4.0
"""Sigmas at which the weight of a point is a quarter."""
MOST_SHIFT = 300.0
"""Of a stripe onto its wall, in sigmas."""


class Rig(NamedTuple):
    """The scanner and angles that a sweep's points are made with; refined while faults are looked for."""

    scanner: Scanner
    theta: Float[np.ndarray, " records"]
    """Angle about the axis of each record, with the steps [rad]."""
    table: Float[np.ndarray, " table"]
    """Gain and waves by which `theta` departs from where it began [1, rad]."""
    steps: tuple[tuple[int, float], ...] = ()
    """First record and angle of each lost step that was found, in the order in which they were [rad]."""


class Sample(NamedTuple):
    """Points of a sweep at angle 0, on a grid of some lines of all profiles."""

    x: Float[np.ndarray, "points 3"]
    """Scanner frame [m]."""
    noise: Float[np.ndarray, "points 3"]
    """Displacement by one sigma of the stripe [m]."""
    sigma: Float[np.ndarray, " points"]
    """Of the centre [px]."""
    stripes: Stripes
    profile: Int[np.ndarray, " points"]
    column: Int[np.ndarray, " points"]
    """Number among the chosen lines."""
    record: Int[np.ndarray, " points"]


class Walls(NamedTuple):
    """Equations of all walls, whitened, sorted by record."""

    rows: Rows
    prior: Prior
    """Of the unknowns: three for each wall, the rig's, gain and waves, the steps."""
    wall: Int[np.ndarray, " rows"]


def take_sample(sweep: SweepStripes, scanner: Scanner, profiles: int, points: int) -> Sample:
    """Points of so many profiles at most, on as many lines as that leaves."""
    count = len(sweep.valid)
    lit = np.nonzero(sweep.valid.any(axis=0))[0]
    kept = np.unique(np.linspace(0, count - 1, min(profiles, count)).round().astype(int))
    width = int(np.clip(points // max(len(kept), 1), 8, LINES))
    return _sample(sweep, scanner, kept, spread_over(lit, width))


def take_records(sweep: SweepStripes, scanner: Scanner, records: tuple[int, int], lines: int) -> Sample:
    """Points of all profiles of some records, from the first up to the last without it, on so many lines at most."""
    kept = np.flatnonzero((sweep.record >= records[0]) & (sweep.record < records[1]))
    return _sample(sweep, scanner, kept, spread_over(np.flatnonzero(sweep.valid.any(axis=0)), lines))


def spread_over(numbers: Int[np.ndarray, " n"], count: int) -> Int[np.ndarray, " some"]:
    """So many of the numbers at most, evenly."""
    return numbers[np.unique(np.linspace(0, len(numbers) - 1, min(count, len(numbers))).round().astype(int))]


def _sample(sweep: SweepStripes, scanner: Scanner, kept: np.ndarray, chosen: np.ndarray) -> Sample:
    row, column = np.nonzero(sweep.valid[np.ix_(kept, chosen)])
    profile, line = kept[row], chosen[column]
    stripes = Stripes(sweep.centre[profile, line], line, sweep.laser[profile], sweep.stripe_axis)
    x, slope = sheet_points(scanner, stripes)
    sigma = sweep.sigma[profile, line].astype(np.float64)
    return Sample(x, slope * sigma[:, None], sigma, stripes, profile, column, sweep.record[profile])


def turn(
    angle: Float[np.ndarray, " points"], x: Float[np.ndarray, "points *rest"]
) -> Float[np.ndarray, "points *rest"]:
    """Points, or their derivatives, turned about z."""
    shape = (-1,) + (1,) * (x.ndim - 2)
    c, s = np.cos(angle).reshape(shape), np.sin(angle).reshape(shape)
    return np.stack([c * x[:, 0] - s * x[:, 1], s * x[:, 0] + c * x[:, 1], x[:, 2]], axis=1)


def label_points(sample: Sample, theta: Float[np.ndarray, " records"]) -> Int[np.ndarray, " points"]:
    """Number of the wall of each point, -1 for none, with the table at the angles `theta` [rad]."""
    label = np.full(len(sample.x), -1)
    x, noise = turn(theta[sample.record], sample.x), turn(theta[sample.record], sample.noise)
    first = 0
    columns = int(sample.column.max(initial=0)) + 1
    for laser in np.unique(sample.stripes.laser):
        points = np.nonzero(sample.stripes.laser == laser)[0]
        # Each laser once per record: its profiles in the order of the table.
        mine, place = np.unique(sample.record[points], return_inverse=True)
        index = np.full((len(mine), columns), -1)
        index[place, sample.column[points]] = points
        stride = max(1, len(mine) // PROFILES)
        coarse = index[::stride]
        found = find_patches(Grid(x[coarse], noise[coarse], coarse >= 0))
        # A point between two coarse profiles is on the wall on which both are.
        low = np.arange(len(mine)) // stride
        high = np.minimum(low + (np.arange(len(mine)) % stride > 0), len(coarse) - 1)
        fine = np.where(found[low] == found[high], found[low], -1)
        on = (index >= 0) & (fine >= 0)
        label[index[on]] = fine[on] + first
        first = max(first, int(label.max()) + 1)
    return label


def start_rig(scanner: Scanner, theta: Float[np.ndarray, " records"]) -> Rig:
    """A scanner, and the angles of its records by the journal or a factor of it [rad]."""
    return Rig(scanner, theta, np.zeros(1 + 2 * HARMONICS))


def wall_equations(
    sample: Sample,
    label: Int[np.ndarray, " points"],
    rig: Rig,
    spread: tuple[float, float] = LOOSE,
    robust: bool = True,
) -> Walls:
    """The equations of all points on walls.

    The unknowns are three for each wall, the coordinates of camera, sheets and axis, the gain, errors that repeat a few
    times per turn, and the steps that are known.

    Args:
        sample: Points.
        label: Their walls.
        rig: About which the equations are linear.
        spread: How far the gain [1] and the waves [rad] may be from where they began.
        robust: Whether points that are far from their wall have little weight.
    """
    order = np.nonzero(label >= 0)[0]
    order = order[np.argsort(sample.record[order], kind="stable")]
    wall, record = label[order], sample.record[order]
    angle = rig.theta[record]
    x, noise = turn(angle, sample.x[order]), turn(angle, sample.noise[order])
    count = int(wall.max(initial=-1)) + 1
    error, sigma, lever = np.zeros(len(order)), np.ones(len(order)), np.zeros(len(order))
    own = np.zeros((len(order), 3 * count))
    normals, shift = np.zeros((len(order), 3)), np.zeros(len(order))
    for k in range(count):
        on = wall == k
        plane = fit(x[on])
        if plane is None:
            continue
        m = plane.normal
        normals[on] = m
        error[on] = plane.distance - x[on] @ m
        # The unknowns see the point on the wall: a stretch of the room would shrink the noise with it.
        shift[on] = np.clip(error[on] / (noise[on] @ m), -MOST_SHIFT, MOST_SHIFT)
        x[on] += shift[on, None] * noise[on]
        sigma[on] = np.hypot(noise[on] @ m, FLOOR * np.linalg.norm(x[on], axis=1))
        whitened = error[on] / sigma[on]
        if robust:
            # Things that hang on the wall have little weight; a wall that is bent as a whole keeps its own.
            limit = ROBUST * max(1.0, MEDIAN_TO_SIGMA * float(np.median(np.abs(whitened))))
            sigma[on] *= 1.0 + (whitened / limit) ** 2
        lever[on] = m[1] * x[on, 0] - m[0] * x[on, 1]
        first = np.cross(m, np.eye(3)[np.argmin(np.abs(m))])
        offset = x[on] - plane.centre
        own[on, 3 * k : 3 * k + 3] = np.stack([offset @ first, offset @ np.cross(m, first), -np.ones(len(offset))], -1)
    slopes = parameter_slopes(rig.scanner, sample.stripes.take(order, shift * sample.sigma[order]))
    parts = np.einsum("ni,nip->np", turn(-angle, normals), slopes)
    waves = np.stack([angle, *(wave(h * angle) for h in range(1, HARMONICS + 1) for wave in (np.sin, np.cos))], -1)
    known = np.stack([np.zeros(len(order)), *(record >= first for first, _ in rig.steps)], -1)[:, 1:]
    nuisance = np.concatenate([own, parts, waves * lever[:, None], known * lever[:, None]], axis=1)
    parameters = parameter_spread(rig.scanner)
    table = np.append(spread[0], np.full(2 * HARMONICS, spread[1]))
    sigma_before = [np.ones(3 * count), parameters, table, np.full(len(rig.steps), STEP_SPREAD)]
    mean = [np.zeros(3 * count + len(parameters)), -rig.table, np.zeros(len(rig.steps))]
    rows = Rows(error / sigma, lever / sigma, nuisance / sigma[:, None], record)
    return Walls(rows, Prior(np.concatenate(mean), np.concatenate(sigma_before)), wall)


def refine(rig: Rig, walls: Walls) -> Rig:
    """The rig after one step of least squares over all unknowns of `walls`."""
    found = solve(walls.rows, walls.prior)
    first, params = 3 * (int(walls.wall.max(initial=-1)) + 1), len(parameter_spread(rig.scanner))
    scanner = move(rig.scanner, found[first : first + params])
    table = found[first + params : first + params + 1 + 2 * HARMONICS]
    theta = rig.theta * (1.0 + table[0])
    for h in range(1, HARMONICS + 1):
        theta = theta + table[2 * h - 1] * np.sin(h * rig.theta) + table[2 * h] * np.cos(h * rig.theta)
    more = found[first + params + 1 + 2 * HARMONICS :]
    for (record, _), step in zip(rig.steps, more, strict=True):
        theta[record:] += step
    steps = tuple((record, size + float(step)) for (record, size), step in zip(rig.steps, more, strict=True))
    return Rig(scanner, theta, rig.table + table, steps)


def settle(
    sweep: SweepStripes, rig: Rig, times: int, spread: tuple[float, float] = LOOSE, points: int = FEW_POINTS
) -> Rig:
    """The rig after some steps of least squares, with few points if nothing else is said."""
    for _ in range(times):
        sample = take_sample(sweep, rig.scanner, points // FEW_LINES, points)
        label = label_points(sample, rig.theta)
        if label.max(initial=-1) < 0:
            return rig
        rig = refine(rig, wall_equations(sample, label, rig, spread))
    return rig


def truncated_cost(sweep: SweepStripes, rig: Rig) -> tuple[float, int]:
    """Squared errors of points from their walls in sigmas, at most that of one on no wall; their number."""
    sample = take_sample(sweep, rig.scanner, FEW_POINTS // FEW_LINES, FEW_POINTS)
    label = label_points(sample, rig.theta)
    angle = rig.theta[sample.record]
    x, noise = turn(angle, sample.x), turn(angle, sample.noise)
    cost = MOST_COST * float(np.count_nonzero(label < 0))
    for k in range(int(label.max(initial=-1)) + 1):
        on = label == k
        plane = fit(x[on])
        error = (x[on] @ plane.normal - plane.distance) if plane is not None else np.full(on.sum(), np.inf)
        sigma = np.abs(noise[on] @ plane.normal) if plane is not None else np.ones(on.sum())
        cost += float(
            np.minimum((error / np.hypot(sigma, FLOOR * np.linalg.norm(x[on], axis=1))) ** 2, MOST_COST).sum()
        )
    return cost, len(label)
