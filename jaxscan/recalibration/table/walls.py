"""The walls of a sweep as equations for the angles of its records, and steps of the angle as unknowns of them.

Walls are flat patches of the grid [profile, line], found with a tolerance that a faulty table does not break.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.geometry import Scanner, points, slopes
from jaxscan.geometry.motions import ANGLE_PARAMETERS
from jaxscan.leastsq import MEDIAN_TO_SIGMA
from jaxscan.measurement.planes import Plane, facing, weighted_plane
from jaxscan.measurement.systematic import point_gradient
from jaxscan.recalibration.grid import Windows, smooth_parts, spread_over, window_planes
from jaxscan.recalibration.observed import SweepStripes


HALF = 2
"""Cells on each side of a cell in whose window its normal is taken."""
FLATNESS = 0.001
"""Part of the range by which a window may depart from its plane, beside noise."""
BEND = np.cos(np.deg2rad(2.5))
"""Cosine of the angle between the normals of neighbours on one patch."""
SAME = 0.005
"""Part of the range by which the distances of two parts of one wall from the axis may differ."""
LEAST_CELLS = 40
FOLD, MOST_TILT = np.deg2rad(6.0), np.deg2rad(2.5)
"""Between two parts of a wall that a lost step has broken: largest turn about the axis, and difference of tilts."""


def flat_windows(
    x: Float[np.ndarray, "profiles lines 3"],
    noise: Float[np.ndarray, "profiles lines 3"],
    valid: Bool[np.ndarray, "profiles lines"],
) -> tuple[Float[np.ndarray, "profiles lines 3"], Bool[np.ndarray, "profiles lines"]]:
    """Normal of the window about each cell, towards the axis, and whether it is flat beside noise of the stripe [m]."""
    half = np.full(valid.shape, HALF)
    count, normal, variance = window_planes(x, valid, Windows.around(half, half))
    size, along = np.linalg.norm(x, axis=-1), np.linalg.norm(noise, axis=-1)
    across = np.abs(np.sum(normal * noise, axis=-1))
    thin = np.sqrt(variance[..., 0]) < 1.5 * across + FLATNESS * size
    wide = np.sqrt(variance[..., 1]) > 3.0 * across + 5.0 * FLATNESS * size
    return normal, valid & thin & wide & (count >= 0.6 * (2 * HALF + 1) ** 2) & (across > 0.1 * along)


def label_patches(
    x: Float[np.ndarray, "profiles lines 3"],
    noise: Float[np.ndarray, "profiles lines 3"],
    valid: Bool[np.ndarray, "profiles lines"],
) -> Int[np.ndarray, "profiles lines"]:
    """Number of the flat patch of each point; -1: none.

    Neighbours belong together where windows about them are flat and have nearly the same plane. Parts of one wall that
    a lost step turned against each other, or that furniture divides, get one number. Arguments as of `flat_windows`.
    """
    normal, flat = flat_windows(x, noise, valid)
    across = np.abs(np.sum(normal * noise, axis=-1))
    part = smooth_parts(x, normal, flat, 2.0 * (across + FLATNESS * np.linalg.norm(x, axis=-1)), BEND)
    names, counts = np.unique(part[part >= 0], return_counts=True)
    found: list[tuple[Plane, np.ndarray, int]] = []
    labels, walls = np.full(part.shape, -1), 0
    for name in names[np.argsort(-counts, kind="stable")][: np.count_nonzero(counts >= LEAST_CELLS)]:
        own = x[part == name]
        plane = robust_plane(own)
        if plane is None:
            continue
        wall = next((wall for other, far, wall in found if _one_wall(plane, other, own, far)), walls)
        walls = max(walls, wall + 1)
        found.append((plane, own, wall))
        labels[part == name] = wall
    return labels


def robust_plane(x: Float[np.ndarray, "points 3"]) -> Plane | None:
    """The plane of least squares, with less weight for points that are far from it; None where there is none."""
    weight = np.ones(len(x))
    for _ in range(4):
        used, plane = weight, weighted_plane(x, weight)
        error = (x - plane.centre) @ plane.normal
        weight = 1.0 / (1.0 + (error / (3.0 * np.median(np.abs(error)) + 1e-6)) ** 2)
    narrowest = min(used @ ((x - plane.centre) @ axis) ** 2 for axis in plane.axes)
    return facing(plane, plane.centre) if narrowest >= 4.0 * (used @ error**2) else None


def _one_wall(a: Plane, b: Plane, x: np.ndarray, y: np.ndarray) -> bool:
    """Whether a turn about the axis makes one plane of two, and they are neighbours."""
    size = max(np.linalg.norm(a.centre), np.linalg.norm(b.centre))
    if min(np.hypot(*a.normal[:2]), np.hypot(*b.normal[:2])) < 0.5:
        # A turn about the axis does not move a floor.
        near = abs(a.distance - b.distance) < SAME * np.linalg.norm(a.centre)
        return bool(near and a.normal @ b.normal > BEND)
    turned, tilt = fold(a.normal, b.normal)
    if abs(turned) > FOLD or abs(tilt) > MOST_TILT or abs(a.distance - b.distance) > SAME * size:
        return False
    along = np.cross([0.0, 0.0, 1.0], a.normal)
    s, t = x @ along, y @ along
    gap = max(np.min(s) - np.max(t), np.min(t) - np.max(s))
    return bool(gap < 0.25 * size)


def fold(a: Float[np.ndarray, "*n 3"], b: Float[np.ndarray, "*n 3"]) -> tuple[np.ndarray, np.ndarray]:
    """By how much normals are turned about the axis against others, and tilted against it [rad]."""
    turned = np.arctan2(a[..., 1], a[..., 0]) - np.arctan2(b[..., 1], b[..., 0])
    tilt = np.arcsin(np.clip(a[..., 2], -1, 1)) - np.arcsin(np.clip(b[..., 2], -1, 1))
    return np.asarray((turned + np.pi) % (2 * np.pi) - np.pi), np.asarray(tilt)


SPREAD = (
    {"fx": 20.0, "fy": 20.0, "cx": 20.0, "cy": 20.0, "k1": 0.05, "k2": 0.1, "k3": 0.3, "p1": 2e-3, "p2": 2e-3}
    | {"n1": 3e-3, "n2": 3e-3, "d": 2e-3, "b2": 3e-3, "b3": 3e-3}
    | {"axis.d1": 5e-3, "axis.d2": 5e-3, "axis.p1": 3e-3, "axis.p2": 3e-3}
)
"""How far a coordinate of a poor calibration may be from the truth [px, rad, m]; 0.1 for others."""


def points_of_records(scanner: Scanner, sweep: SweepStripes) -> Callable[[int], Float[np.ndarray, "points 3"] | None]:
    """Points at angle 0 of the first stripe of each record, in the order along it; None for a record without one."""

    def of(record: int) -> Float[np.ndarray, "points 3"] | None:
        profiles = np.flatnonzero(sweep.record == record)
        if not len(profiles):
            return None
        line = np.flatnonzero(sweep.valid[profiles[0]])
        profile = np.full(len(line), profiles[0])
        return np.asarray(points(scanner.rig, sweep.pixels(profile, line), sweep.laser[profile], 0.0))

    return of


def _parameter_spread(scanner: Scanner) -> Float[np.ndarray, " params"]:
    """How far coordinates of camera, sheets and axis may be from the truth, generously [px, rad, m]."""
    names = scanner.parameter_names()[: -len(ANGLE_PARAMETERS)]
    return np.array([SPREAD.get(name, SPREAD.get(name.split(".")[-1], 0.1)) for name in names])


class Equations(NamedTuple):
    """Whitened equations `error = nuisance @ unknowns + turn * (angle of the record)`, sorted by record, and what is
    known of the unknowns beforehand."""

    error: Float[np.ndarray, " rows"]
    turn: Float[np.ndarray, " rows"]
    """Derivative by the angle about the axis of the row's record [1/rad]."""
    nuisance: Float[np.ndarray, "rows unknowns"]
    record: Int[np.ndarray, " rows"]
    mean: Float[np.ndarray, " unknowns"]
    sigma: Float[np.ndarray, " unknowns"]

    def solve(self) -> Float[np.ndarray, " unknowns"]:
        """The unknowns of least squares; errors that are larger than noise widen all that is learned from them."""
        n = self.nuisance
        weight = max(1.0, float(np.mean(self.error**2))) / self.sigma**2
        return np.linalg.solve(n.T @ n + np.diag(weight), n.T @ self.error + weight * self.mean)

    def covariance(self) -> Float[np.ndarray, "unknowns unknowns"]:
        """Of the unknowns."""
        normal = self.nuisance.T @ self.nuisance + np.diag(1.0 / self.sigma**2)
        scale = np.sqrt(np.diag(normal))
        return np.linalg.inv(normal / np.outer(scale, scale)) / np.outer(scale, scale)


