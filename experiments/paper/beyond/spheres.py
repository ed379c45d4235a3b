"""Spheres in a cloud by the calibration that they share, and distances between them."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxscan
from jaxscan import Scanner
from jaxscan.errors import MeasurementError
from jaxscan.geometry import Array
from jaxscan.measurement.samples import Samples, spread_out
from jaxscan.measurement.spheres import fit_sphere as sphere_of
from jaxscan.measurement.spheres import sphere_factors


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
    """The sphere next to a place, and what the calibration does to its centre.

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
    try:
        found = sphere_of(samples, click, diameter / 2, free=free)
    except MeasurementError as problem:
        raise ValueError(str(problem)) from problem
    effect = _effect(found.members, found.normal, scanner, free)
    return Fit(found.centre, found.radius, found.covariance[:3, :3], effect, found.residual)


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


def _effect(samples: Samples, normal: np.ndarray, scanner: Scanner, free: bool) -> np.ndarray:
    """Derivative of the centre by the minimal coordinates of the calibration [3, parameters]."""
    part = spread_out(len(samples.p), _COUNTED, np.random.default_rng(0))
    some, facing = samples.take(part), normal[part]
    weights = sphere_factors(some, facing, free=free)[:3, :, None] * facing
    fill = _COUNTED - len(part)
    index = np.concatenate([np.arange(len(part)), np.zeros(fill, int)])
    weights = np.concatenate([weights, np.zeros((3, fill, 3))], 1)
    with jax.enable_x64(True):
        moved = _moved(scanner.rig, some.p[index], some.laser[index].astype(np.int32), some.angle[index], weights)
        return np.asarray(moved)


@jax.jit
def _moved(rig: jaxscan.Rig, p: Array, laser: Array, angle: Array, weights: Array) -> Array:
    """Derivative of sums of weights [k, n, 3] times points: each keeps its pixel and its table angle."""
    q = jaxscan.pixels(rig, p, angle)
    sums = lambda step: jnp.einsum("knj,nj->k", weights, jaxscan.points(rig.retract(step), q, laser, angle))
    return jax.jacfwd(sums)(jnp.zeros(rig.parameter_count(), p.dtype))
