"""A sphere in a cloud: a robust fit with its uncertainty."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from jaxscan.errors import MeasurementError
from jaxscan.geometry import Scanner, median_sigma
from jaxscan.measurement.planes import Point, place_words
from jaxscan.measurement.samples import (
    SIGMA_FLOOR_M,
    Cloud,
    CloudSamples,
    Samples,
    checked_samples,
    places_of,
    require_known,
    spread_out,
)
from jaxscan.measurement.systematic import systematic_sigma


CAP = np.cos(np.deg2rad(60.0))
"""Cosine of the largest angle between normal and view at which points are used: at grazing incidence the stripe is no
line."""
KEPT = 3.5
"""Residuals beyond this many robust standard deviations are left out of a fit."""
REACH_M = 0.09
"""How far around the given place points are looked for, beside the radius [m]."""
FEWEST = 30
"""Smallest number of points."""


class SphereFit(NamedTuple):
    """A sphere fitted to points of a cloud [m], and unit normals there."""

    centre: np.ndarray
    radius: float
    covariance: np.ndarray
    """Covariance of centre, and of a free radius, by the noise of the stripes [3 or 4, 3 or 4], m^2."""
    members: Samples
    normal: np.ndarray
    residual: np.ndarray
    """Distances from the surface of all points of the cap within a fifth of the diameter of it [k], m."""


@dataclass(frozen=True)
class SphereMeasurement:
    """A sphere in a cloud, scanner frame [m]; sigmas are predicted, and 0 of a radius that was held."""

    centre_m: np.ndarray
    centre_sigma_m: np.ndarray
    radius_m: float
    radius_sigma_m: float
    radius_sigma_random_m: float
    radius_sigma_systematic_m: float
    rms_m: float
    points: int


def measure_sphere(
    cloud: Cloud, near: Point, *, radius_m: float, held: bool = False, scanner: Scanner | None = None
) -> SphereMeasurement:
    """Centre and radius of the sphere near a place.

    Args:
        cloud: The cloud.
        near: About where its centre is, to 0.09 m [3], m, scanner frame.
        radius_m: About its radius, to a tenth [m].
        held: Whether the radius is known better than the cloud tells, and only the centre is found.
        scanner: The scanner the cloud was made with; its covariance gives the systematic part.

    Returns:
        The sphere with its predicted standard deviations.

    Raises:
        MeasurementError: If there are too few points, none that lie on such a sphere, or its radius is not known to a
            fifth of itself.
    """
    place = np.asarray(near, np.float64)
    fit = fit_sphere(checked_samples(cloud), place, radius_m, free=not held)
    factors = sphere_factors(fit.members, fit.normal, free=not held)
    systematic = np.array(
        [systematic_sigma(scanner, places_of(cloud), fit.members, row[:, None] * fit.normal) for row in factors]
    )
    random = np.sqrt(np.diag(fit.covariance))
    both = np.hypot(random, systematic)
    radius_random, radius_systematic = (0.0, 0.0) if held else (float(random[3]), float(systematic[3]))
    require_known("radius", fit.radius, float(np.hypot(radius_random, radius_systematic)))
    residual = np.linalg.norm(fit.members.p - fit.centre, axis=1) - fit.radius
    return SphereMeasurement(
        centre_m=fit.centre,
        centre_sigma_m=both[:3],
        radius_m=fit.radius,
        radius_sigma_m=float(np.hypot(radius_random, radius_systematic)),
        radius_sigma_random_m=radius_random,
        radius_sigma_systematic_m=radius_systematic,
        rms_m=float(np.sqrt(np.mean(residual**2))),
        points=len(residual),
    )


def fit_sphere(samples: CloudSamples, near: np.ndarray, radius: float, *, free: bool) -> SphereFit:
    """The sphere next to a place, and its radius where that is free, by weighted least squares without outliers.

    The noise of a point lies along its ray, and its component along the normal sets the weight.

    Raises:
        MeasurementError: If there are too few points, or none that lie on such a sphere.
    """
    reach = radius + REACH_M
    around = samples.take(samples.chosen(lambda some: np.linalg.norm(some.p - near, axis=1) < reach))
    place = place_words(near)
    if len(around.p) < FEWEST:
        raise MeasurementError(
            f"Only {len(around.p)} points lie within {radius + REACH_M:.3f} m of {place}, expected at least {FEWEST}: "
            "give the place of the sphere's centre, and its radius."
        )
    centre, given = _search(around.p, around.origin, radius), radius
    unlike = MeasurementError(
        f"No sphere of about {given:g} m radius near {place}: its points lie on none; give its centre and radius."
    )
    if centre is None:
        raise unlike
    kept = np.zeros(len(around.p), bool)
    for _ in range(40):
        residual, normal, cap = _look(around, centre, radius)
        cap &= np.abs(residual) < 0.4 * given
        sigma = _sigma_across(around, normal)
        if cap.sum() < FEWEST:
            raise unlike
        scale = median_sigma(residual[cap] / sigma[cap])
        now = cap & (np.abs(residual) < KEPT * max(scale, 1.0) * sigma)
        if now.sum() < FEWEST:
            raise unlike
        step = sphere_factors(around.take(now), normal[now], free=free) @ residual[now]
        centre = centre + step[:3]
        radius += float(step[3]) if free else 0.0
        if not np.linalg.norm(centre - near) < given + REACH_M or not 0.5 * given < radius < 2.0 * given:
            raise unlike
        if np.array_equal(now, kept) and np.linalg.norm(step) < 1e-7:
            break
        kept = now
    residual, normal, cap = _look(around, centre, radius)
    cap &= np.abs(residual) < 0.4 * given
    members = around.take(kept)
    if residual[kept].std() > 0.1 * given:
        raise unlike
    covariance = _covariance(members, normal[kept], sphere_factors(members, normal[kept], free=free))
    return SphereFit(centre, radius, covariance, members, normal[kept], residual[cap])


def sphere_factors(samples: Samples, normal: np.ndarray, *, free: bool) -> np.ndarray:
    """F: centre, and the radius where it is free, move by F r, where r are distances from the surface [3 or 4, n]."""
    design = np.column_stack([normal, np.ones(len(normal))] if free else [normal])
    weighted = design / _sigma_across(samples, normal)[:, None] ** 2
    return np.linalg.solve(weighted.T @ design, weighted.T)


def _search(p: np.ndarray, origin: np.ndarray, radius: float) -> np.ndarray | None:
    """Centre of the sphere of known radius that most points lie near: through three points, many times."""
    rng = np.random.default_rng(0)
    chosen = rng.integers(len(p), size=(400, 3))
    a, b, c = np.moveaxis(p[chosen], 1, 0)
    centres, exists = _spheres_through(a, b, c, radius, away=a - origin[chosen[:, 0]])
    if not exists.any():
        return None
    centres = centres[exists]
    some = p[spread_out(len(p), 600, rng)]
    miss = np.abs(np.linalg.norm(some[None] - centres[:, None], axis=-1) - radius)
    best: np.ndarray = centres[np.argmin(np.minimum(miss, 0.005).sum(1))]
    return best


def _spheres_through(
    a: np.ndarray, b: np.ndarray, c: np.ndarray, radius: float, *, away: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Centres [n, 3] of spheres of known radius through three points [n, 3] each, m, and whether there is one [n].

    The near side of a sphere is seen: of both centres the one farther along the directions of sight `away` is meant.
    """
    ab, ac = b - a, c - a
    normal = np.cross(ab, ac)
    square = np.sum(normal**2, -1, keepdims=True)
    safe = np.where(square > 1e-18, square, 1.0)
    ab2, ac2 = (np.sum(side**2, -1, keepdims=True) for side in (ab, ac))
    to_middle = (ac2 * np.cross(normal, ab) + ab2 * np.cross(ac, normal)) / (2 * safe)
    height2 = radius**2 - np.sum(to_middle**2, -1, keepdims=True)
    up = normal * np.sqrt(np.maximum(height2, 0.0) / safe)
    up = np.where(np.sum(up * away, -1, keepdims=True) > 0, up, -up)
    return a + to_middle + up, ((square > 1e-18) & (height2 > 0))[:, 0]


