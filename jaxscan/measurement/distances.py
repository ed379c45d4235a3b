"""The distance between two picked places of a cloud."""

from dataclasses import dataclass

import numpy as np

from jaxscan.errors import MeasurementError
from jaxscan.geometry import Scanner
from jaxscan.measurement.checked import is_known, require_known
from jaxscan.measurement.planes import Plane, Point, facing, fitted_plane, patch_around, weighted_plane
from jaxscan.measurement.samples import Cloud, CloudSamples, Samples, places_of
from jaxscan.measurement.systematic import systematic_sigma


PARALLEL_DEG = 10.0
"""Largest angle between two patches that have a plane-to-plane distance."""


@dataclass(frozen=True)
class DistanceMeasurement:
    """Distance between two patches of a cloud."""

    value_m: float
    """Distance between the means of the two patches [m]."""
    sigma_m: float
    """Its predicted standard deviation [m]: random and systematic together."""
    sigma_random_m: float
    sigma_systematic_m: float
    plane_to_plane_m: float | None
    """Distance of the planes of the two patches along their mean normal, midway between the patches;
    None unless both are planar and parallel within 10 degrees, and it is known to a fifth of itself."""
    plane_to_plane_sigma_m: float | None
    """Random part of its standard deviation [m]."""
    a_m: np.ndarray
    """Mean of the first patch [3], m."""
    b_m: np.ndarray
    """Mean of the second patch [3], m."""
    points: tuple[int, int]
    """Points in either patch."""

    def words(self) -> tuple[str, ...]:
        """As people read it: between the places, and between their planes where these are parallel."""
        ends = f"from {self.points[0]} and {self.points[1]} points"
        lines = [f"{length_words(self.value_m, self.sigma_m)}, {ends}"]
        if self.plane_to_plane_m is not None and self.plane_to_plane_sigma_m is not None:
            lines.append(f"between their planes: {length_words(self.plane_to_plane_m, self.plane_to_plane_sigma_m)}")
        return tuple(lines)


def length_words(value_m: float, sigma_m: float) -> str:
    """A length and its standard deviation, as people read them."""
    return f"{value_m:.4f} m, sigma {1e3 * sigma_m:.2f} mm"


def measure_distance(
    cloud: Cloud, a: Point, b: Point, *, radius_m: float = 0.02, scanner: Scanner | None = None
) -> DistanceMeasurement:
    """Distance between two picked points, each averaged over the patch around it.

    Args:
        cloud: The cloud.
        a: First picked point [3], m, scanner frame.
        b: Second picked point [3], m, scanner frame.
        radius_m: Points within this distance of a picked point belong to its patch [m].
        scanner: The scanner the cloud was made with; its covariance gives the systematic part.

    Returns:
        The distance [m] with its predicted standard deviation, and the distance of the patches' planes.

    Raises:
        MeasurementError: If a patch has too few points, the patches are one, or the distance is not known to a fifth of
            itself.
    """
    samples = CloudSamples(cloud)
    patches = [patch_around(samples, point, radius_m) for point in (a, b)]
    means = [patch.p.mean(0) for patch in patches]
    value = float(np.linalg.norm(means[1] - means[0]))
    if value <= radius_m:
        raise MeasurementError(
            f"The two patches of radius {radius_m} m are only {value:.4f} m apart; "
            "pick points farther apart or a smaller radius."
        )
    random, systematic = _sigmas(cloud, patches, (means[1] - means[0]) / value, scanner)
    sigma = float(np.hypot(random, systematic))
    require_known("distance", value, sigma)
    apart, apart_sigma = _between_planes(*(_flat(patch) for patch in patches))
    return DistanceMeasurement(
        value_m=value,
        sigma_m=sigma,
        sigma_random_m=random,
        sigma_systematic_m=systematic,
        plane_to_plane_m=apart,
        plane_to_plane_sigma_m=apart_sigma,
        a_m=means[0],
        b_m=means[1],
        points=(len(patches[0].p), len(patches[1].p)),
    )


