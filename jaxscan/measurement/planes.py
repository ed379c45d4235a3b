"""Planes in a cloud: weighted fit with covariance, and flatness of a patch."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from jaxscan.errors import MeasurementError
from jaxscan.geometry import Array, principal_axes
from jaxscan.measurement.samples import Cloud, CloudSamples, Samples


Point = Array | Sequence[float]
"""A picked point [3]."""

_BLOCK_LINES = 16
"""Lines of a block, which errs by itself: compression errs over a block of so many pixels at most."""


class Plane(NamedTuple):
    """A plane `normal . p = distance` fitted to weighted points [m], and two unit vectors in it [2, 3]."""

    normal: np.ndarray
    distance: float
    centre: np.ndarray
    """Weighted mean of the points [3], m: on the plane."""
    axes: np.ndarray
    covariance: np.ndarray
    """Covariance [3, 3] of the offset at `centre` [m] and of the slopes along `axes` [1]."""

    def height_weights(self, at: np.ndarray) -> np.ndarray:
        """h [3]: at the point `at` the plane moves by h . (offset, slopes)."""
        return np.concatenate([[1.0], self.axes @ (at - self.centre)])

    def sigma_at(self, at: np.ndarray) -> float:
        """Standard deviation of the plane's position at the foot of `at` [m]."""
        h = self.height_weights(at)
        return float(np.sqrt(h @ self.covariance @ h))


def weighted_plane(p: np.ndarray, weight: np.ndarray) -> Plane:
    """Total least squares plane through points [n, 3] with weights 1/sigma^2 [n].

    The covariance is scaled by the misfit where it is larger than the weights predict.
    """
    centre, _, axes = principal_axes(p, weight)
    normal, axes = axes[0], axes[:0:-1]
    apart = p - centre
    residual = apart @ normal
    design = np.column_stack([np.ones(len(p)), apart @ axes.T])
    covariance = np.linalg.pinv((design * weight[:, None]).T @ design)
    misfit = weight @ residual**2 / max(len(p) - 3, 1)
    return Plane(normal, float(normal @ centre), centre, axes, covariance * max(1.0, misfit))


def fitted_plane(samples: Samples, normal: np.ndarray) -> Plane:
    """Plane through points whose noise lies along their rays; `normal` is an approximate normal of the plane.

    Neighbours that were smoothed share their noise: weights are those of the rows, and the covariance counts
    the noise that points share, scaled by the misfit where it is larger than their sigmas predict, and what
    the lines of all profiles share.
    """
    plane = weighted_plane(samples.p, samples.weights_across(normal))
    residual = (samples.p - plane.centre) @ plane.normal
    misfit = np.mean((residual / samples.sigma_across(plane.normal)) ** 2) * len(residual) / max(len(residual) - 3, 1)
    factors = plane_factors(samples, plane)
    covariance = samples.covariance_of(factors, plane.normal) * max(1.0, misfit)
    return plane._replace(covariance=_as_lines_show(samples, residual * factors, covariance))


