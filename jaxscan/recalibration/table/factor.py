"""A wrong number of steps per turn: with the right one, points lie on few planes."""

import numpy as np
from jaxtyping import Float

from jaxscan.recalibration.observed import SweepStripes
from jaxscan.recalibration.table.walls import Rig, Sample, settle, start_rig, take_sample, turn


SEEDS, SPAN, HALF, LEAST_HALF = 48, np.deg2rad(8.0), 3, 2
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
    x, noise = turn(theta[sample.record], sample.x), turn(theta[sample.record], sample.noise)
    profiles, place = np.unique(sample.profile, return_inverse=True)
    angle = np.zeros(len(profiles))
    angle[place] = theta[sample.record]
    normal, distance = _propose(x, place, angle)
    if len(normal) == 0:
        return 0.0
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
        refined = _planes(x[mine][None])
        for m, d in zip(*refined, strict=True):
            again = left & (np.abs(x @ m - d) < np.abs(along @ m) * limit)
            mine = again if again.sum() > mine.sum() else mine
        score += mine.mean() ** 2
        left &= ~mine
    return float(score)


def find_factor(sweep: SweepStripes, rig: Rig) -> float:
    """The factor of the journal's angles with which points lie on the fewest planes; 1 where none is better.

    A scan over usual ratios gives first values, also with a poor calibration, which bends walls much as a wrong factor
    does; least squares with the whole rig free brings them nearer.
    """
    if len(np.unique(sweep.record)) < 2 * HALF + 1:
        return 1.0
    # Between coarse steps no plane fits into the turn with the journal's own angles, and any smaller factor would look
    # better.
    if np.median(np.abs(np.diff(rig.theta))) > SPAN / (2 * LEAST_HALF):
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
    start = start_rig(rig.scanner, factor * rig.theta)
    sample = take_sample(sweep, rig.scanner, 1_200, 9_600)
    before = concentration(sample, start.theta)
    found = settle(sweep, start, TIMES)
    after = concentration(take_sample(sweep, found.scanner, 1_200, 9_600), found.theta)
    return (found, after) if after >= before else (start, before)


def _propose(x: np.ndarray, place: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Planes through windows of some profiles, SPAN wide."""
    # Points are in the order of their profiles.
    starts = np.searchsorted(place, np.arange(len(angle) + 1))
    step = np.median(np.abs(np.diff(angle))) if len(angle) > 1 else 0.0
    if step == 0:
        return np.zeros((0, 3)), np.zeros(0)
    apart = max(1, round(SPAN / (2 * HALF) / step))
    half = int(np.clip(SPAN / 2 / step, LEAST_HALF, HALF))
    reach = apart * half
    if 2 * reach + 1 > len(angle):
        return np.zeros((0, 3)), np.zeros(0)
    middles = np.unique(np.linspace(reach, len(angle) - 1 - reach, SEEDS).round().astype(int))
    normals, distances = [], []
    for middle in middles:
        rows = np.concatenate([x[starts[k] : starts[k + 1]] for k in range(middle - reach, middle + reach + 1, apart)])
        if len(rows) < 12:
            continue
        normal, distance = _planes(rows[None])
        normals.append(normal)
        distances.append(distance)
    if not normals:
        return np.zeros((0, 3)), np.zeros(0)
    return np.concatenate(normals), np.concatenate(distances)


def _planes(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    centre = x.mean(axis=1)
    spread = x - centre[:, None]
    _, vectors = np.linalg.eigh(np.swapaxes(spread, 1, 2) @ spread)
    normal = vectors[..., 0]
    return normal, np.sum(normal * centre, axis=1)
