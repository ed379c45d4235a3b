"""Maps between two planes."""

import numpy as np
from jaxtyping import Bool, Float


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