def _as_lines_show(samples: Samples, moved: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    r"""The covariance [3, 3], larger in directions in which blocks of lines scatter more than it promises.

    A floor around a turning rig has its stripe at one place of the image in all profiles. What errs by place, as
    compression does, is then alike in all of them. By luck alone three directions of n blocks seem to scatter up to
    $(1 + \sqrt{3 / n})^2$ as much.

    Args:
        moved: What every point's residual adds to offset and slopes [3, n].
        covariance: The promise.

    Source: K.-Y. Liang, S. L. Zeger, Longitudinal data analysis using generalized linear models, Biometrika 73, 1986;
    V. A. Marchenko, L. A. Pastur, Distribution of eigenvalues for some sets of random matrices, Math. USSR-Sbornik 1,
    1967.
    """
    blocks = np.stack([samples.station, samples.line // _BLOCK_LINES])
    block = np.unique(blocks, axis=1, return_inverse=True)[1].ravel()
    count = int(block.max()) + 1
    free = count - 3
    size, axes = np.linalg.eigh(covariance)
    if free < 3 or size[0] <= 0:
        return covariance
    root = axes * np.sqrt(size)
    whitened = np.linalg.solve(root, np.stack([np.bincount(block, one, count) for one in moved]))
    seen, directions = np.linalg.eigh(whitened @ whitened.T * count / free)
    larger = np.where(seen > (1.0 + np.sqrt(3.0 / free)) ** 2, seen, 1.0)
    return np.asarray(root @ (directions * larger) @ directions.T @ root.T)


def plane_factors(samples: Samples, plane: Plane) -> np.ndarray:
    """F [3, n]: points that move by x [n] along the normal move offset and slopes of the plane by F x."""
    weight = samples.weights_across(plane.normal)
    design = np.column_stack([np.ones(len(samples.p)), (samples.p - plane.centre) @ plane.axes.T])
    return np.asarray(np.linalg.pinv((design * weight[:, None]).T @ design) @ (design * weight[:, None]).T)


def facing(plane: Plane, direction: np.ndarray) -> Plane:
    """The same plane with its normal on the side of `direction`."""
    if plane.normal @ direction >= 0:
        return plane
    # Flipping the normal changes the signs of the offset and of both slopes, so the covariance stays.
    return plane._replace(normal=-plane.normal, distance=-plane.distance)


def feet_on(planes: Sequence[Plane], at: np.ndarray) -> tuple[np.ndarray, list[float]]:
    """The mean normal [3] of two nearly parallel planes, and how far along it each is from a point [m]."""
    first, second = planes
    normal = first.normal + (second.normal if first.normal @ second.normal >= 0 else -second.normal)
    normal = normal / np.linalg.norm(normal)
    return normal, [float((plane.distance - plane.normal @ at) / (plane.normal @ normal)) for plane in planes]


@dataclass(frozen=True)
class PlaneMeasurement:
    """Flatness of a patch of the cloud, its normal towards the scanner."""

    normal: np.ndarray
    centre_m: np.ndarray
    rms_m: float
    range95_m: float
    """Width of the band that holds the middle 95 % of the distances from the plane [m]."""
    points: int

    def words(self) -> str:
        """The measurement in words."""
        # Nothing is "-0.0000".
        normal = " ".join(f"{x:.4f}" for x in np.round(self.normal, 4) + 0.0)
        return (
            f"RMS {1e3 * self.rms_m:.2f} mm, 95 % of {self.points} points within {1e3 * self.range95_m:.2f} mm, "
            f"normal {normal}"
        )


def measure_plane(cloud: Cloud, point: Point, *, radius_m: float = 0.2) -> PlaneMeasurement:
    """Flatness of the cloud around a picked point.

    Args:
        cloud: The cloud.
        point: Picked point [3], m, scanner frame.
        radius_m: Points within this distance of it belong to the patch [m].

    Returns:
        RMS, 95 % range and normal of the least-squares plane.

    Raises:
        MeasurementError: If the patch has too few points, or they determine no plane.
    """
    patch = patch_around(CloudSamples(cloud), point, radius_m)
    plane = facing(weighted_plane(patch.p, np.ones(len(patch.p))), (patch.origin - patch.p).mean(0))
    require_plane(patch, plane, point, radius_m)
    residual = patch.p @ plane.normal - plane.distance
    low, high = np.percentile(residual, [2.5, 97.5])
    rms = float(np.sqrt(np.mean(residual**2)))
    return PlaneMeasurement(plane.normal, plane.centre, rms, float(high - low), len(patch.p))


def require_plane(patch: Samples, plane: Plane, point: Point, radius_m: float) -> None:
    """Refuse points around a picked point that determine no plane, such as points along a line."""
    apart = patch.p - plane.centre
    extent, rms = np.sqrt(np.mean((apart @ plane.axes.T) ** 2, axis=0)), np.sqrt(np.mean((apart @ plane.normal) ** 2))
    if extent.min() <= max(2.0 * rms, 0.05 * extent.max()):
        raise MeasurementError(
            f"The {len(patch.p)} points within {radius_m} m of {place_words(point)} determine no plane; "
            "pick a flat place or a larger radius."
        )


def patch_around(samples: CloudSamples, point: Point, radius_m: float) -> Samples:
    """Points within a radius [m] of a picked point; refused where they are fewer than four."""
    centre = np.asarray(point, np.float64)
    nearest = np.inf

    def is_inside(some: Samples) -> np.ndarray:
        nonlocal nearest
        distance = np.linalg.norm(some.p - centre, axis=1)
        nearest = min(nearest, float(distance.min()))
        return np.asarray(distance <= radius_m)

    inside = samples.chosen(is_inside)
    if len(inside) < 4:
        raise MeasurementError(
            f"Only {len(inside)} points lie within {radius_m} m of {place_words(point)}, the nearest "
            f"{nearest:.3f} m away; at least 4 are needed: pick a point on a surface or a larger radius."
        )
    return samples.take(inside)


def place_words(point: Point) -> str:
    """A place [3], m, in a message."""
    return "(" + ", ".join(f"{x:.3f}" for x in np.asarray(point)) + ")"
