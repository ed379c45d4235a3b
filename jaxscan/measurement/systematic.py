r"""Uncertainty of a measured number by the covariances of the calibration and of the poses of stations.

A number $f = \sum_i w_i \cdot p_i$ follows the points. With a changed calibration every point keeps its pixel and its
table angle, and moves; the changes of f by the coordinates of the scanner and of the stations' poses are its effects.
"""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from jaxscan.errors import MeasurementError
from jaxscan.geometry import Rig, Scanner, lit_points, lit_slopes, pixels, points, poses, transform
from jaxscan.measurement.samples import Places, Samples, check_path


FARTHEST_OFF, LEAST_SEEN = 0.05, 0.9
"""Distance from its place on the laser's sheet, in units of its range, up to which a point is one of the calibration;
and the smallest share of such points. Calibrations of one rig differ by a hundredth of that."""
STEP = 1e-3
"""Step of central differences, in units of the parameters."""


class Effects(NamedTuple):
    """How some numbers follow the scanner and the stations; linear, so that sums of numbers have sums of effects."""

    scanner: np.ndarray
    """Effect of each coordinate of the scanner [numbers, parameters]; 0 where it has no covariance."""
    stations: np.ndarray
    """Effect of a step (translation [m], rotation [rad]) of each station in its own frame [numbers, stations, 6]."""

    def weighted(self, row: np.ndarray) -> "Effects":
        """Effects in the sum of the numbers with these weights [numbers]."""
        return Effects((row @ self.scanner)[None], np.tensordot(row, self.stations, 1)[None])

    def plus(self, other: "Effects") -> "Effects":
        """Effects in the sums of numbers."""
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
        MeasurementError: If the scanner does not have the lasers of the points, or does not see them where they are, or
            rides on a hand whose poses are not there.
    """
    check_path(scanner, samples.angle)
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
    q = np.asarray(pixels(rig, p, samples.angle))
    _check_seen(p, np.asarray(points(rig, q, samples.laser, samples.angle)))
    by_scanner = point_gradient(rig, q, samples.laser, samples.angle)
    return Effects(np.einsum("kni,nip->kp", turned, by_scanner, optimize=True), stations)


def _check_seen(p: np.ndarray, found: np.ndarray) -> None:
    """Check that the scanner sees the points [n, 3] where they are, as it does those of its own sheet."""
    off = np.linalg.norm(found - p, axis=1)
    # NaN does not count as near.
    near = off <= FARTHEST_OFF * np.linalg.norm(p, axis=1)
    if np.count_nonzero(near) < LEAST_SEEN * len(p):
        raise MeasurementError(
            f"{len(p) - np.count_nonzero(near)} of {len(p)} points are not where the calibration's laser lights them: "
            "the cloud was made with another calibration, was moved, or has lost the angles of its profiles; measure "
            "it without the calibration, or take the file that jaxscan wrote."
        )


def point_gradient(
    rig: Rig, q: Float[np.ndarray, "n 2"], laser: Int[np.ndarray, " n"], phi: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 3 params"]:
    """Derivatives of points in the scanner's frame by its minimal coordinates [m / px, m / rad, 1]; on the host.

    Central differences of what has a closed form: where a point is seen, its offset from its sheet, the pose. A point
    stays on the ray of its pixel and on its sheet, so a camera that sees it elsewhere moves it as that pixel does.
    """
    layout, phi = rig.layout(), np.asarray(phi, np.float64)
    p_cam, incidence = lit_points(rig, q, laser)
    hits = incidence > 0
    by_q, normal = lit_slopes(rig, p_cam, incidence, laser), rig.laser(laser).slope(p_cam)
    along = np.where(hits, np.sum(normal * p_cam, axis=-1), 1.0)
    position, place = np.unique(phi, return_inverse=True)
    found = np.zeros((len(p_cam), 3, len(layout.names)))
    for k, block in enumerate(layout.blocks):
        step = np.zeros(len(layout.names))
        step[k] = STEP * block.scale
        forth, back = rig.retract(step), rig.retract(-step)
        change = lambda of, forth=forth, back=back, size=step[k]: (of(forth) - of(back)) / (2.0 * size)
        if layout.turntable.start <= k < layout.turntable.stop:
            found[..., k] = transform(change(lambda rig: poses(rig, position))[place], p_cam)
        elif k >= layout.lasers.start:
            mine = np.flatnonzero(hits & (laser == (k - layout.lasers.start) // 5))
            offset = change(lambda rig, mine=mine: rig.laser(laser[mine]).offset(p_cam[mine]))
            found[mine, :, k] = p_cam[mine] * (-offset / along[mine])[:, None]
        else:
            seen = np.where(hits[:, None], change(lambda rig: rig.camera.project(p_cam)), 0.0)
            found[..., k] = -np.einsum("nij,nj->ni", by_q, seen)
    moving, rotation = layout.turntable.start, poses(rig, position)[place][:, :3, :3]
    found[..., :moving] = rotation @ found[..., :moving]
    return found
