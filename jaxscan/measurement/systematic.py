"""Uncertainty of a measured number by the covariances of the calibration and of the poses of stations."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxscan.compiling import compile_quickly
from jaxscan.errors import MeasurementError
from jaxscan.geometry import Array, Rig, Scanner, pixels, points
from jaxscan.measurement.samples import Places, Samples


FARTHEST_OFF, LEAST_SEEN = 0.05, 0.9
"""Distance from its place on the laser's sheet, in units of its range, up to which a point is one of the calibration;
and the smallest share of such points. Calibrations of one rig differ by a hundredth of that."""
BLOCK = 4096
"""Points are padded to a multiple of this, so that one compiled function serves all."""


def systematic_sigma(scanner: Scanner | None, places: Places, samples: Samples, weights: np.ndarray) -> float:
    r"""Standard deviation of $f = \sum_i w_i \cdot p_i$ from `scanner.covariance` and those of the stations' poses.

    With a changed calibration every point keeps its pixel q and its table angle, and moves to
    $p_i(\delta) = \mathrm{point}(q_i;\,\mathrm{retract}(\delta))$. With
    $J = \partial f / \partial \delta$ the variance is $J C J^T$. Those of the stations are added, as if poses and
    calibration erred independently.

    Args:
        scanner: The scanner that the cloud was made with; without covariance its part is 0.
        places: The stations of the cloud.
        samples: The points [n].
        weights: w [n, 3].

    Returns:
        Standard deviation, in metres times the unit of the weights.

    Raises:
        MeasurementError: If the scanner does not have the lasers of the points, or does not see them where they are.
    """
    pose = places.pose[samples.station]
    p = np.einsum("nji,nj->ni", pose[:, :3, :3], samples.p - samples.origin)
    turned = np.einsum("nji,nj->ni", pose[:, :3, :3], weights)
    variance = 0.0
    for number, covariance in enumerate(places.covariance):
        mine = samples.station == number
        effect = np.concatenate([turned[mine].sum(0), np.cross(p[mine], turned[mine]).sum(0)])
        variance += float(effect @ covariance @ effect)
    return float(np.sqrt(max(variance + _by_scanner(scanner, samples._replace(p=p), turned), 0.0)))


def _by_scanner(scanner: Scanner | None, samples: Samples, weights: np.ndarray) -> float:
    """The variance by the covariance of the scanner; points and weights in its frame."""
    if scanner is None:
        return 0.0
    if samples.laser.max() >= len(scanner.laser_names):
        raise MeasurementError(
            f"The cloud has points of laser {samples.laser.max()}, and the calibration has {len(scanner.laser_names)} "
            "(counted from 0): it is not the one that the cloud was made with."
        )
    if scanner.covariance is None:
        return 0.0
    gradient = np.zeros(len(scanner.parameter_names()))
    found = np.empty_like(samples.p)
    with jax.enable_x64(True):
        rig = scanner.rig
        for start in range(0, len(samples.p), BLOCK):
            part = slice(start, start + BLOCK)
            # Padding repeats the first point with no weight.
            index = np.resize(np.arange(len(samples.p))[part], BLOCK)
            counted = (np.arange(BLOCK) < len(samples.p[part]))[:, None]
            counted_weights, laser = np.where(counted, weights[index], 0.0), samples.laser[index].astype(np.int32)
            change, there = _gradient(rig, samples.p[index], counted_weights, laser, samples.angle[index])
            gradient += np.asarray(change)
            found[part] = np.asarray(there)[: len(samples.p[part])]
    _check_seen(samples.p, found)
    covariance = np.asarray(scanner.covariance, np.float64)
    return float(gradient @ covariance @ gradient)


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


@compile_quickly
def _gradient(rig: Rig, p: Array, weights: Array, laser: Array, angle: Array) -> tuple[jax.Array, jax.Array]:
    """Gradient of the weighted sum [parameters], and the points as the scanner has them [n, 3]."""
    q = pixels(rig, p, angle)

    def weighted_sum(step):
        found = points(rig.retract(step), q, laser, angle)
        return jnp.sum(found * weights), found

    return jax.grad(weighted_sum, has_aux=True)(jnp.zeros(rig.parameter_count(), p.dtype))
