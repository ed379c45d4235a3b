"""Which surfaces are still flat after an adjustment, by the shape of the residuals."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.recalibration.result import Adjusted
from jaxscan.recalibration.triangulate import place_points


_LEAST_M, _MOST_M = 8e-4, 3e-3
"""Unevenness that every wall may have, and that none may have [m]."""
_USUAL = 3.0
"""Unevenness of a flat wall at most, over that of most walls of the room."""
_CURVED = 0.02
"""Curvature of a flat wall at most [1/m], where it is worth its unevenness."""
_STEP_M = 2e-3
"""Height of a step that no flat wall has [m]."""
_SIGMAS = 5.0
_ROUGH_M, _SHARED = 5e-4, 9.0
"""Roughness of walls [m], and factor on the variance for errors that neighbours share, that are believed at most."""
_LOST = 0.3
"""Share of points that were left out from which a surface is no plane."""
_FEWEST = 12
_BLOCK_M, _BLOCK_POINTS = 0.3, 5
_FAR = 6.0
"""Standard deviations at which a residual is cut off."""
_SPLITS = np.linspace(0.08, 0.92, 29)
"""Where a step is looked for: share of the points on one side."""


class Shape(NamedTuple):
    """Structure in the distances of points from their plane."""

    uneven_m: float
    """RMS of means over blocks, or of a bow, beside noise [m]."""
    sure: bool
    curvature: float
    """Largest [1/m], beyond its standard deviations."""
    step_m: float
    """Height of the likeliest step, beyond its standard deviations [m]."""


def flat(adjusted: Adjusted) -> Bool[np.ndarray, " surfaces"]:
    """Which surfaces are flat within noise and the unevenness that most walls of the room have.

    A plane is fitted to the distances of each surface's points. The residuals are compared with a bow, with a step, and
    with means over blocks; noise is widened by the errors that neighbours share.
    """
    surfaces, points = adjusted.surfaces, adjusted.observations.points
    place, _ = place_points(adjusted.scanner, adjusted.observations, adjusted.corrections, stations=adjusted.stations)
    # One bad wall makes all of them rough and their errors shared; it must not excuse itself with that.
    widened, wall = np.sqrt(np.clip(adjusted.inflation, 1.0, _SHARED)), adjusted.wall_m
    stripe = np.sqrt(np.maximum(adjusted.point_sigma**2 - wall**2, (0.1 * adjusted.point_sigma) ** 2))
    noise = widened * np.hypot(stripe, min(wall, _ROUGH_M))
    good = np.ones(len(surfaces.distance), bool)
    shapes: dict[int, Shape] = {}
    for k in range(len(good)):
        own = points.surface == k
        if own.sum() < _FEWEST or np.mean(~adjusted.point_kept[own]) > _LOST:
            good[k] = False
            continue
        sigma = adjusted.point_sigma[own]
        error = np.clip(adjusted.point_error[own], -_FAR * sigma, _FAR * sigma)
        across = _in_plane(place[own], surfaces.normal[k])
        shapes[k] = shape_of(across, error, noise[own])
    if not shapes:
        return good
    usual = float(np.median([shape.uneven_m for shape in shapes.values()]))
    limit = float(np.clip(_USUAL * usual, _LEAST_M, _MOST_M))
    for k, shape in shapes.items():
        bowed = shape.curvature > _CURVED and shape.uneven_m > 0.5 * limit
        good[k] = not ((shape.sure and shape.uneven_m > limit) or bowed or shape.step_m > _STEP_M)
    return good


def shape_of(
    across: Float[np.ndarray, "points 2"], error: Float[np.ndarray, " points"], sigma: Float[np.ndarray, " points"]
) -> Shape:
    """Structure in distances from a plane at places in it [m]; sigmas are widened for errors that neighbours share."""
    across = across - across.mean(0)
    weight = sigma**-2.0
    s, t = across.T
    plane = np.column_stack([np.ones(len(s)), s, t])

    def fitted(design: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        covariance = np.linalg.pinv((design * weight[:, None]).T @ design)
        return covariance @ (design * weight[:, None]).T @ error, covariance

    error = error - plane @ fitted(plane)[0]
    bow = np.column_stack([plane, s * s, s * t, t * t])
    c, covariance = fitted(bow)
    hessian = np.array([[2 * c[3], c[4]], [c[4], 2 * c[5]]])
    doubt = 2.0 * np.sqrt(max(covariance[3, 3], covariance[5, 5]))
    curvature = float(np.abs(np.linalg.eigvalsh(hessian)).max() - _SIGMAS * doubt)
    bowed = bow @ c
    part = c[3:] @ np.linalg.pinv(covariance[3:, 3:]) @ c[3:]
    rms, sure = float(np.sqrt(np.mean(bowed**2))), bool(part > 3.0 + _SIGMAS * np.sqrt(6.0))
    uneven, uneven_sure = _blocks(across, error, weight)
    if uneven_sure and (uneven > rms or not sure):
        rms, sure = uneven, True
    return Shape(rms if sure else 0.0, sure, max(curvature, 0.0), _step(across, error, weight, plane))


def _blocks(across: np.ndarray, error: np.ndarray, weight: np.ndarray) -> tuple[float, bool]:
    """RMS of the means over blocks less their noise, and whether it is more than noise."""
    size = max(_BLOCK_M, float(np.ptp(across, axis=0).max()) / 20)
    at = np.floor(across / size).astype(int)
    number = np.unique(at, axis=0, return_inverse=True)[1].ravel()
    count = np.bincount(number)
    total = np.bincount(number, weight)
    mean = np.bincount(number, weight * error) / total
    many = count >= _BLOCK_POINTS
    if many.sum() < 3:
        return 0.0, False
    mean, variance = mean[many], 1.0 / total[many]
    chi2, freedom = float((mean**2 / variance).sum()), max(int(many.sum()) - 3, 1)
    excess = float(np.average(mean**2 - variance, weights=count[many]))
    return float(np.sqrt(max(excess, 0.0))), bool(chi2 > freedom + _SIGMAS * np.sqrt(2.0 * freedom))


def _step(across: np.ndarray, error: np.ndarray, weight: np.ndarray, plane: np.ndarray) -> float:
    """Height of the likeliest step along either axis of the plane, less its standard deviations [m]."""
    best, found = 0.0, 0.0
    root = np.sqrt(weight)[:, None]
    basis = np.linalg.qr(plane * root)[0]
    whitened = error * root[:, 0]
    whitened = whitened - basis @ (basis.T @ whitened)
    for axis in (0, 1):
        for split in np.quantile(across[:, axis], _SPLITS):
            side = (across[:, axis] > split) * root[:, 0]
            side = side - basis @ (basis.T @ side)
            length = float(side @ side)
            if length <= 0:
                continue
            height = float(side @ whitened) / length
            if height * height * length > best:
                best, found = height * height * length, abs(height) - _SIGMAS / np.sqrt(length)
    return max(float(found), 0.0)


def _in_plane(p: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Coordinates of points in a plane: along the floor first, so that upright edges are a step of one of them."""
    level = np.cross([0.0, 0.0, 1.0], normal)
    if np.linalg.norm(level) < 0.1:
        level = np.cross([1.0, 0.0, 0.0], normal)
    level = level / np.linalg.norm(level)
    return np.stack([p @ level, p @ np.cross(normal, level)], -1)
