"""Poses of one station in the frame of another that bring walls onto walls: guesses, to be tested by all points."""

import numpy as np

from jaxscan.recalibration.stations.view import View


SAME_DIRECTION = np.cos(np.radians(8.0))
"""Normals this near belong to one direction."""
DIRECTIONS = 12
LEAST_SHARE = 0.02
"""Smallest share of all patches that face one direction."""
ANGLES_AGREE = np.radians(6.0)
TILT = np.cos(np.radians(12.0))
"""Axes of two stations are at most this far from parallel."""
ROTATIONS = 12
DISTINCT_TURN = np.radians(6.0)
BIN_M = 0.04
SHIFTS = 6
"""Shifts along each direction that are tried."""
REACH_M = 30.0
"""Largest shift between two stations, along each direction."""


def guess_poses(one: View, other: View) -> np.ndarray:
    """T_one_other [n, 4, 4] that match directions of walls, and along each direction their places.

    None where the walls of either leave a turn open.
    """
    poses = []
    for rotation in _rotations(one, other):
        turned = View(*(field @ rotation.T for field in other))
        axes = _axes(one, turned)
        if axes is None:
            continue
        shifts = [_shifts(one, turned, axis) for axis in axes]
        grid = np.stack(np.meshgrid(*shifts, indexing="ij"), -1).reshape(-1, 3)
        T = np.tile(np.eye(4), (len(grid), 1, 1))
        T[:, :3, :3] = rotation
        T[:, :3, 3] = np.linalg.solve(axes, grid.T).T
        poses.append(T)
    return np.concatenate(poses) if poses else np.zeros((0, 4, 4))


def directions(normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Directions [k, 3] in which many patches face, and the share of each [k], largest first."""
    left = np.ones(len(normals), bool)
    found: list[np.ndarray] = []
    shares: list[float] = []
    near = normals @ normals.T > SAME_DIRECTION
    while left.any() and len(found) < DIRECTIONS:
        best = int(np.argmax((near & left).sum(1)))
        members = near[best] & left
        if members.sum() < max(3, LEAST_SHARE * len(normals)):
            break
        mean = normals[members].mean(0)
        found.append(mean / np.linalg.norm(mean))
        shares.append(float(members.mean()))
        left &= ~members
    return np.array(found).reshape(-1, 3), np.array(shares)


def _rotations(one: View, other: View) -> list[np.ndarray]:
    """Rotations that bring two directions of the other onto two of the one, best first."""
    (to, to_share), (of, of_share) = directions(one.normals), directions(other.normals)
    if len(to) < 2 or len(of) < 2:
        return []
    to_pairs, to_angle = _pairs(to)
    of_pairs, of_angle = _pairs(of)
    same = np.abs(to_angle[:, None] - of_angle[None]) < ANGLES_AGREE
    i, j = np.nonzero(same)
    rotation = _frames(to, to_pairs)[i] @ _frames(of, of_pairs)[j].swapaxes(1, 2)
    rotation = rotation[rotation[:, 2, 2] > TILT]
    agree = np.einsum("nij,kj,li->nlk", rotation, of, to) > SAME_DIRECTION
    votes = (np.minimum(to_share[:, None], of_share[None]) * agree).sum((1, 2))
    kept: list[np.ndarray] = []
    for k in np.argsort(-votes, kind="stable"):
        if len(kept) < ROTATIONS and all(turn_between(rotation[k], each) > DISTINCT_TURN for each in kept):
            kept.append(rotation[k])
    return kept


def _pairs(directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ordered pairs of directions that are far from parallel [n, 2], and the angle of each [n], rad."""
    angle = np.arccos(np.clip(directions @ directions.T, -1, 1))
    pairs = np.argwhere((angle > np.radians(40)) & (angle < np.radians(140)))
    return pairs, angle[tuple(pairs.T)]


def _frames(directions: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """A frame [n, 3, 3] for each pair: both directions share its turn alike."""
    a, b = directions[pairs[:, 0]], directions[pairs[:, 1]]
    x, y = a + b, a - b
    x, y = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (x, y))
    return np.stack([x, y, np.cross(x, y)], -1)


def turn_between(a: np.ndarray, b: np.ndarray) -> float:
    """Angle of the turn from rotation `a` to `b` [rad]."""
    return float(np.arccos(np.clip((np.trace(a.T @ b) - 1) / 2, -1, 1)))


def _axes(one: View, turned: View) -> np.ndarray | None:
    """Three directions [3, 3] across which both see walls, as far apart as they can be.

    Where there are walls in two directions alone the third is at right angles to them; None with fewer.
    """
    ours, share = directions(np.concatenate([one.normals, -one.normals]))
    theirs = np.abs(turned.normals @ ours.T) > SAME_DIRECTION
    share = np.minimum(share, theirs.mean(0))
    axes: list[np.ndarray] = []
    for k in np.argsort(-share, kind="stable"):
        trial = np.array([*axes, ours[k]])
        if share[k] > LEAST_SHARE / 2 and np.linalg.svd(trial)[1][-1] > 0.4 and len(axes) < 3:
            axes.append(ours[k])
    if len(axes) < 2:
        return None
    if len(axes) == 2:
        across = np.cross(axes[0], axes[1])
        axes.append(across / np.linalg.norm(across))
    return np.array(axes)


def _shifts(one: View, turned: View, axis: np.ndarray) -> np.ndarray:
    """Shifts [k] of the other along `axis` that bring walls onto walls that face the same way [m]."""
    size = int(REACH_M / BIN_M)
    score = np.zeros(2 * size + 1)
    for sense in (1.0, -1.0):
        lines = []
        for view in (one, turned):
            facing = sense * view.normals @ axis > SAME_DIRECTION
            place = np.round(view.patches[facing] @ axis / BIN_M).astype(int)
            count = np.bincount(np.clip(place + size, 0, 2 * size), minlength=2 * size + 1).astype(float)
            count[[0, -1]] = 0
            # A wall that lies between two bins is in both; the root keeps one large wall from deciding alone.
            lines.append(np.sqrt(np.convolve(count, [0.5, 1.0, 0.5], "same")))
        score += _correlation(lines[0], lines[1], size)
    found: list[int] = []
    while len(found) < SHIFTS and score.max() > 0:
        best = int(score.argmax())
        found.append(best)
        score[max(0, best - 3) : best + 4] = 0
    return (np.array(found, float) - size) * BIN_M if found else np.zeros(1)


def _correlation(to: np.ndarray, of: np.ndarray, size: int) -> np.ndarray:
    """sum_x to(x) of(x - s) for s from -size to size."""
    n = 1 << int(np.ceil(np.log2(2 * len(to))))
    full = np.fft.irfft(np.fft.rfft(to, n) * np.conj(np.fft.rfft(of, n)), n)
    return np.maximum(full[np.arange(-size, size + 1)], 0.0)
