"""The walls of a sweep as equations for the angles of its records, and steps of the angle as unknowns of them."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxscan.geometry import Scanner, StripeAxis, points, slopes, stripe_pixel
from jaxscan.geometry.motions import ANGLE_PARAMETERS
from jaxscan.leastsq import MEDIAN_TO_SIGMA
from jaxscan.recalibration.adjust import point_gradient
from jaxscan.recalibration.observed import SweepStripes
from jaxscan.recalibration.table.patches import Grid, find_patches, fit


SPREAD = (
    {"fx": 20.0, "fy": 20.0, "cx": 20.0, "cy": 20.0, "k1": 0.05, "k2": 0.1, "k3": 0.3, "p1": 2e-3, "p2": 2e-3}
    | {"n1": 3e-3, "n2": 3e-3, "d": 2e-3, "b2": 3e-3, "b3": 3e-3}
    | {"axis.d1": 5e-3, "axis.d2": 5e-3, "axis.p1": 3e-3, "axis.p2": 3e-3}
)
"""How far a coordinate of a poor calibration may be from the truth [px, rad, m]; 0.1 for others."""


class Stripes(NamedTuple):
    """Centres of stripes, in no order."""

    centre: Float[np.ndarray, " points"]
    """Across the line [px]."""
    line: Int[np.ndarray, " points"]
    laser: Int[np.ndarray, " points"]
    """The scanner's sheet."""
    axis: StripeAxis

    def seen(self) -> tuple[Float[np.ndarray, "points 2"], Int[np.ndarray, " points"]]:
        """Their pixels [px], and the sheet of each."""
        q = stripe_pixel(self.centre.astype(np.float64), self.line.astype(np.float64), self.axis)
        return np.asarray(q), self.laser

    def take(self, index: np.ndarray, shift: Float[np.ndarray, " taken"]) -> "Stripes":
        """The stripes at `index`, with centres that are `shift` px further."""
        return Stripes(self.centre[index] + shift, self.line[index], self.laser[index], self.axis)


def sheet_points(
    scanner: Scanner, stripes: Stripes
) -> tuple[Float[np.ndarray, "points 3"], Float[np.ndarray, "points 3"]]:
    """Points of stripes at angle 0 in the scanner frame, and how they move with the centre of the stripe.

    A table turns them about z: the point at angle theta is `Rz(theta) x`.

    Returns:
        x: Points [m].
        slope: Their derivative by the centre [m/px].
    """
    rig, (q, laser) = scanner.rig, stripes.seen()
    across = 0 if stripes.axis == "rows" else 1
    return np.asarray(points(rig, q, laser, 0.0)), np.asarray(slopes(rig, q, laser, 0.0))[..., across]


def points_of_records(scanner: Scanner, sweep: SweepStripes) -> Callable[[int], Float[np.ndarray, "points 3"] | None]:
    """`sheet_points` of the first stripe of each record, in the order along it; None for a record without a stripe."""

    def of(record: int) -> Float[np.ndarray, "points 3"] | None:
        profiles = np.flatnonzero(sweep.record == record)
        if not len(profiles):
            return None
        first = int(profiles[0])
        line = np.flatnonzero(sweep.valid[first])
        laser = np.full(len(line), sweep.laser[first])
        return sheet_points(scanner, Stripes(sweep.centre[first, line], line, laser, sweep.stripe_axis))[0]

    return of


def parameter_slopes(scanner: Scanner, stripes: Stripes) -> Float[np.ndarray, "points 3 params"]:
    """Derivatives of `sheet_points` by the coordinates of camera, sheets and axis [m per px, rad, m]."""
    q, laser = stripes.seen()
    return point_gradient(scanner, q, laser, np.zeros(len(q)))[..., : -len(ANGLE_PARAMETERS)]


