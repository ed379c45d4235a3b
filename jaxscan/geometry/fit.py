"""Closed-form fits: principal axes, planes, axes of rotations, homographies; medians, and roots of covariances."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.geometry.arrays import Array


MEDIAN_TO_SIGMA = 1.4826
"""Standard deviation of normal numbers over the median of their sizes."""


class PrincipalAxes(NamedTuple):
    """Mean of points, and their variance along each principal axis."""

    centre: Float[np.ndarray, "*sets 3"]
    """Their weighted mean."""
    variances: Float[np.ndarray, "*sets 3"]
    """Weighted mean squares along the axes, the smallest first."""
    axes: Float[np.ndarray, "*sets 3 3"]
    """Unit vectors, one a row. The first is the normal of the plane of least squares, of either sense."""


class PlaneFit(NamedTuple):
    """Plane `normal . p = distance` through points."""

    normal: np.ndarray
    """Unit normal [3]; the distance is not negative."""
    distance: float
    """Distance of the origin, in the unit of the points."""
    rms: float
    """Root mean square distance of the points from the plane."""
    spread: np.ndarray
    """RMS extent of the points in the plane and across it [3], largest first; if the second is about
    as small as the third, the points lie on a line and determine no plane."""


class AxisFit(NamedTuple):
    """Axis of a rotation: unit `direction` [3], its `point` [3] nearest the origin, `rms` misfit."""

    direction: np.ndarray
    point: np.ndarray
    rms: float


def median_sigma(residuals: Float[np.ndarray, "..."]) -> float:
    """Standard deviation of residuals about 0 by the median of their sizes, which outliers do not move."""
    return MEDIAN_TO_SIGMA * float(np.median(np.abs(residuals)))


def principal_axes(
    points: Float[np.ndarray, "*sets points 3"], weight: Float[np.ndarray, "*sets points"] | None = None
) -> PrincipalAxes:
    """Principal axes of one set of points or of many, each with a weight of 0 or more where they are given."""
    share = np.ones(points.shape[:-1]) if weight is None else weight
    total = share.sum(-1)[..., None]
    centre = (share[..., None] * points).sum(-2) / total
    # Centred first, so that sets far from the origin keep their digits.
    apart = points - centre[..., None, :]
    variances, vectors = np.linalg.eigh((apart * share[..., None]).swapaxes(-1, -2) @ apart / total[..., None])
    return PrincipalAxes(centre, np.maximum(variances, 0.0), vectors.swapaxes(-1, -2))


def fit_plane(points: Array) -> PlaneFit:
    """Total least squares plane through points.

    Args:
        points: The points [n, 3], m; n is 3 or more.

    Returns:
        The plane, with its normal, its distance, and how well the points fit.

    Raises:
        ValueError: If there are fewer than 3 points.
    """
    points = np.asarray(points, np.float64)
    if len(points) < 3:
        raise ValueError(f"A plane needs at least 3 points, got {len(points)}.")
    centre, variances, (normal, _, _) = principal_axes(points)
    if normal @ centre < 0:
        normal = -normal
    spread = np.sqrt(variances[::-1])
    return PlaneFit(normal, float(normal @ centre), float(spread[2]), spread)


def plane_sigma(points: Array, at: Array) -> float:
    r"""Standard deviation of the plane through `points`, perpendicular to it, at another place.

    $$\sigma(x) = \mathrm{rms} \sqrt{(1 + x_1^2 / s_1^2 + x_2^2 / s_2^2) / n}$$

    with x in the plane's own axes from the centre of the points, s their extents, and n the number
    of independent points. Points that follow each other in the given order often share an error
    (of their board, of speckle), so n is reduced by the autocorrelation of the residuals.

    Args:
        points: The points [n, 3] in the order of their measurement; n is 3 or more.
        at: Where to ask [3], the same unit.

    Returns:
        One standard deviation, the same unit.

    Raises:
        ValueError: If there are fewer than 3 points, or they lie on one line.
    """
    points, plane = np.asarray(points, np.float64), fit_plane(points)
    if plane.spread[1] <= 1e-9 * plane.spread[0]:
        raise ValueError("Points on one line determine no plane.")
    centre, _, axes = principal_axes(points)
    away = axes[:0:-1] @ (np.asarray(at, np.float64) - centre) / plane.spread[:2]
    independent = len(points) / _shared_errors(points @ plane.normal - plane.distance)
    return float(plane.rms * np.sqrt((1.0 + away @ away) / independent))


def _shared_errors(residual: np.ndarray) -> float:
    """Number of neighbours that share one error: 1 + 2 * (sum of autocorrelations), cut off at the noise."""
    count = len(residual)
    power = np.abs(np.fft.rfft(residual, 2 * count)) ** 2
    sums = np.fft.irfft(power)[:count]
    if sums[0] <= 0:
        return 1.0
    pairs = np.arange(count, 0, -1)
    correlation = sums / pairs / (sums[0] / count)
    lost = np.flatnonzero(correlation[1 : count // 2] < 2.0 / np.sqrt(pairs[1 : count // 2]))
    last = 1 + (lost[0] if len(lost) else max(count // 2 - 1, 0))
    return float(min(1.0 + 2.0 * correlation[1:last].sum(), count))


def fit_axis(motion: Array) -> AxisFit:
    """Axis of a rotation, from positions of one point or from motions.

    Args:
        motion: Positions [n, 3] of a point that turns with the table (an arc: plane, then
            circle), or rigid motions [n, 4, 4], each from coordinates at one angle to coordinates
            at another (like the paper's Tr). Motions by larger angles weigh more.

    Returns:
        The axis; its direction has no preferred sense. `rms` is the distance of the positions
        from the circle, or the distance by which the motions move the axis, in the input's unit.

    Raises:
        ValueError: If there are fewer than 3 positions, no motion, or nothing turns.

    Source: the paper, equations (9), (10), for a motion with 4 degrees of freedom.
    """
    motion = np.asarray(motion, np.float64)
    return _axis_of_arc(motion) if motion.ndim == 2 else _axis_of_motions(motion)


def _axis_of_arc(points: np.ndarray) -> AxisFit:
    plane = fit_plane(points)
    if plane.spread[1] <= 1e-12:
        raise ValueError("The positions lie on a line: they show no turn.")
    centre = points.mean(0)
    first = np.linalg.svd(points - centre, full_matrices=False)[2][0]
    second = np.cross(plane.normal, first)
    q = np.column_stack([(points - centre) @ first, (points - centre) @ second])
    # x^2 + y^2 = 2 a x + 2 b y + c: linear in the centre (a, b).
    a, b, c = np.linalg.lstsq(np.column_stack([2 * q, np.ones(len(q))]), (q**2).sum(1), rcond=None)[0]
    radial = np.hypot(q[:, 0] - a, q[:, 1] - b) - np.sqrt(c + a * a + b * b)
    point = centre + a * first + b * second
    point = point - (plane.normal @ point) * plane.normal
    return AxisFit(plane.normal, point, float(np.sqrt(np.mean(radial**2) + plane.rms**2)))


def _axis_of_motions(motions: np.ndarray) -> AxisFit:
    if len(motions) == 0:
        raise ValueError("An axis needs at least one motion.")
    turn = motions[:, :3, :3] - np.eye(3)
    if np.abs(turn).max() < 1e-9:
        raise ValueError("The motions do not turn.")
    # Rotations leave the axis unchanged: (R - I) a = 0.
    direction = np.linalg.svd(turn.reshape(-1, 3), full_matrices=False)[2][2]
    shift = motions[:, :3, 3]
    shift = shift - np.outer(shift @ direction, direction)
    point = np.linalg.lstsq(-turn.reshape(-1, 3), shift.ravel(), rcond=1e-9)[0]
    point = point - (direction @ point) * direction
    misfit = turn @ point + shift
    return AxisFit(direction, point, float(np.sqrt((misfit**2).sum(1).mean())))


# Roots of covariances and of informations, in units of each parameter's own size.


# Relative eigenvalue of a matrix of unit diagonal that counts as rounding: its direction is dropped.
_SINGULAR = 1e-13


class Root(NamedTuple):
    """A square root R of a matrix, R' R, by its eigenvectors; the smallest eigenvalues come first."""

    steps: Float[np.ndarray, "params params"]
    """R: one direction a row, of the length of one standard deviation where the matrix is a covariance; 0 where there
    is none."""
    inverse: Float[np.ndarray, "params params"]
    """Its pseudo-inverse."""


def square_root(matrix: Float[np.ndarray, "params params"]) -> Root:
    """The root of a symmetric matrix without negative directions; rows of 0 are parameters that are held."""
    size = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    # Pixels and radians differ by a million: in units of their own sizes all directions are comparable.
    unit = np.where(size > 0, size, 1.0)
    values, axes = np.linalg.eigh(np.where(np.outer(size, size) > 0, matrix / np.outer(unit, unit), 0.0))
    there = values > _SINGULAR * max(values[-1], 1.0) if len(values) else values > 0
    root = np.sqrt(np.where(there, values, 1.0))
    return Root(np.where(there, axes * root, 0.0).T * size, np.where(there, axes / root, 0.0) / unit[:, None])


def root_of(covariance: Float[np.ndarray, "params params"]) -> Float[np.ndarray, "params params"]:
    """Steps, one a row, whose outer products add up to a covariance."""
    return square_root(covariance).steps


# Maps between two planes.


_MIN_POINTS = 6


def direct_homography(
    points: Float[np.ndarray, "*#views n 2"],
    seen: Float[np.ndarray, "*views n 2"],
    keep: Bool[np.ndarray, "*views n"] | None = None,
) -> Float[np.ndarray, "*views 3 3"]:
    """Homography between points of two planes, by the normalised direct linear transformation.

    Args:
        points: Points of the first plane, at least four, no three of them on one line.
        seen: The corresponding points of the second plane.
        keep: Those that count; None: all.

    Returns:
        The map in homogeneous coordinates; its first two columns together have length 1.

    Source: Hartley and Zisserman, Multiple View Geometry, algorithm 4.2.
    """
    keep = np.ones(seen.shape[:-1], bool) if keep is None else keep
    (to_points, x), (to_seen, u) = _normalised(np.broadcast_to(points, seen.shape), keep), _normalised(seen, keep)
    rows = [np.concatenate([x, 0.0 * x], -1), np.concatenate([0.0 * x, x], -1)]
    system = np.concatenate([np.concatenate([rows[k], -u[..., k : k + 1] * x], -1) for k in (0, 1)], axis=-2)
    # The triangle of its QR decomposition has the same null vector, and is small.
    homography = np.linalg.svd(np.linalg.qr(system, mode="r"))[2][..., -1, :].reshape(*seen.shape[:-2], 3, 3)
    homography = np.linalg.inv(to_seen) @ homography @ to_points
    return homography / np.linalg.norm(homography[..., :2], axis=(-2, -1), keepdims=True)


def apply_homography(
    homography: Float[np.ndarray, "*views 3 3"], points: Float[np.ndarray, "*#views n 2"]
) -> Float[np.ndarray, "*views n 2"]:
    """Points mapped to the other plane; a point at infinity becomes a large number."""
    mapped = _homogeneous(points) @ np.swapaxes(homography, -1, -2)
    return mapped[..., :2] / np.where(np.abs(mapped[..., 2:]) < 1e-12, 1e-12, mapped[..., 2:])


def fixes_plane(points: Float[np.ndarray, "n 2"]) -> bool:
    """Whether points of a plane fix a pose or a homography: six or more that are not on one line."""
    if len(points) < _MIN_POINTS:
        return False
    # On a grid even the narrowest spread beside a line is large.
    spread = np.linalg.svd(points - points.mean(0), compute_uv=False)
    return bool(spread[1] > 0.05 * spread[0])


def _homogeneous(points: np.ndarray) -> np.ndarray:
    return np.concatenate([points, np.ones_like(points[..., :1])], axis=-1)


def _normalised(points: np.ndarray, keep: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A map to coordinates of size 1 about the middle, and the points in them; points that do not count are 0."""
    weight = keep[..., None] / np.maximum(keep.sum(-1), 1)[..., None, None]
    centre = np.sum(weight * points, axis=-2, keepdims=True)
    size = np.maximum(np.sqrt(np.sum(weight * (points - centre) ** 2, axis=(-2, -1)) / 2.0), 1e-12)[..., None]
    to = np.tile(np.eye(3), (*size.shape[:-1], 1, 1))
    to[..., :2, 2], to[..., [0, 1], [0, 1]] = -centre[..., 0, :] / size, 1.0 / size
    return to, keep[..., None] * _homogeneous((points - centre) / size[..., None])
