"""Spheres in a cloud: robust fits, their uncertainty, and distances between them."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxscan import Scanner
from jaxscan.geometry import Array
from jaxscan.measurement.samples import SIGMA_FLOOR_M, Samples, spread_out


CAP = np.cos(np.deg2rad(60.0))
"""Cosine of the largest angle between normal and view at which points are used: at grazing incidence the stripe is no
line."""
KEPT = 3.5
"""Residuals beyond this many robust standard deviations are left out of a fit."""
_REACH = 0.09
"""How far around the clicked place points are looked for, beside the radius [m]."""
_COUNTED = 512
"""Points of a sphere on which the effect of the calibration is evaluated."""


class Fit(NamedTuple):
    """A sphere fitted to points of a cloud."""

    centre: np.ndarray
    """[3], m."""
    radius: float
    """m."""
    covariance: np.ndarray
    """Of the centre by the noise of the stripes [3, 3], m^2."""
    effect: np.ndarray
    """Derivative of the centre by the minimal coordinates of the calibration [3, parameters]."""
    residual: np.ndarray
    """Distances from the surface of all points of the cap within a fifth of the diameter of it [n], m."""


class Measured(NamedTuple):
    """A distance between two spheres."""

    value: float
    """m."""
    sigma: float
    """Predicted standard deviation [m]."""


def fit_sphere(samples: Samples, click: np.ndarray, diameter: float, scanner: Scanner, *, free: bool) -> Fit:
    """The sphere next to a place.

    Weighted least squares of the distances to the surface, without outliers: the noise of a point lies along its ray,
    and its component along the normal sets the weight.

    Args:
        samples: Points of the cloud.
        click: About where its centre is, to within a hand's breadth [3], m.
        diameter: Its calibrated diameter [m]; if `free`, it only starts the search.
        scanner: The scanner that the cloud was made with.
        free: Whether the diameter is found too.

    Returns:
        The fit; centre in the frame of the samples.

    Raises:
        ValueError: If there are too few points, or none that lie on such a sphere.
    """
    near = samples.take(np.linalg.norm(samples.p - click, axis=1) < diameter / 2 + _REACH)
    if len(near.p) < 30:
        raise ValueError(f"only {len(near.p)} points within {diameter / 2 + _REACH:.3f} m of {click}")
    centre, radius = _search(near.p, diameter / 2), diameter / 2
    kept = np.zeros(len(near.p), bool)
    for _ in range(20):
        residual, normal, cap = _look(near, centre, radius)
        cap &= np.abs(residual) < 0.2 * diameter
        sigma = _sigma_across(near, normal)
        scale = 1.4826 * np.median(np.abs(residual[cap] / sigma[cap]))
        now = cap & (np.abs(residual) < KEPT * max(scale, 1.0) * sigma)
        step = _factors(near.take(now), normal[now], free) @ residual[now]
        centre = centre + step[:3]
        radius += float(step[3]) if free else 0.0
        if np.array_equal(now, kept) and np.linalg.norm(step) < 1e-7:
            break
        kept = now
    residual, normal, cap = _look(near, centre, radius)
    cap &= np.abs(residual) < 0.2 * diameter
    members = near.take(kept)
    covariance = _covariance(members, normal[kept], _factors(members, normal[kept], free))[:3, :3]
    effect = _effect(members, normal[kept], scanner, free)
    return Fit(centre, radius, covariance, effect, residual[cap])


def distance(first: Fit, second: Fit, scanner: Scanner) -> Measured:
    """Distance between the centres, with its uncertainty by stripes and calibration.

    Args:
        first: One sphere.
        second: The other.
        scanner: The scanner that both were measured with; without covariance it adds nothing.
    """
    apart = second.centre - first.centre
    value = float(np.linalg.norm(apart))
    along = apart / value
    variance = along @ (first.covariance + second.covariance) @ along
    if scanner.covariance is not None:
        effect = along @ (second.effect - first.effect)
        variance += effect @ np.asarray(scanner.covariance, float) @ effect
    return Measured(value, float(np.sqrt(variance)))


def together(fits: dict[str, Fit], pairs: list[tuple[str, str]], scanner: Scanner) -> np.ndarray:
    """Predicted covariance of distances between spheres: they share spheres and calibration.

    Args:
        fits: Spheres by name.
        pairs: Names of the two spheres of each distance.
        scanner: The scanner that all were measured with.

    Returns:
        [pairs, pairs], m^2.
    """
    number = {name: 3 * index for index, name in enumerate(fits)}
    rows = np.zeros((len(pairs), 3 * len(fits)))
    for row, (first, second) in zip(rows, pairs, strict=True):
        apart = fits[second].centre - fits[first].centre
        for name, sign in ((first, -1), (second, 1)):
            row[number[name] : number[name] + 3] = sign * apart / np.linalg.norm(apart)
    noise = sum(rows[:, at : at + 3] @ fits[name].covariance @ rows[:, at : at + 3].T for name, at in number.items())
    effect = rows @ np.concatenate([fit.effect for fit in fits.values()])
    return noise if scanner.covariance is None else noise + effect @ np.asarray(scanner.covariance, float) @ effect.T


def band95(residual: np.ndarray) -> float:
    """Width of the narrowest band that holds 95 % of the residuals [n], in their unit. Source: ISO 10360-13."""
    ordered = np.sort(residual)
    count = int(np.ceil(0.95 * len(ordered)))
    return float(np.min(ordered[count - 1 :] - ordered[: len(ordered) - count + 1]))


def _search(p: np.ndarray, radius: float) -> np.ndarray:
    """Centre of the sphere of known radius that most points lie near: through three points, many times."""
    rng = np.random.default_rng(0)
    a, b, c = np.moveaxis(p[rng.integers(len(p), size=(400, 3))], 1, 0)
    ab, ac = b - a, c - a
    normal = np.cross(ab, ac)
    square = np.maximum(np.sum(normal**2, -1, keepdims=True), 1e-18)
    ab2, ac2 = (np.sum(side**2, -1, keepdims=True) for side in (ab, ac))
    to_middle = (ac2 * np.cross(normal, ab) + ab2 * np.cross(ac, normal)) / (2 * square)
    height2 = radius**2 - np.sum(to_middle**2, -1)
    sound = height2 > 0
    foot, up = a + to_middle, normal * np.sqrt(np.maximum(height2, 0.0) / square[:, 0])[:, None]
    # The near side is seen: of both centres the farther one.
    centres = np.where(np.sum(up * foot, -1, keepdims=True) > 0, foot + up, foot - up)[sound]
    some = p[spread_out(len(p), 600, rng)]
    miss = np.abs(np.linalg.norm(some[None] - centres[:, None], axis=-1) - radius)
    return centres[np.argmin(np.minimum(miss, 0.005).sum(1))]


def _look(samples: Samples, centre: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distances from the surface [n], normals [n, 3], and which points are within the cap towards the scanner [n]."""
    apart = samples.p - centre
    length = np.linalg.norm(apart, axis=1)
    normal = apart / length[:, None]
    view = (samples.origin - centre) / np.linalg.norm(samples.origin - centre, axis=1, keepdims=True)
    return length - radius, normal, np.sum(normal * view, -1) > CAP


