"""A guessed pose, settled on the flat patches that both stations see: point to plane."""

from typing import NamedTuple

import numpy as np

from jaxscan.geometry import compose, exponential
from jaxscan.leastsq import MEDIAN_TO_SIGMA
from jaxscan.recalibration.stations.view import View


NEAR_M = (0.5, 0.35, 0.25, 0.25, 0.2, 0.2, 0.2, 0.2)
"""Patches whose middles are at most this far apart are compared, round after round."""
FACING = np.cos(np.radians(20.0))
FEW = 500
"""Patches of a station that are used while there are many guesses."""


class Settled(NamedTuple):
    """A pose and how well patches agree in it."""

    pose: np.ndarray
    """T_one_other [4, 4]."""
    matched: int
    """Pairs of patches that were compared."""
    scale_m: float
    """Robust standard deviation of their distances [m]."""
    weakest: float
    """Smallest share of the information that any direction of the shift has [1]; 1/3 where all have the same."""


def settle(one: View, other: View, pose: np.ndarray, *, few: bool = False) -> Settled:
    """Move `pose` (T_one_other) until the patches of both lie in each other's planes.

    Args:
        one: The station that stays.
        other: The station that moves.
        pose: T_one_other [4, 4].
        few: Use some of the patches only.
    """
    step = max(1, -(-len(other.patches) // FEW)) if few else 1
    p, n = other.patches[::step], other.normals[::step]
    pose = pose.copy()
    apart, normals = np.zeros(0), np.zeros((0, 3))
    for near in NEAR_M:
        at, facing = p @ pose[:3, :3].T + pose[:3, 3], n @ pose[:3, :3].T
        index, close = _nearest(one, at, facing, near)
        if close.sum() < 12:
            return Settled(pose, 0, np.inf, 0.0)
        at, mean = at[close], one.normals[index[close]] + facing[close]
        normals = mean / np.linalg.norm(mean, axis=1, keepdims=True)
        apart = np.sum(normals * (one.patches[index[close]] - at), 1)
        scale = max(MEDIAN_TO_SIGMA * float(np.median(np.abs(apart))), 1e-3)
        weight = 1 / (1 + (apart / (2 * scale)) ** 2) ** 2
        design = np.column_stack([normals, np.cross(at, normals)])
        equations = (design * weight[:, None]).T @ design
        # Directions that no observation holds stay where they are.
        equations += 1e-3 * np.trace(equations) / 6 * np.eye(6)
        pose = _moved(pose, np.linalg.solve(equations, (design * weight[:, None]).T @ apart))
    share = np.linalg.eigvalsh(normals.T @ normals / len(normals))[0]
    return Settled(pose, len(apart), MEDIAN_TO_SIGMA * float(np.median(np.abs(apart))), float(share))


def _nearest(one: View, at: np.ndarray, facing: np.ndarray, near: float) -> tuple[np.ndarray, np.ndarray]:
    """For each patch the nearest of the station that faces the same way [m], and whether it is near."""
    p, q = at.astype(np.float32), one.patches.astype(np.float32)
    square = (p * p).sum(1)[:, None] + (q * q).sum(1)[None] - 2 * p @ q.T
    square += np.where(facing.astype(np.float32) @ one.normals.astype(np.float32).T > FACING, 0, 1e6)
    index = square.argmin(1)
    return index, square[np.arange(len(p)), index] < near**2


def _moved(pose: np.ndarray, step: np.ndarray) -> np.ndarray:
    """The pose after a small shift [m] and turn [rad] in the frame that stays."""
    moved = np.asarray(compose(exponential(np.append(np.zeros(3), step[3:])), pose))
    moved[:3, 3] += step[:3]
    return moved
