"""Comparison of a cloud with a true or a better one."""

from dataclasses import dataclass

import numpy as np

from jaxscan.errors import MeasurementError
from jaxscan.geometry import Scanner
from jaxscan.measurement.samples import Cloud, camera_centres


@dataclass(frozen=True)
class ErrorStatistics:
    """Distribution of an error over points; `p95_abs` is the 95th percentile of its size."""

    rms: float
    mean: float
    """Mean error, signed if the error has a sign."""
    median_abs: float
    p95_abs: float
    max_abs: float

    @staticmethod
    def of(error: np.ndarray) -> "ErrorStatistics":
        size = np.abs(error)
        return ErrorStatistics(
            rms=float(np.sqrt(np.mean(error**2))),
            mean=float(np.mean(error)),
            median_abs=float(np.median(size)),
            p95_abs=float(np.percentile(size, 95)),
            max_abs=float(size.max()),
        )


@dataclass(frozen=True)
class CloudComparison:
    """Differences of two clouds. Errors in metres."""

    points: int
    error_m: ErrorStatistics
    """Distance to the true point (same grid) or to the nearest one (no common grid)."""
    along_ray_m: ErrorStatistics | None
    """Signed error along the ray, positive where too far; None without a common grid, or if no true point has a ray."""
    whitened: ErrorStatistics | None
    """Error along the ray divided by the point's `sigma_random`: RMS 1 if sigma is correct and the
    calibration perfect; None without a common grid."""
    completeness: float
    """Share of true points with a point of the cloud in the same cell, or within 1 cm."""
    false_points: int
    """Points without a true point in the same cell, or within 5 cm."""


NEAR_M, FALSE_M = 0.01, 0.05


def compare_clouds(cloud: Cloud, truth: Cloud, *, scanner: Scanner | None = None) -> CloudComparison:
    """Compare a cloud with the truth, cell by cell where both have one grid.

    Args:
        cloud: The cloud.
        truth: The true cloud in the same frame.
        scanner: Gives the camera centres for the direction of the rays; without it rays start at
            the origin of their station, which is within a few decimetres of them.

    Returns:
        Error statistics and completeness.

    Raises:
        MeasurementError: If either cloud is empty, or they have no cell in common.
    """
    for name, each in (("cloud", cloud), ("true cloud", truth)):
        if not np.any(np.asarray(each.valid)):
            raise MeasurementError(f"The {name} has no valid points; there is nothing to compare.")
    if np.shape(cloud.valid) == np.shape(truth.valid):
        return _by_cell(cloud, truth, scanner)
    return _by_neighbour(cloud, truth)


def _by_cell(cloud: Cloud, truth: Cloud, scanner: Scanner | None) -> CloudComparison:
    valid, true = np.asarray(cloud.valid), np.asarray(truth.valid)
    both = valid & true
    if not both.any():
        raise MeasurementError("The clouds have the same grid but no point in the same cell.")
    centre = camera_centres(cloud, scanner)
    profile = np.nonzero(both)[0]
    p, exact = np.asarray(cloud.xyz)[both].astype(float), np.asarray(truth.xyz)[both].astype(float)
    ray = exact - centre[profile]
    distance = np.linalg.norm(ray, axis=1, keepdims=True)
    # A true point in the camera's centre has no ray.
    apart = distance[:, 0] > 0
    along = np.sum((p - exact)[apart] * (ray[apart] / distance[apart]), axis=1)
    sigma = np.asarray(cloud.sigma_random)[both][apart].astype(float)
    known = sigma > 0
    return CloudComparison(
        points=int(both.sum()),
        error_m=ErrorStatistics.of(np.linalg.norm(p - exact, axis=1)),
        along_ray_m=ErrorStatistics.of(along) if apart.any() else None,
        whitened=ErrorStatistics.of(along[known] / sigma[known]) if known.any() else None,
        completeness=float(both.sum() / true.sum()),
        false_points=int((valid & ~true).sum()),
    )


def _by_neighbour(cloud: Cloud, truth: Cloud) -> CloudComparison:
    # Imported here, so that `import jaxscan` does not load SciPy.
    from scipy.spatial import cKDTree  # type: ignore[import-untyped]

    p = np.asarray(cloud.xyz)[np.asarray(cloud.valid)].astype(float)
    exact = np.asarray(truth.xyz)[np.asarray(truth.valid)].astype(float)
    to_truth = cKDTree(exact).query(p)[0]
    to_cloud = cKDTree(p).query(exact, distance_upper_bound=NEAR_M)[0]
    return CloudComparison(
        points=len(p),
        error_m=ErrorStatistics.of(to_truth),
        along_ray_m=None,
        whitened=None,
        completeness=float(np.mean(np.isfinite(to_cloud))),
        false_points=int(np.sum(to_truth > FALSE_M)),
    )
