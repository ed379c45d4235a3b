"""Between two picked places of a cloud: distances, heights and angles."""

from dataclasses import dataclass

import numpy as np

from jaxscan.errors import MeasurementError
from jaxscan.geometry import Scanner
from jaxscan.measurement.planes import (
    Plane,
    Point,
    facing,
    feet_on,
    fitted_plane,
    patch_around,
    place_words,
    plane_factors,
    require_plane,
    weighted_plane,
)
from jaxscan.measurement.samples import (
    SIGMA_FLOOR_M,
    Cloud,
    CloudSamples,
    Samples,
    checked_samples,
    is_known,
    places_of,
    require_known,
)
from jaxscan.measurement.systematic import systematic_sigma


PARALLEL_DEG = 10.0
"""Largest angle between two patches that have a plane-to-plane distance."""


@dataclass(frozen=True)
class DistanceMeasurement:
    """Distance between the patches a and b of a cloud, with so many points each; sigmas are predicted."""

    value_m: float
    """Distance between the means of the two patches [m]."""
    sigma_m: float
    sigma_random_m: float
    sigma_systematic_m: float
    plane_to_plane_m: float | None
    """Distance of the planes of the two patches along their mean normal, midway between the patches;
    None unless both are planar and parallel within 10 degrees, and it is known to a fifth of itself."""
    plane_to_plane_sigma_m: float | None
    """Random part of its standard deviation [m]."""
    a_m: np.ndarray
    b_m: np.ndarray
    points: tuple[int, int]

    def words(self) -> tuple[str, ...]:
        """The length in words: between the places, and between their planes if these are parallel."""
        lines = [f"{length_words(self.value_m, self.sigma_m)}, {_points_words(self.points)}"]
        if self.plane_to_plane_m is not None and self.plane_to_plane_sigma_m is not None:
            lines.append(f"between their planes: {length_words(self.plane_to_plane_m, self.plane_to_plane_sigma_m)}")
        return tuple(lines)


def length_words(value_m: float, sigma_m: float) -> str:
    """A length and its standard deviation, as people read them."""
    return f"{value_m:.4f} m, sigma {1e3 * sigma_m:.2f} mm"


def _points_words(points: tuple[int, int]) -> str:
    return f"from {points[0]} and {points[1]} points"


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
    patches = _patches(cloud, a, b, radius_m)
    first, second = (patch.p.mean(0) for patch in patches)
    value = float(np.linalg.norm(second - first))
    if value <= radius_m:
        raise MeasurementError(
            f"The two patches of radius {radius_m} m are only {value:.4f} m apart; "
            "pick points farther apart or a smaller radius."
        )
    random, systematic = _sigmas(cloud, patches, (second - first) / value, scanner)
    sigma = float(np.hypot(random, systematic))
    require_known("distance", value, sigma)
    planes = _between_planes(*(_flat(patch) for patch in patches))
    return DistanceMeasurement(value, sigma, random, systematic, *planes, first, second, _counts(patches))


@dataclass(frozen=True)
class HeightMeasurement:
    """How much higher the second of two patches of a cloud is; its sigma is predicted."""

    value_m: float
    """Height of the mean of the second patch over that of the first [m]; negative where it is lower."""
    sigma_m: float
    points: tuple[int, int]

    def words(self) -> str:
        """The measurement in words."""
        way = "higher" if self.value_m >= 0 else "lower"
        return f"the second is {way} by {length_words(abs(self.value_m), self.sigma_m)}, {_points_words(self.points)}"


def measure_height(
    cloud: Cloud, a: Point, b: Point, *, radius_m: float = 0.02, scanner: Scanner | None = None
) -> HeightMeasurement:
    """How much higher a second picked point is than a first one along z; arguments as of `measure_distance`.

    Raises:
        MeasurementError: If a patch has too few points.
    """
    patches = _patches(cloud, a, b, radius_m)
    low, high = (float(patch.p[:, 2].mean()) for patch in patches)
    sigma = float(np.hypot(*_sigmas(cloud, patches, np.array([0.0, 0.0, 1.0]), scanner)))
    return HeightMeasurement(high - low, sigma, _counts(patches))


@dataclass(frozen=True)
class PointDistance:
    """Distance between two single points a and b of a cloud [m]; sigmas are predicted."""

    value_m: float
    sigma_m: float
    sigma_random_m: float
    sigma_systematic_m: float
    a_m: np.ndarray
    b_m: np.ndarray