class StepTest(NamedTuple):
    """The step that each record would need."""

    size: Float[np.ndarray, " records"]
    """Angle by which this and all later records stand ahead of their angle [rad]."""
    sigma: Float[np.ndarray, " records"]
    """Its standard deviation; infinite where nothing tells it [rad]."""
    left: Float[np.ndarray, " rows"]


def fit_steps(rows: Equations, records: int) -> StepTest:
    r"""The step of every record, each fitted with all other unknowns but without the other steps.

    With N the nuisance, r the error after their fit, and c the column of a step (`turn` from its record on),
    $$\delta = c^T r / (c^T c - c^T N (N^T N)^{-1} N^T c)$$
    where all products are sums from the last record back.
    """
    n, inverse = rows.nuisance, rows.covariance()
    left = rows.error - n @ (inverse @ (n.T @ rows.error + rows.mean / rows.sigma**2))
    score = _backwards(rows.turn * left, rows.record, records)
    own = _backwards(rows.turn**2, rows.record, records)
    shared = _backwards(rows.turn[:, None] * n, rows.record, records)
    power = own - np.sum((shared @ inverse) * shared, axis=1)
    known = power > 1e-6 * own[:1]
    safe = np.where(known, power, 1.0)
    return StepTest(np.where(known, score / safe, 0.0), np.where(known, 1.0 / np.sqrt(safe), np.inf), left)