@dataclass(frozen=True)
class HeightMeasurement:
    """How much higher the second of two patches of a cloud is."""

    value_m: float
    """Height of the mean of the second patch over that of the first [m]; negative where it is lower."""
    sigma_m: float
    """Its predicted standard deviation [m]: random and systematic together."""
    points: tuple[int, int]
    """Points in either patch."""

    def words(self) -> str:
        """As people read it."""
        way = "higher" if self.value_m >= 0 else "lower"
        length = length_words(abs(self.value_m), self.sigma_m)
        return f"the second is {way} by {length}, from {self.points[0]} and {self.points[1]} points"


def measure_height(
    cloud: Cloud, a: Point, b: Point, *, radius_m: float = 0.02, scanner: Scanner | None = None
) -> HeightMeasurement:
    """How much higher a second picked point is than a first one along z, each averaged over the patch around it.

    Args:
        cloud: The cloud, z up.
        a: First picked point [3], m, scanner frame.
        b: Second picked point [3], m, scanner frame.
        radius_m: Points within this distance of a picked point belong to its patch [m].
        scanner: The scanner the cloud was made with; its covariance gives the systematic part.

    Raises:
        MeasurementError: If a patch has too few points.
    """
    samples = CloudSamples(cloud)
    patches = [patch_around(samples, point, radius_m) for point in (a, b)]
    low, high = (float(patch.p[:, 2].mean()) for patch in patches)
    sigma = float(np.hypot(*_sigmas(cloud, patches, np.array([0.0, 0.0, 1.0]), scanner)))
    return HeightMeasurement(high - low, sigma, (len(patches[0].p), len(patches[1].p)))


def _sigmas(cloud: Cloud, patches: list[Samples], along: np.ndarray, scanner: Scanner | None) -> tuple[float, float]:
    """Random and systematic standard deviation of the difference of the means of two patches along a direction [m]."""
    variance = sum(patch.covariance_of(np.full((1, len(patch.p)), 1 / len(patch.p)), along)[0, 0] for patch in patches)
    shares = [np.full(len(patch.p), sign / len(patch.p)) for sign, patch in zip((-1, 1), patches, strict=True)]
    weights = np.outer(np.concatenate(shares), along)
    systematic = systematic_sigma(scanner, places_of(cloud), Samples.joined(patches), weights)
    return float(np.sqrt(variance)), systematic


def _between_planes(first: Plane | None, second: Plane | None) -> tuple[float | None, float | None]:
    if first is None or second is None:
        return None, None
    second = facing(second, first.normal)
    if first.normal @ second.normal < np.cos(np.radians(PARALLEL_DEG)):
        return None, None
    normal = first.normal + second.normal
    normal = normal / np.linalg.norm(normal)
    middle = 0.5 * (first.centre + second.centre)
    feet = [(plane.distance - plane.normal @ middle) / (plane.normal @ normal) for plane in (first, second)]
    # Each plane is evaluated at its own end of the line between the planes, near its own patch.
    sigma = [plane.sigma_at(middle + foot * normal) for plane, foot in zip((first, second), feet, strict=True)]
    apart, both = float(abs(feet[1] - feet[0])), float(np.hypot(sigma[0], sigma[1]))
    return (apart, both) if is_known(apart, both) else (None, None)


def _flat(patch: Samples) -> Plane | None:
    """Plane of the patch; None if it is too narrow, or rougher than twice its noise."""
    plane = fitted_plane(patch, weighted_plane(patch.p, patch.sigma_row**-2).normal)
    sigma = patch.sigma_across(plane.normal)
    apart = patch.p - plane.centre
    residual = apart @ plane.normal
    extent = np.sqrt(np.mean((apart @ plane.axes.T) ** 2, axis=0)).min()
    rms = np.sqrt(np.mean(residual**2))
    if len(patch.p) < 6 or extent < 3.0 * rms or rms > 2.0 * np.sqrt(np.mean(sigma**2)):
        return None
    return plane