def _rays(samples: Samples) -> np.ndarray:
    way = samples.p - samples.origin
    return way / np.linalg.norm(way, axis=1, keepdims=True)


def _sigma_across(samples: Samples, normal: np.ndarray) -> np.ndarray:
    """Standard deviation along the normals of a point by its own row alone [n], m; at least 0.1 mm."""
    return np.hypot(samples.sigma_row * np.abs(np.sum(_rays(samples) * normal, -1)), SIGMA_FLOOR_M)


def _factors(samples: Samples, normal: np.ndarray, free: bool) -> np.ndarray:
    """F: centre and radius move by F r, where r are residuals [3 or 4, n]."""
    design = np.column_stack([normal, np.ones(len(normal))] if free else [normal])
    weighted = design / _sigma_across(samples, normal)[:, None] ** 2
    return np.linalg.solve(weighted.T @ design, weighted.T)


def _covariance(samples: Samples, normal: np.ndarray, factors: np.ndarray) -> np.ndarray:
    """Covariance by noise along the rays, part of which neighbours share; [k, k], m^2."""
    view = _rays(samples).mean(0)
    view /= np.linalg.norm(view)
    # `covariance_of` takes displacements along one direction: each factor is for those along the point's own normal.
    share = np.sum(_rays(samples) * normal, -1) / (_rays(samples) @ view)
    return samples.covariance_of(factors * share, view)


def _effect(samples: Samples, normal: np.ndarray, scanner: Scanner, free: bool) -> np.ndarray:
    """Derivative of the centre by the minimal coordinates of the calibration [3, parameters]."""
    part = spread_out(len(samples.p), _COUNTED, np.random.default_rng(0))
    some, facing = samples.take(part), normal[part]
    weights = _factors(some, facing, free)[:3, :, None] * facing
    fill = _COUNTED - len(part)
    index = np.concatenate([np.arange(len(part)), np.zeros(fill, int)])
    weights = np.concatenate([weights, np.zeros((3, fill, 3))], 1)
    with jax.enable_x64(True):
        exact = scanner.without_covariance().as_dtype(jnp.float64)
        moved = _moved(exact, some.p[index], some.laser[index].astype(np.int32), some.angle[index], weights)
        return np.asarray(moved)


@jax.jit
def _moved(scanner: Scanner, p: Array, laser: Array, angle: Array, weights: Array) -> Array:
    """Derivative of sums of weights [k, n, 3] times points: each keeps its pixel and its table angle."""

    def pixel(p: Array, phi: Array) -> Array:
        pose = scanner.pose(phi)
        return scanner.camera.project(pose[:3, :3].T @ (p - pose[:3, 3]))

    q = jax.vmap(pixel)(p, angle)

    def sums(step: Array) -> Array:
        points, _ = jax.vmap(scanner.retract(step).point)(q, laser, angle)
        return jnp.einsum("knj,nj->k", weights, points)

    return jax.jacfwd(sums)(jnp.zeros(len(scanner.parameter_names()), p.dtype))
