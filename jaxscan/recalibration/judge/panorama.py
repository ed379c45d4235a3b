"""Distances of a sweep's points from their planes over the whole panorama, before and after."""

import numpy as np
from jaxtyping import Float, Int

from jaxscan.geometry import Scanner
from jaxscan.recalibration.observed import SweepStripes
from jaxscan.recalibration.result import PanoramaOfWalls
from jaxscan.recalibration.triangulate import triangulate_points


# Cells of the picture at most, and points that are averaged in it.
_PROFILES, _LINES, _POINTS = 720, 400, 300_000
_LEAST_POINTS = 30


def panorama_of(
    sweep: SweepStripes,
    labels: Int[np.ndarray, "profiles lines"],
    scanners: tuple[Scanner, Scanner],
    corrections: tuple[Float[np.ndarray, " records"], Float[np.ndarray, " records"]],
) -> PanoramaOfWalls:
    """Means over cells of the grid of the distances from the planes through each patch.

    Args:
        sweep: The stripes.
        labels: Number of the plane of each point, -1 where there is none.
        scanners: The stored and the new one.
        corrections: Of the angles of every record, with each of them [rad].
    """
    profile, line = np.nonzero((labels >= 0) & sweep.valid)
    some = np.unique(np.linspace(0, max(len(profile) - 1, 0), min(_POINTS, len(profile))).round().astype(int))
    profile, line = profile[some], line[some]
    number = labels[profile, line]
    # Bounds of the cells: profiles that hold stripes are spread evenly.
    height, width = min(_PROFILES, labels.shape[0]), min(_LINES, labels.shape[1])
    cell = profile * height // labels.shape[0] * width + line * width // labels.shape[1]
    across = sweep.centre[profile, line]
    q = np.stack([across, line] if sweep.stripe_axis == "rows" else [line, across], axis=-1)
    record = sweep.record[profile]
    pictures = []
    for scanner, correction in zip(scanners, corrections, strict=True):
        place, valid = triangulate_points(scanner, q, sweep.laser[profile], (sweep.angle + correction)[record])
        error, valid = _distances(place, number, valid)
        count = np.bincount(cell[valid], minlength=height * width)
        mean = np.bincount(cell[valid], error[valid], minlength=height * width) / np.maximum(count, 1)
        pictures.append((mean.reshape(height, width), (count > 0).reshape(height, width)))
    (before, seen), (after, again) = pictures
    middle = (np.arange(height) * labels.shape[0] // height).clip(max=labels.shape[0] - 1)
    return PanoramaOfWalls(sweep.name, before, after, seen & again, sweep.angle[sweep.record[middle]])


def _distances(
    place: Float[np.ndarray, "n 3"], number: Int[np.ndarray, " n"], valid: np.ndarray
) -> tuple[Float[np.ndarray, " n"], np.ndarray]:
    """Distance of each point from the best plane through those of its number; and which have one."""
    error, known = np.zeros(len(place)), np.zeros(len(place), bool)
    for each in np.unique(number[valid]):
        own = np.flatnonzero(valid & (number == each))
        if len(own) >= _LEAST_POINTS:
            arm = place[own] - place[own].mean(0)
            _, axes = np.linalg.eigh(arm.T @ arm)
            normal = axes[:, 0] * np.sign(axes[:, 0] @ place[own].mean(0) or 1.0)
            error[own], known[own] = arm @ normal, True
    return error, known