def _backwards(values: np.ndarray, record: np.ndarray, records: int) -> np.ndarray:
    """Sums over each record and all later ones."""
    sums = np.zeros((records, *values.shape[1:]))
    if len(record):
        names, starts = np.unique(record, return_index=True)
        sums[names] = np.add.reduceat(values, starts, axis=0)
    return np.cumsum(sums[::-1], axis=0)[::-1]


PROFILES, LINES = 240, 30
"""Of the grid of each laser on which patches are found."""
FLOOR = 1e-4
"""Standard deviation of a point from its wall, beside noise, as a part of its range."""
HARMONICS = 3
"""Errors of the table that repeat up to so many times per turn are no lost steps."""
STEP_SPREAD = 0.1
"""How large a lost step may be [rad]."""
GAIN, WAVES = 1e-3, 7e-4
"""How far gain and waves may be from the calibration's [1, rad]."""
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

    @staticmethod
    def start(scanner: Scanner, theta: Float[np.ndarray, " records"]) -> "Rig":
        """With the angles of records by the journal [rad]."""
        return Rig(scanner, theta, np.zeros(1 + 2 * HARMONICS))


class Sample(NamedTuple):
    """Points of a sweep at angle 0, on a grid of some lines of all profiles. The table turns them about z."""

    x: Float[np.ndarray, "points 3"]
    noise: Float[np.ndarray, "points 3"]
    """Displacement by one sigma of the stripe [m]."""
    sigma: Float[np.ndarray, "points 2"]
    q: Float[np.ndarray, "points 2"]
    laser: Int[np.ndarray, " points"]
    profile: Int[np.ndarray, " points"]
    column: Int[np.ndarray, " points"]
    record: Int[np.ndarray, " points"]

    def turned(self, theta: Float[np.ndarray, " records"]) -> tuple[np.ndarray, np.ndarray]:
        """Points and their displacements by noise in the room, with the table at the angles `theta` [rad]."""
        angle = theta[self.record]
        return turn(angle, self.x), turn(angle, self.noise)


