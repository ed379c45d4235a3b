r"""Uncertainty of a measured number by the covariances of the calibration and of the poses of stations.

A number $f = \sum_i w_i \cdot p_i$ follows the points. With a changed calibration every point keeps its pixel and its
table angle, and moves; the changes of f by the coordinates of the scanner and of the stations' poses are its effects.
"""

from typing import NamedTuple

import jax
import numpy as np

from jaxscan.errors import MeasurementError
from jaxscan.geometry import Rig, Scanner, lit_points, lit_slopes, pixels, poses, transform
from jaxscan.measurement.samples import Places, Samples


FARTHEST_OFF, LEAST_SEEN = 0.05, 0.9
"""Distance from its place on the laser's sheet, in units of its range, up to which a point is one of the calibration;
and the smallest share of such points. Calibrations of one rig differ by a hundredth of that."""
STEP = 1e-4
"""Of central differences [px, rad, m, 1]: their error is below 1e-7 of a derivative, of float64 and curvature alike."""


class Effects(NamedTuple):
    """How some numbers follow the scanner and the stations; linear, so that sums of numbers have sums of effects."""

    scanner: np.ndarray
    """By the coordinates of the scanner [numbers, parameters]; 0 where it has no covariance."""
    stations: np.ndarray
    """By a step (translation [m], rotation [rad]) of each station in its own frame [numbers, stations, 6]."""

    def weighted(self, row: np.ndarray) -> "Effects":
        """Of the sum of the numbers with these weights [numbers]."""
        return Effects((row @ self.scanner)[None], np.tensordot(row, self.stations, 1)[None])

    def plus(self, other: "Effects") -> "Effects":
        """Of the sums of numbers."""
        return Effects(self.scanner + other.scanner, self.stations + other.stations)

    def sigma(self, scanner: Scanner | None, places: Places) -> float:
        """Standard deviation of the first number, as if stations and calibration erred independently."""
        variance = float(np.einsum("si,sij,sj->", self.stations[0], places.covariance, self.stations[0]))
        if scanner is not None and scanner.covariance is not None:
            variance += float(self.scanner[0] @ np.asarray(scanner.covariance, np.float64) @ self.scanner[0])
        return float(np.sqrt(max(variance, 0.0)))


def systematic_sigma(scanner: Scanner | None, places: Places, samples: Samples, weights: np.ndarray) -> float:
    """Standard deviation of the sum of `weights` [n, 3] by the points; otherwise as `effects_of`."""
    return effects_of(scanner, places, samples, weights[None]).sigma(scanner, places)


def effects_of(scanner: Scanner | None, places: Places, samples: Samples, weights: np.ndarray) -> Effects:
    """The effects of scanner and stations in sums of points [n] with weights [numbers, n, 3].

    Raises:
        MeasurementError: If the scanner does not have the lasers of the points, or does not see them where they are.
    """
    pose = places.pose[samples.station]
    p = np.einsum("nji,nj->ni", pose[:, :3, :3], samples.p - samples.origin)
    turned = np.einsum("nji,knj->kni", pose[:, :3, :3], weights)
    by_step = np.concatenate([turned, np.cross(p, turned)], axis=-1)
    stations = np.stack([by_step[:, samples.station == k].sum(1) for k in range(len(places.covariance))], axis=1)
    if scanner is not None and samples.laser.max() >= len(scanner.laser_names):
        raise MeasurementError(
            f"The cloud has points of laser {samples.laser.max()}, and the calibration has {len(scanner.laser_names)} "
            "(counted from 0): it is not the one that the cloud was made with."
        )
    if scanner is None or scanner.covariance is None:
        count = 0 if scanner is None else len(scanner.parameter_names())
        return Effects(np.zeros((len(weights), count)), stations)
    rig: Rig = jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), scanner.rig)
    by_scanner, found = _gradients(rig, p, turned, samples.laser, samples.angle)
    _check_seen(p, found)
    return Effects(by_scanner, stations)


def _check_seen(p: np.ndarray, found: np.ndarray) -> None:
    """Check that the scanner sees the points [n, 3] where they are, as it does those of its own sheet."""
    off = np.linalg.norm(found - p, axis=1)
    # What is not a number is not near either.
    near = off <= FARTHEST_OFF * np.linalg.norm(p, axis=1)
    if np.count_nonzero(near) < LEAST_SEEN * len(p):
        raise MeasurementError(
            f"{len(p) - np.count_nonzero(near)} of {len(p)} points are not where the calibration's laser lights them: "
            "the cloud was made with another calibration, was moved, or has lost the angles of its profiles; measure "
            "it without the calibration, or take the file that jaxscan wrote."
        )


def _gradients(
    rig: Rig, p: np.ndarray, weights: np.ndarray, laser: np.ndarray, angle: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    r"""Gradients of weighted sums [numbers, parameters], and the points as the rig has them [n, 3].

    A changed camera sees a fixed point at another pixel, by $d\pi$; the point of a fixed pixel moves by
    $-S \, d\pi$ with the slopes S of `lit_slopes`. A changed sheet meets the same ray elsewhere, and a changed motion
    carries the same point elsewhere.
    """
    angles, at = np.unique(angle, return_inverse=True)
    pose, layout = poses(rig, angles)[at], rig.layout()
    lit, incidence = lit_points(rig, pixels(rig, p, angle), laser)
    p_cam = np.asarray(lit)
    range_m = np.linalg.norm(p_cam, axis=1, keepdims=True)
    ray = p_cam / np.where(range_m > 0, range_m, 1.0)
    in_camera = np.einsum("nji,knj->kni", pose[:, :3, :3], weights)
    by_pixel = np.einsum("kni,nij->knj", in_camera, lit_slopes(rig, p_cam, incidence, laser))
    along = np.einsum("kni,ni->kn", in_camera, ray)
    # Weights of the entries of a pose: few angles are shared by many points.
    held = np.zeros((len(angles), len(weights), 3, 4))
    np.add.at(held, at, np.einsum("kni,nj->nkij", weights, np.append(p_cam, np.ones((len(p), 1)), 1)))

    def change(j: int) -> np.ndarray:
        step = STEP * (np.arange(rig.parameter_count()) == j)
        ahead, behind = rig.retract(step), rig.retract(-step)
        if layout.camera.start <= j < layout.camera.stop:
            return -np.einsum("kni,ni->k", by_pixel, ahead.camera.project(p_cam) - behind.camera.project(p_cam))
        if layout.lasers.start <= j < layout.lasers.stop:
            return along @ (ahead.laser(laser).intersect(ray)[0] - behind.laser(laser).intersect(ray)[0])
        return np.einsum("akij,aij->k", held, (poses(ahead, angles) - poses(behind, angles))[:, :3])

    changes = [change(j) for j in range(rig.parameter_count())]
    return np.stack(changes, axis=1) / (2.0 * STEP), np.asarray(transform(pose, p_cam))
