"""The plain pipeline beside which jaxscan is compared: OpenCV's boards and lens, centroids of lines, planes.

Every step takes the result of the one before as exact, and nothing of jaxscan is used. The paper's method
(`paper.methods`), the one for other people's captures (`real_sets.measure`) and the one for worlds of known truth
(`unkind.plain`) are made of these parts. Coordinates are metres; pixel (0, 0) is the centre of the top-left pixel.
"""

from typing import Any, NamedTuple

import cv2
import numpy as np
from scipy.optimize import least_squares  # type: ignore[import-untyped]

from experiments.report import rms


FISHEYE_FLAGS = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_RECOMPUTE_EXTRINSIC | cv2.CALIB_FIX_SKEW


class Lens(NamedTuple):
    """A camera of OpenCV."""

    matrix: np.ndarray
    distortion: np.ndarray
    is_fisheye: bool = False

    def straight(self, q: np.ndarray) -> np.ndarray:
        """Directions [n, 2] (x/z, y/z) of pixels [n, 2]."""
        points = np.ascontiguousarray(q, np.float64).reshape(-1, 1, 2)
        undo = cv2.fisheye.undistortPoints if self.is_fisheye else cv2.undistortPoints
        return undo(points, self.matrix, self.distortion).reshape(-1, 2)

    def project(self, points: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """Pixels [n, 2] of points [n, 3] of the board in a pose (rotation vector, translation) [6]."""
        shaped = np.ascontiguousarray(points, np.float64).reshape(-1, 1, 3)
        through = cv2.fisheye.projectPoints if self.is_fisheye else cv2.projectPoints
        return through(shaped, pose[:3], pose[3:], self.matrix, self.distortion)[0].reshape(-1, 2)


def grid(board: dict[str, Any]) -> np.ndarray:
    """Corners, or centres of circles, [n, 3]; m."""
    pitch = board["spacing_mm" if board["type"] == "circles" else "square_mm"] / 1000
    points = np.zeros((board["columns"] * board["rows"], 3))
    points[:, :2] = pitch * np.mgrid[: board["columns"], : board["rows"]].T.reshape(-1, 2)
    return points


def rigid(turn: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Motion [4, 4] of OpenCV's rotation vector [3, 1], rad, and translation [3, 1]."""
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = cv2.Rodrigues(turn)[0], shift[:, 0]
    return out


def chessboard(
    image: np.ndarray, size: tuple[int, int], *, steps: int = 60, least: float = 1e-4, enlarged: bool = False
) -> np.ndarray | None:
    """Inner corners of a chessboard, refined by `cornerSubPix`.

    Args:
        image: uint8 [rows, columns].
        least: Movement at which it ends [px].

    Returns:
        float32 [rows of corners, columns of corners, 2], px; None if the board is not found.
    """
    found, q = cv2.findChessboardCorners(image, size)
    if not found and enlarged:
        found, q = cv2.findChessboardCorners(cv2.resize(image, None, fx=2, fy=2), size)
        q = (q - 0.5) / 2 if found else q
    if not found:
        return None
    lattice = q.reshape(size[1], size[0], 2)
    smallest = min(np.linalg.norm(np.diff(lattice, axis=axis), axis=-1).min() for axis in (0, 1))
    half = int(np.clip(smallest / 3, 2, 11))
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, steps, least)
    refined = cv2.cornerSubPix(image, lattice.reshape(-1, 1, 2).astype(np.float32), (half, half), (-1, -1), stop)
    return refined.reshape(lattice.shape)


def find(grey: np.ndarray, board: dict[str, Any]) -> np.ndarray | None:
    """Corners, or centres of circles, [n, 2] of a whole board, or None."""
    size = (board["columns"], board["rows"])
    if board["type"] == "circles":
        found, q = cv2.findCirclesGrid(grey, size)
        return q.reshape(-1, 2).astype(np.float64) if found else None
    q = chessboard(grey, size)
    return None if q is None else q.reshape(-1, 2).astype(np.float64)


def calibrate(views: list[np.ndarray], points: np.ndarray, size: tuple[int, int], kind: str) -> tuple[Lens, np.ndarray]:
    """A camera, and the board's shape.

    Args:
        views: Corners [n, 2] of each view; px.
        points: Corners of the flat board [n, 3]; m.

    Returns:
        The lens, and the corners of the board as used or found [n, 3]; m.
    """
    seen = [q.reshape(-1, 1, 2).astype(np.float32) for q in views]
    flat = [points.reshape(-1, 1, 3).astype(np.float32)] * len(views)
    if kind == "fisheye":
        f = max(size) / np.pi
        guess = np.array([[f, 0.0, size[0] / 2], [0.0, f, size[1] / 2], [0.0, 0.0, 1.0]])
        shaped, corners = [points[None].astype(np.float64)] * len(views), [q[None].astype(np.float64) for q in views]
        done = cv2.fisheye.calibrate(shaped, corners, size, guess, np.zeros((4, 1)), flags=FISHEYE_FLAGS)
        return Lens(done[1], done[2], True), points
    if kind == "flat":
        _, matrix, distortion, *_ = cv2.calibrateCamera(flat, seen, size, None, None)
        return Lens(matrix, distortion), points
    # The corner that is held with the first and the last: the end of the first row.
    fixed = int(np.flatnonzero(np.diff(points[:, 1]) > 0)[0])
    _, matrix, distortion, _, _, shape, *_ = cv2.calibrateCameraRO(flat, seen, size, fixed, None, None)
    return Lens(matrix, distortion), shape.reshape(-1, 3).astype(np.float64)


def pose_of(lens: Lens, points: np.ndarray, q: np.ndarray) -> np.ndarray:
    """The pose (rotation vector, translation) [6] that shows the board's points at these pixels, by least squares."""
    _, turn, shift = cv2.solvePnP(points, lens.straight(q), np.eye(3), None)
    start = np.concatenate([turn.ravel(), shift.ravel()])
    return least_squares(lambda x: (lens.project(points, x) - q).ravel(), start, method="lm").x


def residuals(lens: Lens, points: np.ndarray, views: list[np.ndarray]) -> np.ndarray:
    """Distances of corners from their predictions [views, n] where every view is given its best pose; px."""
    return np.array([np.linalg.norm(lens.project(points, pose_of(lens, points, q)) - q, axis=1) for q in views])


def held_out(views: list[np.ndarray], points: np.ndarray, size: tuple[int, int], kind: str) -> float:
    """RMS of the corners of views that had no part in the solve but for their pose; both halves, px."""
    parts = []
    for half in (0, 1):
        lens, shape = calibrate(views[half::2], points, size, kind)
        parts.append(residuals(lens, shape, views[1 - half :: 2]).ravel())
    return rms(np.concatenate(parts))


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


def around(light: np.ndarray, peak: np.ndarray, half: int) -> tuple[np.ndarray, np.ndarray]:
    """Columns within `half` of the peak of each row [rows, 2 half + 1], all in the image, and the light there."""
    columns = np.clip(peak, half, light.shape[1] - half - 1)[:, None] + np.arange(-half, half + 1)
    return columns, np.take_along_axis(light, columns, axis=1)


def gravity_of(weights: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Centres of gravity [rows] of weights at columns [rows, n]; zero where there is no weight."""
    return (weights * columns).sum(1) / np.maximum(weights.sum(1), 1e-9)


def centres(light: np.ndarray, stripe_axis: str, inside: np.ndarray | None = None) -> np.ndarray:
    """Pixels [n, 2] of the brightest stripe of every row (or column): the centroid around the highest value.

    Args:
        light: The laser's light [rows, columns].
        inside: bool [rows, columns]: where to look.
    """
    masked = light if inside is None else np.where(inside, light, -np.inf)
    if stripe_axis == "columns":
        light, masked = light.T, masked.T
    columns, values = around(light, masked.argmax(1), HALF)
    values = values - values.min(1, keepdims=True)
    found = (masked.max(1) > LEAST_DN) & (values.max(1) > LEAST_DN)
    # Half of the peak and more: what lies lower pulls the centre towards the middle of the window.
    u = gravity_of(np.where(values > 0.5 * values.max(1, keepdims=True), values, 0.0), columns)
    q = np.column_stack([u, np.arange(len(light))])[found]
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


def principal_axes(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean of points [n, 3], and unit rows [3, 3]: two directions in their plane of least squares, then its normal."""
    middle = points.mean(0)
    return middle, np.linalg.svd(points - middle, full_matrices=False)[2]


def plane_of(points: np.ndarray) -> Plane:
    """The plane with the least sum of squared distances; its distance is positive."""
    middle, (_, _, normal) = principal_axes(points)
    distance = float(normal @ middle)
    return Plane(normal, distance) if distance >= 0 else Plane(-normal, -distance)


def trimmed(points: np.ndarray, rounds: int) -> tuple[np.ndarray, np.ndarray]:
    """Middle and normal of a plane through points [n, 3], fitted again without those beyond three robust deviations."""
    for _ in range(rounds):
        middle, (_, _, normal) = principal_axes(points)
        off = np.abs((points - middle) @ normal)
        points = points[off < 3 * 1.4826 * np.median(off) + 1e-6]
    return middle, normal


def board_plane(pose: np.ndarray) -> Plane:
    """The plane of a flat board in a pose (rotation vector, translation) [6]."""
    normal = cv2.Rodrigues(pose[:3])[0][:, 2]
    return Plane(normal, float(normal @ pose[3:]))


def consensus(views: list[np.ndarray], seed: int = 0) -> tuple[Plane, np.ndarray]:
    """The plane that most points share, by drawing two points of one view and one of another.

    Args:
        views: Points of the line in every view [n, 3]; m.
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
    plane = plane_of(points)
    for _ in range(5):
        plane = plane_of(points[best])
        best = np.abs(plane.off(points)) < limits
    ends = np.cumsum([len(view) for view in views])[:-1]
    return plane, np.array([part.mean() > 0.5 for part in np.split(best, ends)])


def spread(distances: np.ndarray) -> float:
    """Robust standard deviation: 1.4826 times the median of the absolute differences from the median."""
    return float(1.4826 * np.median(np.abs(distances - np.median(distances)))) if len(distances) else float("nan")


def angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    """Angle between two planes by their normals."""
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), abs(float(a @ b)))))
