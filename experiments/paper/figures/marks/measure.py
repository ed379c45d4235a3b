"""Distances between marks, in our cloud and in that of the paper's method."""

from typing import NamedTuple

import jax
import numpy as np

import jaxscan
from experiments.paper.figures.marks import finder
from experiments.paper.methods import paper_way
from jaxscan.stripes import NoiseModel


LENGTH_MM = 300.0


class Plain(NamedTuple):
    """The stripe of a sweep by a plain finder."""

    u: np.ndarray
    """Column [records, rows], px."""
    valid: np.ndarray
    """bool [records, rows]."""
    grey: np.ndarray
    """The laser-off image at the centres [records, rows], DN."""


class Measured(NamedTuple):
    """Distances in one cloud."""

    centres: finder.Centres
    distances: np.ndarray
    """[pairs], mm."""
    beside: np.ndarray
    """Horizontal pairs, bool [pairs]; the others are vertical."""
    numbers: np.ndarray
    """Both centres of each pair [pairs, 2]."""
    picked: np.ndarray
    """The same distances between points of the cloud [pairs], mm."""

    def predicted(self) -> np.ndarray:
        """Standard deviation of each distance from the noise of the points [pairs], mm."""
        axis = np.where(self.beside, 0, 1)
        both = self.centres.sigma[self.numbers, axis[:, None]]
        return 1000 * np.sqrt(np.sum(both**2, axis=1))


def measure_ours(cloud: jaxscan.PointCloud, scanner: jaxscan.Scanner, noise: NoiseModel) -> Measured:
    """Marks in our cloud, with their predicted uncertainty."""
    xyz, valid = np.asarray(cloud.xyz, np.float64), np.asarray(cloud.valid)
    grey = np.asarray(cloud.rgb, np.float64).mean(-1)
    poses = np.asarray(jax.vmap(scanner.pose)(np.asarray(cloud.angle)), np.float64)
    ray, sigma = xyz - poses[:, None, :3, 3], np.asarray(cloud.sigma_random, np.float64)
    far = np.maximum(np.linalg.norm(ray, axis=-1), 1e-9)
    # A smoothed point has the colour at the centre of its own row, which lies aside of it along the row. A change of
    # range moves the centre by d / (n_x range) times as much.
    own = sigma if cloud.sigma_row is None else np.asarray(cloud.sigma_row, np.float64)
    sheet = np.asarray(scanner.lasers.distance).ravel()[0] / abs(np.asarray(scanner.lasers.normal).reshape(-1, 3)[0, 0])
    wide = np.sqrt(np.maximum(own**2 - sigma**2, 0)) * sheet / far
    aside = wide[..., None] * poses[:, None, :3, 0]
    ray *= (sigma / far)[..., None]
    shared = np.ones(valid.shape) if cloud.shared_lines is None else np.asarray(cloud.shared_lines)
    # A grey value is a mean of two pixels, on average of two thirds of the variance of one.
    level = np.sqrt(noise.variance(np.median(grey[valid])) * 2 / 3 + 1 / 12)
    return _measured((xyz, valid, grey), np.array([0.0, 0.0, 1.0]), finder.Noise(ray, shared, aside, float(level)))


def measure_paper_way(seen: Plain, ways: list[paper_way.PaperWay], angles: np.ndarray) -> list[Measured]:
    """Marks in the paper's cloud, by several calibrations of the same camera."""
    out = []
    for way in ways:
        xyz = paper_way.cloud(way, seen.u, seen.valid, angles)
        valid = np.isfinite(xyz).all(-1)
        out.append(_measured((np.where(valid[..., None], xyz, 0), valid, seen.grey), np.array([0.0, -1.0, 0.0]), None))
    return out


def _measured(
    coloured: tuple[np.ndarray, np.ndarray, np.ndarray],
    up: np.ndarray,
    noise: finder.Noise | None,
) -> Measured:
    """Distances in a cloud of positions [profiles, lines, 3], which exist, and grey values."""
    xyz, valid, grey = coloured
    plane, edges = finder.fit_wall(xyz, valid, up), finder.find_edges(grey, valid)
    centres = finder.find_centres(xyz, valid, edges, plane, noise)
    number, beside = finder.pairs(centres.place, LENGTH_MM / 1000, 0.03)
    picked = finder.picked_points(xyz, valid, plane, centres)
    lengths = [1000 * np.linalg.norm(np.diff(each[number], axis=1)[:, 0], axis=-1) for each in (centres.place, picked)]
    return Measured(centres, lengths[0], beside, number, lengths[1])