def take_sample(sweep: SweepStripes, scanner: Scanner, profiles: int, points: int) -> Sample:
    """Points of so many profiles at most, on as many lines as that leaves."""
    kept = spread_over(np.arange(len(sweep.valid)), profiles)
    return _sample(sweep, scanner, kept, int(np.clip(points // max(len(kept), 1), 8, LINES)))


def take_records(sweep: SweepStripes, scanner: Scanner, records: tuple[int, int], lines: int) -> Sample:
    """Points of all profiles of some records, from the first up to the last without it, on so many lines at most."""
    kept = np.flatnonzero((sweep.record >= records[0]) & (sweep.record < records[1]))
    return _sample(sweep, scanner, kept, lines)


def _sample(sweep: SweepStripes, scanner: Scanner, kept: np.ndarray, lines: int) -> Sample:
    chosen = spread_over(np.flatnonzero(sweep.valid.any(axis=0)), lines)
    row, column = np.nonzero(sweep.valid[np.ix_(kept, chosen)])
    profile, line = kept[row], chosen[column]
    q, laser = sweep.pixels(profile, line), sweep.laser[profile]
    across = np.array([1.0, 0.0] if sweep.stripe_axis == "rows" else [0.0, 1.0])
    sigma = np.outer(sweep.sigma[profile, line].astype(np.float64), across)
    x = np.asarray(points(scanner.rig, q, laser, 0.0))
    noise = (np.asarray(slopes(scanner.rig, q, laser, 0.0)) @ sigma[..., None])[..., 0]
    return Sample(x, noise, sigma, q, laser, profile, column, sweep.record[profile])


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
    x, noise = sample.turned(theta)
    columns = int(sample.column.max(initial=0)) + 1
    for laser in np.unique(sample.laser):
        own = np.nonzero(sample.laser == laser)[0]
        # Each laser once per record: its profiles in the order of the table.
        mine, place = np.unique(sample.record[own], return_inverse=True)
        index = np.full((len(mine), columns), -1)
        index[place, sample.column[own]] = own
        stride = max(1, len(mine) // PROFILES)
        coarse = index[::stride]
        found = label_patches(x[coarse], noise[coarse], coarse >= 0)
        # A point between two coarse profiles is on the wall on which both are.
        low = np.arange(len(mine)) // stride
        high = np.minimum(low + (np.arange(len(mine)) % stride > 0), len(coarse) - 1)
        fine = np.where(found[low] == found[high], found[low], -1)
        on = (index >= 0) & (fine >= 0)
        label[index[on]] = fine[on] + int(label.max(initial=-1)) + 1
    return label


def wall_equations(
    sample: Sample,
    label: Int[np.ndarray, " points"],
    rig: Rig,
    robust: bool = True,
) -> Equations:
    """The equations of all points on walls, linear about a rig; `robust`: points far from their wall weigh little.

    The unknowns are three for each wall, the coordinates of camera, sheets and axis, the gain, errors that repeat a few
    times per turn, and the steps that are known.
    """
    order = np.nonzero(label >= 0)[0]
    order = order[np.argsort(sample.record[order], kind="stable")]
    wall, record = label[order], sample.record[order]
    angle = rig.theta[record]
    x, noise = (field[order] for field in sample.turned(rig.theta))
    count = int(wall.max(initial=-1)) + 1
    error, sigma, lever, shift = np.zeros(len(order)), np.ones(len(order)), np.zeros(len(order)), np.zeros(len(order))
    own, normals = np.zeros((len(order), 3 * count)), np.zeros((len(order), 3))
    for k in range(count):
        on = wall == k
        plane = robust_plane(x[on])
        if plane is None:
            continue
        m = plane.normal
        normals[on] = m
        error[on] = plane.distance - x[on] @ m
        # Derivatives are taken at the point moved onto the wall: otherwise shrinking the room would also shrink the
        # errors.
        shift[on] = np.clip(error[on] / (noise[on] @ m), -MOST_SHIFT, MOST_SHIFT)
        x[on] += shift[on, None] * noise[on]
        sigma[on] = np.hypot(noise[on] @ m, FLOOR * np.linalg.norm(x[on], axis=1))
        if robust:
            # Things that hang on the wall have little weight; a wall that is bent as a whole keeps its own.
            whitened = error[on] / sigma[on]
            limit = ROBUST * max(1.0, MEDIAN_TO_SIGMA * float(np.median(np.abs(whitened))))
            sigma[on] *= 1.0 + (whitened / limit) ** 2
        lever[on] = m[1] * x[on, 0] - m[0] * x[on, 1]
        own[on, 3 * k : 3 * k + 3] = np.column_stack([(x[on] - plane.centre) @ plane.axes.T, -np.ones(on.sum())])
    q = sample.q[order] + shift[:, None] * sample.sigma[order]
    by_scanner = point_gradient(rig.scanner.rig, q, sample.laser[order], np.zeros(len(q)))[
        ..., : -len(ANGLE_PARAMETERS)
    ]
    parts = np.einsum("ni,nip->np", turn(-angle, normals), by_scanner)
    waves = np.stack([angle, *(wave(h * angle) for h in range(1, HARMONICS + 1) for wave in (np.sin, np.cos))], -1)
    known = np.stack([np.zeros(len(order)), *(record >= first for first, _ in rig.steps)], -1)[:, 1:]
    nuisance = np.concatenate([own, parts, waves * lever[:, None], known * lever[:, None]], axis=1)
    parameters = _parameter_spread(rig.scanner)
    table = np.append(GAIN, np.full(2 * HARMONICS, WAVES))
    before = np.concatenate([np.ones(3 * count), parameters, table, np.full(len(rig.steps), STEP_SPREAD)])
    mean = np.concatenate([np.zeros(3 * count + len(parameters)), -rig.table, np.zeros(len(rig.steps))])
    return Equations(error / sigma, lever / sigma, nuisance / sigma[:, None], record, mean, before)


def _refined(rig: Rig, walls: Equations) -> Rig:
    """The rig after one step of least squares over all unknowns of its walls."""
    steps, params = len(rig.steps), len(_parameter_spread(rig.scanner))
    own = walls.solve()[-steps - len(rig.table) - params :]
    table, more = own[params : params + len(rig.table)], own[params + len(rig.table) :]
    theta = rig.theta * (1.0 + table[0])
    for h in range(1, HARMONICS + 1):
        theta = theta + table[2 * h - 1] * np.sin(h * rig.theta) + table[2 * h] * np.cos(h * rig.theta)
    for (record, _), step in zip(rig.steps, more, strict=True):
        theta[record:] += step
    scanner = rig.scanner.retract(np.append(own[:params], np.zeros(len(ANGLE_PARAMETERS))))
    sizes = tuple((record, size + float(step)) for (record, size), step in zip(rig.steps, more, strict=True))
    return Rig(scanner, theta, rig.table + table, sizes)


def iterate_fit(sweep: SweepStripes, rig: Rig, times: int, points: int = FEW_POINTS) -> Rig:
    """The rig after some steps of least squares, with few points if nothing else is said."""
    for _ in range(times):
        sample = take_sample(sweep, rig.scanner, points // FEW_LINES, points)
        label = label_points(sample, rig.theta)
        if label.max(initial=-1) < 0:
            return rig
        rig = _refined(rig, wall_equations(sample, label, rig))
    return rig


def truncated_cost(sweep: SweepStripes, rig: Rig) -> tuple[float, int]:
    """Squared errors of points from their walls in sigmas, at most that of one on no wall; their number."""
    sample = take_sample(sweep, rig.scanner, FEW_POINTS // FEW_LINES, FEW_POINTS)
    label = label_points(sample, rig.theta)
    x, noise = sample.turned(rig.theta)
    square = np.full(len(x), MOST_COST)
    for k in range(int(label.max(initial=-1)) + 1):
        on = label == k
        plane = robust_plane(x[on])
        if plane is not None:
            sigma = np.hypot(noise[on] @ plane.normal, FLOOR * np.linalg.norm(x[on], axis=1))
            square[on] = np.minimum(((x[on] @ plane.normal - plane.distance) / sigma) ** 2, MOST_COST)
    return float(square.sum()), len(label)
