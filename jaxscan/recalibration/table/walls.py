"""The walls of a sweep as equations for the angles of its records."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxscan.geometry import Scanner
from jaxscan.recalibration.observed import SweepStripes
from jaxscan.recalibration.table.patches import Grid, find_patches, fit
from jaxscan.recalibration.table.regression import Rows
from jaxscan.recalibration.table.sheet import Stripes, move, parameter_slopes, parameter_spread, sheet_points


PROFILES, LINES = 240, 30
"""Of the grid of each laser on which patches are found."""
FLOOR = 1e-4
"""Standard deviation of a point from its wall, beside noise, as a part of its range."""
HARMONICS = 3
"""Errors of the table that repeat up to so many times per turn are no lost steps."""
WAVE_SPREAD, GAIN_SPREAD, STEP_SPREAD = 3e-3, 0.02, 0.1
"""How large errors of the table may be, and lost steps [rad, 1, rad]."""


MOST_SHIFT = 300.0
"""Of a stripe onto its wall, in sigmas."""


class Rig(NamedTuple):
    """What a sweep's points are made with; it is refined while faults are looked for."""

    scanner: Scanner
    theta: Float[np.ndarray, " records"]
    """Angle about the axis of each record, with the steps [rad]."""
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
    ridge: Float[np.ndarray, " unknowns"]
    """Standard deviations of the unknowns before: three for each wall, the rig's, gain and waves, the steps."""
    wall: Int[np.ndarray, " rows"]


def take_sample(sweep: SweepStripes, scanner: Scanner, profiles: int, points: int) -> Sample:
    """Points of so many profiles at most, on as many lines as that leaves."""
    count, lines = sweep.valid.shape
    kept = np.unique(np.linspace(0, count - 1, min(profiles, count)).round().astype(int))
    width = int(np.clip(points // max(len(kept), 1), 8, LINES))
    chosen = np.unique(np.linspace(0, lines - 1, min(width, lines)).round().astype(int))
    row, column = np.nonzero(sweep.valid[np.ix_(kept, chosen)])
    profile, line = kept[row], chosen[column]
    stripes = Stripes(sweep.centre[profile, line], line, sweep.laser[profile], sweep.stripe_axis)
    x, slope = sheet_points(scanner, stripes)
    sigma = sweep.sigma[profile, line].astype(np.float64)
    return Sample(x, slope * sigma[:, None], sigma, stripes, profile, column, sweep.record[profile])


def turn(angle: Float[np.ndarray, " points"], x: Float[np.ndarray, "points *rest"]) -> Float[np.ndarray, "points *rest"]:
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


def wall_equations(sample: Sample, label: Int[np.ndarray, " points"], rig: Rig) -> Walls:
    """The equations of all points on walls.

    The unknowns are three for each wall, the coordinates of camera, sheets and axis, the gain, errors that repeat a few
    times per turn, and the steps that are known.
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
        lever[on] = m[1] * x[on, 0] - m[0] * x[on, 1]
        first = np.cross(m, np.eye(3)[np.argmin(np.abs(m))])
        offset = x[on] - plane.centre
        own[on, 3 * k : 3 * k + 3] = np.stack([offset @ first, offset @ np.cross(m, first), -np.ones(len(offset))], -1)
    slopes = parameter_slopes(rig.scanner, sample.stripes.take(order, shift * sample.sigma[order]))
    parts = np.einsum("ni,nip->np", turn(-angle, normals), slopes)
    waves = np.stack([angle, *(wave(h * angle) for h in range(1, HARMONICS + 1) for wave in (np.sin, np.cos))], -1)
    known = np.stack([np.zeros(len(order)), *(record >= first for first, _ in rig.steps)], -1)[:, 1:]
    nuisance = np.concatenate([own, parts, waves * lever[:, None], known * lever[:, None]], axis=1)
    spread = [np.ones(3 * count), parameter_spread(rig.scanner), [GAIN_SPREAD], np.full(2 * HARMONICS, WAVE_SPREAD)]
    ridge = np.concatenate([*spread, np.full(len(rig.steps), STEP_SPREAD)])
    rows = Rows(error / sigma, lever / sigma, nuisance / sigma[:, None], record)
    return Walls(rows, ridge, wall)


def refine(rig: Rig, walls: Walls) -> Rig:
    """The rig after one step of least squares over all unknowns of `walls`."""
    n = walls.rows.nuisance
    # Errors that are larger than noise widen all that is learned from them.
    widened = max(1.0, float(np.mean(walls.rows.error**2)))
    normal = n.T @ n + widened * np.diag(1.0 / walls.ridge**2)
    found = np.linalg.solve(normal, n.T @ walls.rows.error)
    first, params = 3 * (int(walls.wall.max(initial=-1)) + 1), len(parameter_spread(rig.scanner))
    scanner = move(rig.scanner, found[first : first + params])
    gain, *waves = found[first + params : first + params + 1 + 2 * HARMONICS]
    theta = rig.theta * (1.0 + gain)
    for h in range(HARMONICS):
        theta = theta + waves[2 * h] * np.sin((h + 1) * rig.theta) + waves[2 * h + 1] * np.cos((h + 1) * rig.theta)
    more = found[first + params + 1 + 2 * HARMONICS :]
    for (record, _), step in zip(rig.steps, more, strict=True):
        theta[record:] += step
    steps = tuple((record, size + step) for (record, size), step in zip(rig.steps, more, strict=True))
    return Rig(scanner, theta, steps)
