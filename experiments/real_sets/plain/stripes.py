"""The plain method for lines: a centroid on every line, RANSAC for the line and for the plane. No jaxscan here."""

from typing import NamedTuple

import cv2
import numpy as np

from experiments.real_sets.plain.boards import Lens


CHANNEL = {"red": 0, "green": 1, "blue": 2}
LEAST_DN = 4.0
"""Height of a peak above its surroundings that counts as laser."""
HALF = 6
"""Half window of the centroid [px]."""
LINE_PX = 1.5
"""Distance of a centre from its straight line that still belongs to it [px]."""
PLANE = 0.01
"""Distance from the plane that still belongs to it, as a part of the distance from the camera."""
TRIALS = 500


def signal(on: np.ndarray, off: np.ndarray | None, colour: str) -> np.ndarray:
    """The laser's light [rows, columns] of RGB pictures: on minus off, or its channel minus the mean of the others."""
    channel = CHANNEL[colour]
    picture = on.astype(np.float32)
    if off is not None:
        light = picture[..., channel] - off[..., channel].astype(np.float32)
    else:
        light = picture[..., channel] - np.delete(picture, channel, axis=2).mean(2)
    return cv2.GaussianBlur(light, (0, 0), 1.0)


def centres(light: np.ndarray, stripe_axis: str, inside: np.ndarray | None = None) -> np.ndarray:
    """Pixels [n, 2] of the brightest stripe of every row (or column): the centroid around the highest value.

    Args:
        light: The laser's light [rows, columns].
        stripe_axis: "rows" for one centre per row, "columns" for one per column.
        inside: bool [rows, columns]: where to look.
    """
    masked = light if inside is None else np.where(inside, light, -np.inf)
    if stripe_axis == "columns":
        light, masked = light.T, masked.T
    lines, across = light.shape
    peak = np.clip(masked.argmax(1), HALF, across - HALF - 1)
    window = peak[:, None] + np.arange(-HALF, HALF + 1)
    values = np.take_along_axis(light, window, axis=1)
    values = values - values.min(1, keepdims=True)
    found = (masked.max(1) > LEAST_DN) & (values.max(1) > LEAST_DN)
    # Half of the peak and more: what lies lower pulls the centre towards the middle of the window.
    weights = np.where(values > 0.5 * values.max(1, keepdims=True), values, 0.0)
    u = (weights * window).sum(1) / np.maximum(weights.sum(1), 1e-9)
    q = np.column_stack([u, np.arange(lines)])[found]
    return q if stripe_axis == "rows" else q[:, ::-1]


def straight_line(q: np.ndarray, lens: Lens, seed: int = 0) -> np.ndarray:
    """Which pixels [n] lie on the straight line, in undistorted coordinates, that most of them share."""
    if len(q) < 20:
        return np.zeros(len(q), bool)
    p, limit = lens.straight(q), LINE_PX / float(np.sqrt(lens.matrix[0, 0] * lens.matrix[1, 1]))
    draws = np.random.default_rng(seed).integers(0, len(p), (TRIALS, 2))
    # Two draws of one point are no line.
    draws = draws[np.linalg.norm(p[draws[:, 0]] - p[draws[:, 1]], axis=1) > 1e-9]
    if len(draws) == 0:
        return np.zeros(len(q), bool)
    a, b = p[draws[:, 0]], p[draws[:, 1]]
    normal = np.stack([a[:, 1] - b[:, 1], b[:, 0] - a[:, 0]], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    far = np.abs(normal @ p.T - (normal * a).sum(1)[:, None])
    return far[(far < limit).sum(1).argmax()] < limit


class Plane(NamedTuple):
    """n · p = distance, in metres and the camera's coordinates."""

    normal: np.ndarray
    distance: float

    def off(self, points: np.ndarray) -> np.ndarray:
        """Signed distances of points [n, 3]; m."""
        return points @ self.normal - self.distance

    def meet(self, rays: np.ndarray) -> np.ndarray:
        """Points [n, 3] of the plane along directions (x/z, y/z) [n, 2]; m."""
        full = np.column_stack([rays, np.ones(len(rays))])
        return full * (self.distance / (full @ self.normal))[:, None]


def least_squares(points: np.ndarray) -> Plane:
    """The plane with the least sum of squared distances."""
    middle = points.mean(0)
    normal = np.linalg.svd(points - middle, full_matrices=False)[2][-1]
    distance = float(normal @ middle)
    return Plane(normal, distance) if distance >= 0 else Plane(-normal, -distance)


def board_plane(pose: np.ndarray) -> Plane:
    """The plane of a flat board in a pose (rotation vector, translation) [6]."""
    normal = cv2.Rodrigues(pose[:3])[0][:, 2]
    return Plane(normal, float(normal @ pose[3:]))


def consensus(views: list[np.ndarray], seed: int = 0) -> tuple[Plane, np.ndarray]:
    """The plane that most points share, by drawing two points of one view and one of another.

    Args:
        views: Points of the line in every view [n, 3]; m.
        seed: Of the draws.

    Returns:
        The plane, fitted again to its points, and which views (more than half of their points) belong to it.
    """
    rng = np.random.default_rng(seed)
    points, limits = np.concatenate(views), PLANE * np.linalg.norm(np.concatenate(views), axis=1)
    best, most = None, -1
    for _ in range(TRIALS):
        one, other = rng.choice(len(views), 2, replace=False)
        three = np.stack(
            [*views[one][rng.integers(0, len(views[one]), 2)], views[other][rng.integers(len(views[other]))]]
        )
        normal = np.cross(three[1] - three[0], three[2] - three[0])
        if np.linalg.norm(normal) < 1e-12:
            continue
        normal /= np.linalg.norm(normal)
        near = np.abs((points - three[0]) @ normal) < limits
        if near.sum() > most:
            best, most = near, int(near.sum())
    plane = least_squares(points)
    for _ in range(5):
        plane = least_squares(points[best])
        best = np.abs(plane.off(points)) < limits
    ends = np.cumsum([len(view) for view in views])[:-1]
    return plane, np.array([part.mean() > 0.5 for part in np.split(best, ends)])


def spread(distances: np.ndarray) -> float:
    """Robust standard deviation: 1.4826 times the median of the absolute differences from the median."""
    return float(1.4826 * np.median(np.abs(distances - np.median(distances)))) if len(distances) else float("nan")


def angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    """Angle between two planes by their normals."""
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), abs(float(a @ b)))))
