"""How far a surface is from its plane, place by place."""

from dataclasses import dataclass

import numpy as np

from jaxscan.errors import MeasurementError
from jaxscan.measurement.planes import Plane, Point, facing, patch_around, place_words
from jaxscan.measurement.samples import Cloud, Samples, checked_samples, spread_out
from jaxscan.measurement.walls import refine_wall


TRIES = 300
VOTERS = 2000
FEWEST = 3
"""Smallest number of points of a cell."""
MOST_CELLS = 1_000_000


@dataclass(frozen=True)
class DeviationMap:
    """Distances of a surface from its plane in square cells [rows, columns]; missing cells are zero, not `seen`.

    The middle of the first cell is at `origin_m` in the scanner's frame; columns run `across`, rows `up`, and the
    plane's normal looks at the scanner.
    """

    deviation_m: np.ndarray
    """Mean distance of the cell's points from the plane, towards the scanner positive [rows, columns], m."""
    sigma_m: np.ndarray
    """Standard deviation of this distance, from noise of the points and fit of the plane [rows, columns], m."""
    points: np.ndarray
    seen: np.ndarray
    cell_m: float
    origin_m: np.ndarray
    across: np.ndarray
    """Direction of the columns [3], scanner frame: horizontal, to the right as the scanner sees it."""
    up: np.ndarray
    normal: np.ndarray
    rms_m: float
    least_m: float
    most_m: float


def measure_deviations(
    cloud: Cloud, point: Point, *, radius_m: float = 0.5, cell_m: float = 0.05, seed: int = 0
) -> DeviationMap:
    """The deviations of a surface from its plane around a place.

    The plane is that of most points: what stands out or lies deeper does not shift it. The covariance of the
    calibration is not part of sigma, because neighbouring points share its errors.

    Args:
        cloud: The cloud.
        point: A point of the plane [3], m, scanner frame.
        radius_m: Points within this distance of it are looked at [m].
        cell_m: Size of a cell [m].
        seed: Seed of the random hypotheses; the result is deterministic.

    Returns:
        Deviations and their standard deviations in square cells.

    Raises:
        MeasurementError: If there are too few points, no plane, or too many cells.
    """
    patch = patch_around(checked_samples(cloud), point, radius_m)
    if (2.0 * radius_m / cell_m) ** 2 > MOST_CELLS:
        raise MeasurementError(f"Cells of {1e3 * cell_m:g} mm would be too many; choose larger cells.")
    plane = _plane(patch, point, radius_m, np.random.default_rng(seed))
    inward = facing(plane, (patch.origin - patch.p).mean(0))
    normal = inward.normal
    side = np.cross([0.0, 0.0, 1.0], normal)
    across = np.array([1.0, 0.0, 0.0]) if np.linalg.norm(side) < 0.1 else side / np.linalg.norm(side)
    across = across - (across @ normal) * normal
    across /= np.linalg.norm(across)
    up = np.cross(normal, across)
    middle = np.asarray(point, np.float64)
    foot = middle - (normal @ middle - inward.distance) * normal
    half = max(1, int(np.ceil(radius_m / cell_m)))
    place = np.floor(np.stack([(patch.p - foot) @ up, (patch.p - foot) @ across]) / cell_m + half).astype(int)
    inside = np.asarray(((place >= 0) & (place < 2 * half)).all(0))
    patch, place = patch.take(inside), place[:, inside]
    shape = (2 * half, 2 * half)
    cell = place[0] * shape[1] + place[1]
    deviation, noise, points = _cell_means(patch, normal, patch.p @ normal - inward.distance, cell, shape[0] * shape[1])
    seen = points >= FEWEST
    if not seen.any():
        raise MeasurementError(f"No cell of {1e3 * cell_m:g} mm has {FEWEST} points; choose larger cells.")
    rows, columns = np.divmod(np.arange(len(points)), shape[1])
    first = foot + (0.5 - half) * cell_m * (across + up)
    centres = first + cell_m * (columns[:, None] * across + rows[:, None] * up)
    heights = np.column_stack([np.ones(len(centres)), (centres - plane.centre) @ plane.axes.T])
    fitted = np.einsum("ni,ij,nj->n", heights, plane.covariance, heights)
    sigma = np.where(seen, np.sqrt(noise + fitted), 0.0)
    deviation = np.where(seen, deviation, 0.0)
    return DeviationMap(
        deviation_m=deviation.reshape(shape),
        sigma_m=sigma.reshape(shape),
        points=points.reshape(shape),
        seen=seen.reshape(shape),
        cell_m=cell_m,
        origin_m=first,
        across=across,
        up=up,
        normal=normal,
        rms_m=float(np.sqrt(np.mean(deviation[seen] ** 2))),
        least_m=float(deviation[seen].min()),
        most_m=float(deviation[seen].max()),
    )


def _plane(patch: Samples, point: Point, radius_m: float, rng: np.random.Generator) -> Plane:
    """The plane of most points: the one through three points with the least median distance, fitted to all near it."""
    some = patch.p[spread_out(len(patch.p), VOTERS, rng)]
    a, b, c = np.moveaxis(some[rng.integers(len(some), size=(TRIES, 3))], 1, 0)
    normals = np.cross(b - a, c - a)
    size = np.linalg.norm(normals, axis=1)
    # Three points along a line, or of one place, lie in many planes.
    wide = size > 0.05 * radius_m**2
    if not wide.any():
        raise MeasurementError(
            f"The {len(patch.p)} points within {radius_m} m of {place_words(point)} determine no plane; "
            "pick a flat place or a larger radius."
        )
    normals, a = normals[wide] / size[wide, None], a[wide]
    distances = np.einsum("ij,ij->i", normals, a)
    median = np.median(np.abs(some @ normals.T - distances), axis=0)
    best = int(np.argmin(median))
    normal, distance = normals[best], float(distances[best])
    axes = np.linalg.svd(normal[None])[2][1:]
    given = Plane(normal, distance, patch.p.mean(0), axes, np.zeros((3, 3)))
    outward = facing(given, (patch.p - patch.origin).mean(0))
    return refine_wall(patch, outward, rng=rng).plane


def _cell_means(
    patch: Samples, normal: np.ndarray, residual: np.ndarray, cell: np.ndarray, cells: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean residual of each cell [m], its variance by noise [m^2], and its points."""
    points = np.bincount(cell, minlength=cells)
    some = np.maximum(points, 1)
    mean = np.bincount(cell, residual, cells) / some
    variance = np.bincount(cell, patch.sigma_across(normal) ** 2, cells) / some
    # Neighbours of one profile share their noise, within the cell.
    shared = np.bincount(cell, patch.shared, cells) / some
    profiles = np.bincount(np.unique(np.stack([cell, patch.profile]), axis=1)[0], minlength=cells)
    independent = some / np.maximum(np.minimum(shared, some / np.maximum(profiles, 1)), 1.0)
    return mean, variance / independent, points