def move(scanner: Scanner, step: Float[np.ndarray, " params"]) -> Scanner:
    """The scanner moved by `step` in the coordinates of camera, sheets and axis [px, rad, m]."""
    return scanner.retract(np.append(step, np.zeros(len(ANGLE_PARAMETERS))))


def parameter_spread(scanner: Scanner) -> Float[np.ndarray, " params"]:
    """How far the coordinates of `parameter_slopes` may be from the truth, generously [px, rad, m]."""
    names = scanner.parameter_names()[: -len(ANGLE_PARAMETERS)]
    return np.array([SPREAD.get(name, SPREAD.get(name.split(".")[-1], 0.1)) for name in names])


class Rows(NamedTuple):
    """Whitened equations `error = nuisance @ unknowns + turn * (angle of the record)`, sorted by record."""

    error: Float[np.ndarray, " rows"]
    turn: Float[np.ndarray, " rows"]
    """Derivative by the angle about the axis of the row's record [1/rad]."""
    nuisance: Float[np.ndarray, "rows unknowns"]
    record: Int[np.ndarray, " rows"]


class Prior(NamedTuple):
    """Prior knowledge of the unknowns."""

    mean: Float[np.ndarray, " unknowns"]
    sigma: Float[np.ndarray, " unknowns"]


class StepTest(NamedTuple):
    """The step that each record would need."""

    size: Float[np.ndarray, " records"]
    """Angle by which this and all later records stand ahead of their angle [rad]."""
    sigma: Float[np.ndarray, " records"]
    """Its standard deviation; infinite where nothing tells it [rad]."""


def solve(rows: Rows, prior: Prior) -> Float[np.ndarray, " unknowns"]:
    """The unknowns of least squares; errors that are larger than noise widen all that is learned from them."""
    n = rows.nuisance
    weight = max(1.0, float(np.mean(rows.error**2))) / prior.sigma**2
    return np.linalg.solve(n.T @ n + np.diag(weight), n.T @ rows.error + weight * prior.mean)


def fit_steps(rows: Rows, records: int, prior: Prior) -> tuple[StepTest, Float[np.ndarray, " rows"]]:
    r"""The step of every record, each fitted with all other unknowns but without the other steps.

    With N the nuisance, r the error after their fit, and c the column of a step (`turn` from its record on),
    $$\delta = c^T r / (c^T c - c^T N (N^T N)^{-1} N^T c)$$
    where all products are sums from the last record back.

    Args:
        rows: Equations.
        records: How many records there are.
        prior: Of the unknowns.

    Returns:
        The steps, and the errors after the fit of the nuisance.
    """
    n = rows.nuisance
    normal = n.T @ n + np.diag(1.0 / prior.sigma**2)
    scale = np.sqrt(np.diag(normal))
    inverse = np.linalg.inv(normal / np.outer(scale, scale)) / np.outer(scale, scale)
    left = rows.error - n @ (inverse @ (n.T @ rows.error + prior.mean / prior.sigma**2))
    score = backwards(rows.turn * left, rows.record, records)
    own = backwards(rows.turn**2, rows.record, records)
    shared = backwards(rows.turn[:, None] * n, rows.record, records)
    power = own - np.sum((shared @ inverse) * shared, axis=1)
    known = power > 1e-6 * own[:1]
    safe = np.where(known, power, 1.0)
    size = np.where(known, score / safe, 0.0)
    return StepTest(size, np.where(known, 1.0 / np.sqrt(safe), np.inf)), left


def backwards(values: np.ndarray, record: np.ndarray, records: int) -> np.ndarray:
    """Sums over each record and all later ones."""
    if len(record) == 0:
        return np.zeros((records, *values.shape[1:]))
    starts = np.searchsorted(record, np.arange(records))
    whole = np.concatenate([values, np.zeros_like(values[:1])])
    sums = np.add.reduceat(whole, starts, axis=0)
    sums[np.diff(np.append(starts, len(record))) == 0] = 0.0
    return np.cumsum(sums[::-1], axis=0)[::-1]


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
