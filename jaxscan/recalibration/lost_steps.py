"""Steps that a table lost: records from which on it stands elsewhere; found one after another, placed, and named.

With the right angles points lie on few walls. Walls are flat patches of the grid [profile, line], found with a
tolerance that a lost step does not break; their points give equations for the angles of the records, in which a step
stands out. A large one breaks walls, and is proposed by the turn between the normals before and behind a place too:
only both together find several large steps.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.geometry import Scanner, Turntable, points, slopes
from jaxscan.geometry.motions import ANGLE_PARAMETERS
from jaxscan.leastsq import MEDIAN_TO_SIGMA
from jaxscan.measurement.planes import Plane, facing, weighted_plane
from jaxscan.measurement.systematic import point_gradient
from jaxscan.recalibration.grid import Windows, smooth_parts, spread_over, window_planes
from jaxscan.recalibration.observed import SweepStripes
from jaxscan.recalibration.result import TableFindings


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
    """Turn about the axis from normals `b` to normals `a`, and their difference of tilt [rad]."""
    turned = np.arctan2(a[..., 1], a[..., 0]) - np.arctan2(b[..., 1], b[..., 0])
    tilt = np.arcsin(np.clip(a[..., 2], -1, 1)) - np.arcsin(np.clip(b[..., 2], -1, 1))
    return np.asarray((turned + np.pi) % (2 * np.pi) - np.pi), np.asarray(tilt)


SPREAD = (
    {"fx": 20.0, "fy": 20.0, "cx": 20.0, "cy": 20.0, "k1": 0.05, "k2": 0.1, "k3": 0.3, "p1": 2e-3, "p2": 2e-3}
    | {"n1": 3e-3, "n2": 3e-3, "d": 2e-3, "b2": 3e-3, "b3": 3e-3}
    | {"axis.d1": 5e-3, "axis.d2": 5e-3, "axis.p1": 3e-3, "axis.p2": 3e-3}
)
"""How far a coordinate of a poor calibration may be from the truth [px, rad, m]; 0.1 for others."""


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
        """Covariance of the unknowns."""
        normal = self.nuisance.T @ self.nuisance + np.diag(1.0 / self.sigma**2)
        scale = np.sqrt(np.diag(normal))
        return np.linalg.inv(normal / np.outer(scale, scale)) / np.outer(scale, scale)


class StepTest(NamedTuple):
    """The step that each record would need."""

    size: Float[np.ndarray, " records"]
    """Angle by which this and all later records stand ahead of their angle [rad]."""
    sigma: Float[np.ndarray, " records"]
    """Its standard deviation; infinite where the data do not determine it [rad]."""
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
"""Size of the grid of each laser on which patches are found."""
FLOOR = 1e-4
"""Standard deviation of a point from its wall, beside noise, as a part of its range."""
HARMONICS = 3
"""Errors of the table that repeat up to this many times per turn are no lost steps."""
STEP_SPREAD = 0.1
"""How large a lost step may be [rad]."""
GAIN, WAVES = 1e-3, 7e-4
"""How far gain and waves may be from the calibration's [1, rad]."""
FEW_POINTS, FEW_LINES = 6_000, 15
"""Numbers of points and lines with which the rig is refined."""
MOST_COST = 25.0
"""Largest cost of one point in `truncated_cost`."""
ROBUST = 4.0
"""Sigmas at which the weight of a point is a quarter."""
MOST_SHIFT = 300.0
"""Largest shift of a stripe onto its wall, in sigmas."""


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
        """A rig that begins with the angles of the journal [rad]."""
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
    """Points of at most this many profiles, on as many lines as the number of points then allows."""
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


def _walls(x: np.ndarray, label: Int[np.ndarray, " points"]) -> Iterator[tuple[Plane, Bool[np.ndarray, " points"]]]:
    """The plane of each wall that has one, and which points are on the wall."""
    for wall in range(int(label.max(initial=-1)) + 1):
        on = label == wall
        plane = robust_plane(x[on])
        if plane is not None:
            yield plane, on


def wall_equations(sample: Sample, label: Int[np.ndarray, " points"], rig: Rig, robust: bool = True) -> Equations:
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
    for plane, on in _walls(x, wall):
        m, k = plane.normal, wall[np.argmax(on)]
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
    """The rig after some steps of least squares, with few points by default."""
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
    for plane, on in _walls(x, label):
        sigma = np.hypot(noise[on] @ plane.normal, FLOOR * np.linalg.norm(x[on], axis=1))
        square[on] = np.minimum(((x[on] @ plane.normal - plane.distance) / sigma) ** 2, MOST_COST)
    return float(square.sum()), len(label)


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
# Steps undo each other if their sum is within so many standard deviations, though each step is many of them.
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
"""Numbers of profiles and points in which a step is looked for."""
LAST_TIMES, MANY_POINTS = 4, 24_000
"""Iterations and points with which the sizes of all steps are found in the end."""
LEAST_Z = 7.0
"""How many of its sigmas a step must have, with some thousand places where chance could make one."""
PLACED = (4, 3, 3)
"""Steps of least squares before the record of a step is sought once more, until it stays."""
LEAST_GAIN = 0.3
"""Least amount by which a large step lowers the truncated cost, for each point [1]."""
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
        # A large step divides walls, and no linear equation gives its size: breaks are tried one by one.
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
    """The rig with one more step, after the fit has converged, at the record that its points determine."""
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
    """The rig with one more step that brings the most points to walls, if clearly more than without the step."""
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
"""Least number of lines on which the wall is seen on both sides."""
APART, MOST_BREAKS = 6, 3
"""Cells between two breaks that are proposed, and how many are."""


def propose_steps(sweep: SweepStripes, rig: Rig) -> list[tuple[int, float]]:
    """Records at which walls break by a turn about the axis, and that turn [rad], the largest first.

    Normals before and behind a place are compared line by line, and their median is taken. The edge of a cupboard
    breaks a wall too: every proposal has to be tried.
    """
    sample = take_sample(sweep, rig.scanner, PROFILES, PROFILES * LINES)
    # Few profiles with stripes may all lie between those of the sample.
    own = np.flatnonzero(sample.laser == sample.laser[:1])
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
"""Turn on each side of a step in which the walls are fitted that determine its record."""
LEAST_POINTS = 12
"""Least number of points on a wall there."""
MANY_LINES = 120
WALL_PROFILES, WALL_POINTS = 720, 12_000
"""Numbers of profiles and points with which walls are found."""
UNSURE = 9.0
"""A record is still possible if its squared errors in sigmas exceed those of the best by no more than this."""


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
    # The cost of a step at `low`, low + 1 ... high: all records from there on stand as after it.
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
