"""Maps between two planes."""

import numpy as np
from jaxtyping import Float


_MIN_POINTS = 6


def direct_homography(points: Float[np.ndarray, "n 2"], seen: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "3 3"]:
    """Homography between points of two planes, by the normalised direct linear transformation.

    Args:
        points: Points of the first plane, at least four, no three of them on one line.
        seen: The corresponding points of the second plane.

    Returns:
        The map in homogeneous coordinates; its first two columns together have length 1.

    Source: Hartley and Zisserman, Multiple View Geometry, algorithm 4.2.
    """
    to_points, to_seen = _normalisation(points), _normalisation(seen)
    x, u = _homogeneous(points) @ to_points.T, _homogeneous(seen) @ to_seen.T
    zero = np.zeros_like(x)
    system = np.concatenate([np.hstack([x, zero, -u[:, :1] * x]), np.hstack([zero, x, -u[:, 1:2] * x])])
    # The triangle of its QR decomposition has the same null vector, and is small.
    homography = np.linalg.svd(np.linalg.qr(system, mode="r"))[2][-1].reshape(3, 3)
    homography = np.linalg.inv(to_seen) @ homography @ to_points
    return homography / np.linalg.norm(homography[:, :2])


def apply_homography(
    homography: Float[np.ndarray, "3 3"], points: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 2"]:
    """Points mapped to the other plane; a point at infinity becomes a large number."""
    mapped = _homogeneous(points) @ homography.T
    return mapped[:, :2] / np.where(np.abs(mapped[:, 2:]) < 1e-12, 1e-12, mapped[:, 2:])


def fixes_plane(points: Float[np.ndarray, "n 2"]) -> bool:
    """Whether points of a plane fix a pose or a homography: six or more that are not on one line."""
    if len(points) < _MIN_POINTS:
        return False
    # On a grid the narrowest spread that is not a line is large.
    spread = np.linalg.svd(points - points.mean(0), compute_uv=False)
    return bool(spread[1] > 0.05 * spread[0])


def _homogeneous(points: np.ndarray) -> np.ndarray:
    return np.column_stack([points, np.ones(len(points))])


def _normalisation(points: np.ndarray) -> np.ndarray:
    centre, size = points.mean(0), max(float(points.std()), 1e-12)
    return np.array([[1 / size, 0, -centre[0] / size], [0, 1 / size, -centre[1] / size], [0, 0, 1.0]])
