"""A small known room: exact stripes of its walls, made by the simulator, as observations of an adjustment."""

from functools import lru_cache
from pathlib import Path

import equinox as eqx
import jax
import numpy as np

import jaxscan
from experiments.recalibration.world import Noise, Sweeping, TrueSweep, true_sweep
from jaxscan.geometry import Scanner
from jaxscan.recalibration import RoomObservations, SurfacePoints, Surfaces, SweepStripes
from jaxscan.recalibration.triangulate import triangulate_points
from jaxscan.simulation import SimulationConfig
from jaxscan.simulation.sweep import true_scanner


CONFIG = Path(__file__).resolve().parents[2] / "configs" / "paper.toml"
# About the sigmas after 23 views of boards: fx, fy, cx, cy; k1, k2, p1, p2, k3; sheet; bow held; axis; gain; harmonics.
SIGMA = np.array(
    [2.0, 2.0, 3.0, 3.0, 3e-3, 1e-2, 4e-4, 4e-4, 1e-2]
    + [1e-3, 1e-3, 5e-4, 0.0, 0.0]
    + [1e-3, 1e-3, 5e-4, 5e-4, 1e-3, 3e-4, 3e-4, 3e-4, 3e-4]
)


def config() -> SimulationConfig:
    """The paper's rig in its room."""
    return jaxscan.load_simulation(CONFIG)


@lru_cache(maxsize=4)
def exact_sweep(steps: int = 90, line_stride: int = 48) -> tuple[SweepStripes, TrueSweep]:
    """Stripes without noise."""
    return true_sweep(config(), 1, Sweeping(steps=steps, line_stride=line_stride, furniture=False, noise=Noise(px=0.0)))


def stored(truth: Scanner, random: np.random.Generator, sigma: np.ndarray = SIGMA) -> Scanner:
    """A stored calibration whose errors are drawn from its covariance, which has correlations."""
    mix = np.random.default_rng(5).standard_normal((len(sigma), len(sigma)))
    mix = np.eye(len(sigma)) + 0.1 * mix
    mix = mix / np.linalg.norm(mix, axis=1, keepdims=True)
    root = sigma[:, None] * mix
    with jax.enable_x64(True):
        moved = jax.tree.map(np.asarray, truth.retract(root @ random.standard_normal(len(sigma))))
    return with_covariance(moved, root @ root.T)


def with_covariance(scanner: Scanner, covariance: np.ndarray) -> Scanner:
    """The same scanner with a covariance."""
    return eqx.tree_at(lambda s: s.covariance, scanner, covariance, is_leaf=lambda leaf: leaf is None)


def observe(
    scanner: Scanner, noise: np.ndarray | float = 0.0, sigma_px: float = 0.1, sweep_truth=None
) -> RoomObservations:
    """Points of the walls with noise [px], and planes fitted to them with a scanner."""
    sweep, truth = sweep_truth or exact_sweep()
    profile, line = np.nonzero(truth.surface >= 0)
    u = truth.centre[profile, line] + noise
    q = np.stack([u, line.astype(float)], 1)
    _, surface = np.unique(truth.surface[profile, line], return_inverse=True)
    points = SurfacePoints(
        q=q,
        sigma=np.full(len(q), sigma_px),
        sweep=np.zeros(len(q), int),
        record=sweep.record[profile],
        line=line,
        laser=sweep.laser[profile],
        surface=surface,
    )
    where, _ = triangulate_points(scanner, q, points.laser, sweep.angle[points.record])
    return RoomObservations(points, planes_of(where, surface), (sweep.angle,), np.zeros(1, int), sweep.stripe_axis)


def planes_of(where: np.ndarray, surface: np.ndarray) -> Surfaces:
    """Planes through points."""
    normals, centres = [], []
    for number in range(surface.max() + 1):
        mine = where[surface == number]
        centres.append(mine.mean(0))
        normals.append(np.linalg.svd(mine - mine.mean(0), full_matrices=False)[2][2])
    normal, centre = np.array(normals), np.array(centres)
    return Surfaces(normal, (normal * centre).sum(1), centre)


def truth_scanner() -> Scanner:
    """The true scanner."""
    return true_scanner(config())
