"""The distance between two single points of a cloud."""

from dataclasses import dataclass

import numpy as np

from jaxscan.errors import MeasurementError
from jaxscan.geometry import Scanner
from jaxscan.measurement.checked import checked_samples
from jaxscan.measurement.planes import Point
from jaxscan.measurement.samples import SIGMA_FLOOR_M, Cloud, CloudSamples, places_of
from jaxscan.measurement.systematic import systematic_sigma


@dataclass(frozen=True)
class PointDistance:
    """Distance between two points of a cloud, as they were measured."""

    value_m: float
    """[m]"""
    sigma_m: float
    """Its predicted standard deviation [m]: random and systematic together."""
    sigma_random_m: float
    """From the noise of the two points along their rays."""
    sigma_systematic_m: float
    a_m: np.ndarray
    """The first point [3], m."""
    b_m: np.ndarray
    """The second point [3], m."""


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
        MeasurementError: If there is no point near a place, or both places have the same.
    """
    samples = checked_samples(cloud)
    nearest = [_nearest(samples, place, within_m) for place in (a, b)]
    if nearest[0] == nearest[1]:
        raise MeasurementError("Both places have the same nearest point; give places farther apart.")
    order = np.argsort(nearest)
    # Points are taken in their order in the cloud.
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
    return PointDistance(value, float(np.hypot(random, systematic)), random, systematic, ends.p[0], ends.p[1])


def _nearest(samples: CloudSamples, place: Point, within_m: float) -> int:
    distance, nearest, start = np.inf, 0, 0
    for block in samples.blocks():
        away = np.linalg.norm(block.p - np.asarray(place, np.float64), axis=1)
        best = int(np.argmin(away))
        if away[best] < distance:
            distance, nearest = float(away[best]), start + best
        start += len(away)
    if distance > within_m:
        text = "(" + ", ".join(f"{x:.3f}" for x in np.asarray(place)) + ")"
        raise MeasurementError(
            f"The point nearest {text} is {distance:.3f} m away, expected one within {within_m:g} m: give a place "
            "on a surface."
        )
    return nearest