def measure_points(
    cloud: Cloud, a: Point, b: Point, *, within_m: float = 0.05, scanner: Scanner | None = None
) -> PointDistance:
    """Distance between the points of a cloud that are nearest two places.

    Nothing is averaged: this is for corners and edges, where a patch around the place would be of several surfaces. How
    far the point is from the place that was meant is not part of sigma.

    Args:
        cloud: The cloud.
        a: First place [3], m, scanner frame.
        b: Second place [3], m, scanner frame.
        within_m: A point must lie within this distance of its place [m].
        scanner: The scanner the cloud was made with; its covariance gives the systematic part.

    Returns:
        The distance [m] with its predicted standard deviation.

    Raises:
        MeasurementError: If there is no point near a place, both places have the same, or the distance is
            not known to a fifth of itself.
    """
    samples = checked_samples(cloud)
    nearest = [_nearest(samples, place, within_m) for place in (a, b)]
    if nearest[0] == nearest[1]:
        raise MeasurementError("Both places have the same nearest point; give places farther apart.")
    order = np.argsort(nearest)
    # Ties go to the point that comes first in the cloud.
    ends = samples.take(np.array(nearest)[order]).take(np.argsort(order))
    apart = ends.p[1] - ends.p[0]
    value = float(np.linalg.norm(apart))
    if value == 0.0:
        raise MeasurementError("The two nearest points are at the same place; give places farther apart.")
    along = apart / value
    ray = ends.p - ends.origin
    reach = np.linalg.norm(ray, axis=1)
    noise = ends.sigma * np.abs(ray @ along) / np.where(reach > 0, reach, 1.0)
    random = float(np.sqrt(np.sum(noise**2) + 2.0 * SIGMA_FLOOR_M**2))
    systematic = systematic_sigma(scanner, places_of(cloud), ends, np.stack([-along, along]))
    sigma = float(np.hypot(random, systematic))
    require_known("distance", value, sigma)
    return PointDistance(value, sigma, random, systematic, ends.p[0], ends.p[1])


def _nearest(samples: CloudSamples, place: Point, within_m: float) -> int:
    distance, nearest, start = np.inf, 0, 0
    for block in samples.blocks():
        away = np.linalg.norm(block.p - np.asarray(place, np.float64), axis=1)
        best = int(np.argmin(away))
        if away[best] < distance:
            distance, nearest = float(away[best]), start + best
        start += len(away)
    if distance > within_m:
        raise MeasurementError(
            f"The point nearest {place_words(place)} is {distance:.3f} m away, expected one within {within_m:g} m: "
            "give a place on a surface."
        )
    return nearest


@dataclass(frozen=True)
class AngleMeasurement:
    """The angle between two flat patches of a cloud, with so many points each; its sigma is predicted."""

    value_deg: float
    """Angle on the side from which they were seen: 90 in the corner of a room, 180 where both are one plane."""
    sigma_deg: float
    rms_m: tuple[float, float]
    """Root mean square distance of the points of either patch from its plane [m]."""
    points: tuple[int, int]

    def words(self) -> str:
        """The measurement in words."""
        flat = " and ".join(f"{1e3 * rms:.2f}" for rms in self.rms_m)
        sigma = f"sigma {self.sigma_deg:.3f} degrees"
        return f"{self.value_deg:.3f} degrees, {sigma}, {_points_words(self.points)}, RMS {flat} mm"


_LEAST_SINE = 0.02
"""Least sine of the angle between two normals whose planes meet in an edge."""
_SIGMAS, _ROUNDS = 3.0, 20
"""Points farther from the plane than so many robust standard deviations belong to something else, as a picture or a
switch on the wall; rounds of leaving them out."""
_TRIPLES, _LARGE, _LEAST_SHARE, _LEAST_PROFILES = 500, 0.3, 0.5, 3
"""Triples of points that are tried; how large they are, as a share of the largest; the least share of the points that
are on the plane, and the least number of profiles: through any two goes a plane, from a wall to a picture on it too."""