def _look(samples: Samples, centre: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distances from the surface [n], normals [n, 3], and which points are within the cap towards the scanner [n].

    Normals are those where the ray meets the sphere. At the point itself they would follow its noise, and the sphere
    would come out smaller than it is.
    """
    ray, to_centre = _rays(samples), centre - samples.origin
    nearest = np.sum(ray * to_centre, -1)
    square = radius**2 - (np.sum(to_centre**2, -1) - nearest**2)
    met = nearest - np.sqrt(np.maximum(square, 0.0))
    normal = (met[:, None] * ray - to_centre) / radius
    facing = np.sum(normal * ray, -1)
    residual = (np.linalg.norm(samples.p - samples.origin, axis=1) - met) * facing
    view = -to_centre / np.linalg.norm(to_centre, axis=1, keepdims=True)
    return residual, normal, (np.sum(normal * view, -1) > CAP) & (square > 0)


def _rays(samples: Samples) -> np.ndarray:
    way = samples.p - samples.origin
    return way / np.linalg.norm(way, axis=1, keepdims=True)


def _sigma_across(samples: Samples, normal: np.ndarray) -> np.ndarray:
    """Standard deviation along the normals of a point by its own row alone [n], m; at least 0.1 mm."""
    return np.hypot(samples.sigma_row * np.abs(np.sum(_rays(samples) * normal, -1)), SIGMA_FLOOR_M)


def _covariance(samples: Samples, normal: np.ndarray, factors: np.ndarray) -> np.ndarray:
    """Covariance by noise along the rays, part of which neighbours share; [k, k], m^2."""
    view = _rays(samples).mean(0)
    view /= np.linalg.norm(view)
    # `covariance_of` takes displacements along one direction: each factor is for those along the point's own normal.
    share = np.sum(_rays(samples) * normal, -1) / (_rays(samples) @ view)
    return samples.covariance_of(factors * share, view)
