"""An adjustment to walls as linear least squares with a known truth: theory can be checked with it."""

from functools import lru_cache
from typing import NamedTuple

import jax
import numpy as np

from jaxscan.geometry import Scanner, slopes
from jaxscan.measurement.systematic import point_gradient
from jaxscan.recalibration import Adjusted, RoomObservations
from jaxscan.recalibration.triangulate import triangulate_points

from .small_room import exact_sweep, observe, truth_scanner, with_covariance


# Of a good calibration, whose axis and sheet are known to a fraction of a drift; the bow is held.
GOOD = np.array(
    [0.2, 0.2, 0.1, 0.1, 5e-4, 2e-3, 1e-5, 1e-5, 5e-3]
    + [3e-5, 3e-5, 1e-5, 0.0, 0.0]
    + [3e-5, 3e-5, 2e-5, 2e-5, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4]
)
WALL_M = 2e-4


class LinearRoom(NamedTuple):
    """The information that a sweep has on the scanner, planes eliminated."""

    scanner: Scanner
    """With the prior's covariance."""
    observations: RoomObservations
    information: np.ndarray

    @property
    def prior(self):
        return np.asarray(self.scanner.covariance)

    @property
    def names(self):
        return self.scanner.parameter_names()

    def posterior(self, prior=None):
        prior = self.prior if prior is None else prior
        root = _root(prior)
        return root @ np.linalg.inv(np.eye(len(root)) + root.T @ self.information @ root) @ root.T

    def departure(self, random, move=0.0, prior=None):
        """Step of a solve with a prior, and the error of its result, where the rig moved since."""
        truth = _root(self.prior) @ random.standard_normal(len(self.prior)) + move
        after = self.posterior(prior)
        noise = _root(self.information) @ random.standard_normal(len(truth))
        step = after @ (self.information @ truth + noise)
        return step, step - truth

    def moved(self, **changes):
        """A move by names, dots as underscores."""
        step = np.zeros(len(self.names))
        for name, change in changes.items():
            step[self.names.index(name.replace("_", "."))] = change
        return step


@lru_cache(maxsize=2)
def linear_room(points: float = 10.0) -> LinearRoom:
    """The room of the small sweep, with as much information as `points` times its points have."""
    scanner = truth_scanner()
    observed = observe(scanner)
    own, sweep = observed.points, exact_sweep()[0]
    phi = sweep.angle[own.record]
    by_scanner = point_gradient(scanner.rig, own.q, own.laser, phi)
    by_q = slopes(scanner.rig, own.q, own.laser, phi)
    place, _ = triangulate_points(scanner, own.q, own.laser, phi)
    names = scanner.parameter_names()
    information = np.zeros((len(names), len(names)))
    for number, normal in enumerate(observed.surfaces.normal):
        mine = own.surface == number
        sigma = np.hypot(by_q[mine, :, 0] @ normal * own.sigma[mine], WALL_M)
        arm = place[mine] - place[mine].mean(0)
        plane = np.column_stack([arm - (arm @ normal)[:, None] * normal, np.ones(len(arm))]) / sigma[:, None]
        left, size, _ = np.linalg.svd(plane, full_matrices=False)
        left = left[:, size > 1e-9 * size[0]]
        rows = np.einsum("nip,i->np", by_scanner[mine], normal) / sigma[:, None]
        rows = rows - left @ (left.T @ rows)
        information += points * rows.T @ rows
    return LinearRoom(with_covariance(scanner, np.diag(GOOD**2)), observed, information)


def with_held(scanner: Scanner, step: np.ndarray) -> Scanner:
    """The scanner moved by a step; it keeps its covariance."""
    with jax.enable_x64(True):
        moved = jax.tree.map(np.asarray, scanner.retract(step))
    return with_covariance(moved, np.asarray(scanner.covariance))


def adjusted_of(scanner: Scanner, observations: RoomObservations, **changes) -> Adjusted:
    """A finished adjustment that found a scanner."""
    points = len(observations.points.q)
    values = {
        "scanner": scanner,
        "prior": scanner,
        "departure": np.zeros(len(scanner.parameter_names())),
        "stations": np.eye(4)[None],
        "station_covariance": np.zeros((1, 6, 6)),
        "surfaces": observations.surfaces,
        "corrections": tuple(np.zeros(len(angle)) for angle in observations.angles),
        "point_error": np.zeros(points),
        "point_sigma": np.full(points, 1e-3),
        "point_kept": np.ones(points, bool),
        "track_kept": np.zeros(0, bool),
        "wall_m": WALL_M,
        "inflation": 1.0,
        "observations": observations,
        "cost": float(points),
        "freedom": points,
        "converged": True,
        "steps": 5,
    }
    return Adjusted(**(values | changes))


def _root(matrix):
    unit = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    scale = np.where(unit > 0, unit, 1.0)
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    return unit[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
