"""The angle of a corner, between two walls that were picked."""

from dataclasses import dataclass

import numpy as np

from jaxscan.errors import MeasurementError
from jaxscan.geometry import Scanner
from jaxscan.measurement.planes import (
    Plane,
    Point,
    facing,
    fitted_plane,
    patch_around,
    plane_factors,
    require_plane,
    weighted_plane,
)
from jaxscan.measurement.samples import Cloud, CloudSamples, Samples, places_of
from jaxscan.measurement.systematic import systematic_sigma


_LEAST_SINE = 0.02
"""Of the angle between two normals that determine the edge in which their planes meet."""
_SIGMAS, _ROUNDS = 3.0, 20
"""Points farther from the plane than so many robust standard deviations belong to something else, as a picture or a
switch on the wall; rounds of leaving them out."""
_TRIPLES, _LARGE, _LEAST_SHARE = 500, 0.3, 0.5


@dataclass(frozen=True)
class AngleMeasurement:
    """The angle between two flat patches of a cloud."""

    value_deg: float
    """On the side from which the patches were seen: 90 in the corner of a room, 180 where both are one plane."""
    sigma_deg: float
    """Its predicted standard deviation: random and systematic together."""
    rms_m: tuple[float, float]
    """Root mean square distance of the points of either patch from its plane [m]."""
    points: tuple[int, int]
    """Points in either patch."""

    def words(self) -> str:
        """As people read it."""
        ends = f"from {self.points[0]} and {self.points[1]} points"
        flat = " and ".join(f"{1e3 * rms:.2f}" for rms in self.rms_m)
        return f"{self.value_deg:.3f} degrees, sigma {self.sigma_deg:.3f} degrees, {ends}, RMS {flat} mm"


def measure_angle(
    cloud: Cloud, a: Point, b: Point, *, radius_m: float = 0.2, scanner: Scanner | None = None
) -> AngleMeasurement:
    """Angle between the planes around two picked points, on the side from which they were seen.

    Args:
        cloud: The cloud.
        a: Picked point on the first plane [3], m, scanner frame.
        b: Picked point on the second plane [3], m, scanner frame.
        radius_m: Points within this distance of a picked point belong to its patch [m].
        scanner: The scanner the cloud was made with; its covariance gives the systematic part.

    Raises:
        MeasurementError: If a patch has too few points, or they determine no plane.
    """
    samples = CloudSamples(cloud)
    patches, planes = [], []
    for point in (a, b):
        patch = _flat_part(patch_around(samples, point, radius_m), point, radius_m)
        plane = fitted_plane(patch, weighted_plane(patch.p, patch.sigma_row**-2).normal)
        require_plane(patch, plane, point, radius_m)
        patches.append(patch)
        planes.append(facing(plane, (patch.origin - patch.p).mean(0)))
    first, second = planes
    sine = float(np.linalg.norm(np.cross(first.normal, second.normal)))
    value = np.pi - np.arctan2(sine, first.normal @ second.normal)
    variance, weights = 0.0, []
    for patch, plane, other in zip(patches, planes, reversed(planes), strict=True):
        # The angle changes with the slope towards the other plane; which way that is no noise may decide.
        slopes = plane.axes @ other.normal / sine if sine > _LEAST_SINE else _least_known(plane)
        variance += float(slopes @ plane.covariance[1:, 1:] @ slopes)
        weights.append(np.outer(slopes @ plane_factors(patch, plane)[1:], plane.normal))
    systematic = systematic_sigma(scanner, places_of(cloud), Samples.joined(patches), np.concatenate(weights))
    sigma = float(np.hypot(np.sqrt(variance), systematic))
    apart = [(patch.p - plane.centre) @ plane.normal for patch, plane in zip(patches, planes, strict=True)]
    first_rms, second_rms = (float(np.sqrt(np.mean(one**2))) for one in apart)
    return AngleMeasurement(
        value_deg=float(np.degrees(value)),
        sigma_deg=float(np.degrees(sigma)),
        rms_m=(first_rms, second_rms),
        points=(len(patches[0].p), len(patches[1].p)),
    )


def _flat_part(patch: Samples, point: Point, radius_m: float) -> Samples:
    """The points of a patch that are on its plane: what hangs on a wall does not turn it.

    The plane through three of the points from which half of them are least far (least median of squares: Rousseeuw,
    1984), and then that of the points that are near it.

    Raises:
        MeasurementError: If they are less than half of the points.
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
        place = ", ".join(f"{x:.3f}" for x in np.asarray(point))
        raise MeasurementError(
            f"Less than half of the {len(patch.p)} points within {radius_m} m of ({place}) are on one plane; "
            "pick a flat place."
        )
    return patch.take(inlier)


def _least_known(plane: Plane) -> np.ndarray:
    """The direction along the plane's axes in which its slope is known least [2]."""
    return np.asarray(np.linalg.eigh(plane.covariance[1:, 1:])[1][:, -1])