def measure_angle(
    cloud: Cloud, a: Point, b: Point, *, radius_m: float = 0.2, scanner: Scanner | None = None
) -> AngleMeasurement:
    """Angle between the planes around two picked points, on the side from which they were seen.

    Arguments are those of `measure_distance`.

    Raises:
        MeasurementError: If a patch has too few points, or they determine no plane.
    """
    patches, planes = [], []
    for patch, point in zip(_patches(cloud, a, b, radius_m), (a, b), strict=True):
        flat = _flat_part(patch, point, radius_m)
        plane = fitted_plane(flat, weighted_plane(flat.p, flat.sigma_row**-2).normal)
        require_plane(flat, plane, point, radius_m)
        patches.append(flat)
        planes.append(facing(plane, (flat.origin - flat.p).mean(0)))
    first, second = planes
    sine = float(np.linalg.norm(np.cross(first.normal, second.normal)))
    value = np.pi - np.arctan2(sine, first.normal @ second.normal)
    variance, weights = 0.0, []
    for patch, plane, other in zip(patches, planes, reversed(planes), strict=True):
        # The angle changes with the slope towards the other plane. Noise must not decide that direction, so without
        # an edge it is the direction in which the slope is known least.
        least_known = np.linalg.eigh(plane.covariance[1:, 1:])[1][:, -1]
        slopes = plane.axes @ other.normal / sine if sine > _LEAST_SINE else least_known
        # A place that is rougher than its noise is a worse plane than its noise says.
        away = (patch.p - plane.centre) @ plane.normal
        rough = max(1.0, float(np.sqrt(np.mean(away**2)) / np.median(patch.sigma_across(plane.normal))))
        variance += rough**2 * float(slopes @ plane.covariance[1:, 1:] @ slopes)
        weights.append(np.outer(slopes @ plane_factors(patch, plane)[1:], plane.normal))
    systematic = systematic_sigma(scanner, places_of(cloud), Samples.joined(patches), np.concatenate(weights))
    sigma = float(np.hypot(np.sqrt(variance), systematic))
    apart = [(patch.p - plane.centre) @ plane.normal for patch, plane in zip(patches, planes, strict=True)]
    first_rms, second_rms = (float(np.sqrt(np.mean(one**2))) for one in apart)
    return AngleMeasurement(
        float(np.degrees(value)), float(np.degrees(sigma)), (first_rms, second_rms), _counts(patches)
    )


def _flat_part(patch: Samples, point: Point, radius_m: float) -> Samples:
    """The points of a patch that are on its plane: what hangs on a wall does not turn it.

    The plane through three of the points from which half of them are least far (least median of squares: Rousseeuw,
    1984), and then that of the points that are near it. Refused where they are fewer than half of the points, or lie
    on fewer than three of several profiles.
    """
    corners = patch.p[np.random.default_rng(0).integers(len(patch.p), size=(_TRIPLES, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1)
    # Points of one profile lie on a line, which is in many planes: those of large triangles are tried.
    large = length >= max(_LARGE * float(np.quantile(length, 0.9)), np.finfo(np.float64).tiny)
    corners, normals = corners[large], normals[large] / length[large, None]
    off = np.abs(np.einsum("kni,ki->kn", patch.p - corners[:, :1], normals))
    best = int(np.argmin(np.median(off, axis=1))) if len(off) else 0
    inlier = off[best] <= np.median(off[best]) if len(off) else np.ones(len(patch.p), np.bool_)
    for _ in range(_ROUNDS):
        plane = weighted_plane(patch.p[inlier], patch.sigma_row[inlier] ** -2)
        away = np.abs((patch.p - plane.centre) @ plane.normal)
        noise = float(np.median(patch.sigma_across(plane.normal)))
        near = away <= _SIGMAS * max(1.4826 * float(np.median(away[inlier])), noise)
        if np.array_equal(near, inlier):
            break
        inlier = near
    if np.count_nonzero(inlier) < max(4, _LEAST_SHARE * len(inlier)):
        raise MeasurementError(
            f"Less than half of the {len(patch.p)} points within {radius_m} m of {place_words(point)} are on one "
            "plane; pick a flat place."
        )
    _, number, count = np.unique(patch.profile, return_inverse=True, return_counts=True)
    whole = np.bincount(number, inlier) > _LEAST_SHARE * count
    if len(count) > 1 and np.count_nonzero(whole) < _LEAST_PROFILES:
        raise MeasurementError(
            f"Only {np.count_nonzero(whole)} profiles within {radius_m} m of {place_words(point)} are on one plane, "
            f"expected {_LEAST_PROFILES}; pick a flat place or a larger radius."
        )
    return patch.take(inlier)


def _patches(cloud: Cloud, a: Point, b: Point, radius_m: float) -> list[Samples]:
    samples = CloudSamples(cloud)
    return [patch_around(samples, point, radius_m) for point in (a, b)]


def _counts(patches: list[Samples]) -> tuple[int, int]:
    return len(patches[0].p), len(patches[1].p)


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
    if abs(first.normal @ second.normal) < np.cos(np.radians(PARALLEL_DEG)):
        return None, None
    middle = 0.5 * (first.centre + second.centre)
    normal, feet = feet_on((first, second), middle)
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
