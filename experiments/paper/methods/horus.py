"""The sequential method of the best-known desk scanner, Horus.

Written from facts about it; nothing is copied. Intrinsics by OpenCV from 15 views at most, rounded to three decimals;
the stripe's centroids on boards, moved to a straight line; the sheet by RANSAC and the smallest singular vector; the
axis from one corner of one board over the turn, by a plane and a circle. Choices that these facts leave open favour the
method. The sheet is fitted to the stripes of all lit views of our protocol, not to one sweep of a near board. RANSAC
includes the offset of its hypotheses, which the original omits, and its tolerance of 0.1 mm at desk distance grows with
the square of the distance, as errors of stripes do. The axis comes from the placement with the longest arc. The
original does not correct stripe points for the lens. A descendant of it does; so do the second sheet and `lens=True` of
`cloud`.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from experiments.paper.methods.equations import points_on_board, principal_axes, rigid
from experiments.paper.methods.horus_stripes import CALIBRATION, centres
from experiments.paper.methods.paper_way import find_board
from jaxscan.files import Capture


VIEWS = 15
DESK_M, DESK_TOLERANCE_M = 0.3, 1e-4
TRIALS = 500
LINE_PX = 2.0
"""Distance from the straight line within which a row's centroid is of the stripe [px]."""


class Horus(NamedTuple):
    """A calibration by that method. Lengths in metres, camera frame at angle 0."""

    matrix: np.ndarray
    """[3, 3], px."""
    lens: np.ndarray
    """k1, k2, p1, p2, k3."""
    normal: np.ndarray
    """Of the sheet [3], unit."""
    distance: float
    """Of the sheet: normal . p = distance."""
    lens_normal: np.ndarray
    """The same sheet from stripe points that were corrected for the lens."""
    lens_distance: float
    direction: np.ndarray
    """Of the axis [3], unit; the camera turns right-handed about it where the table's angle grows."""
    point: np.ndarray
    """On the axis [3]."""


class Circle(NamedTuple):
    """A circle in space through points."""

    normal: np.ndarray
    """Of its plane [3], unit."""
    centre: np.ndarray
    radius: float


def calibrate(capture: Capture, *, seed: int = 0) -> Horus:
    """Calibrate from a capture of our protocol.

    Args:
        capture: Free views at angle 0, and placements that are seen from several angles; all with the stripe.
        seed: Of the hypotheses.

    Raises:
        ValueError: If too few boards are found.
    """
    board, records = capture.board, capture.records
    # Twice: all frames at once are too many to keep.
    found = [find_board(capture.frames(index)[1], board.grid(), board.square) for index in range(len(records))]
    free = [view for view, record in zip(found, records, strict=True) if record.placement is None and view is not None]
    chosen = [free[k] for k in np.unique(np.linspace(0, len(free) - 1, min(VIEWS, len(free))).astype(int))]
    if len(chosen) < 3:
        raise ValueError(f"A calibration takes at least three boards, found {len(chosen)}.")
    places, pixels = [view.places for view in chosen], [view.pixels for view in chosen]
    _, matrix, lens, _, _ = cv2.calibrateCamera(places, pixels, capture.image_size, None, None)
    matrix, lens = np.round(matrix, 3), np.round(lens.ravel()[:5], 3)
    pose, points = np.full((len(records), 4, 4), np.nan), []
    for number, view in enumerate(found):
        if view is None:
            continue
        on, off = capture.frames(number)
        _, turn, shift = cv2.solvePnP(view.places, view.pixels, matrix, lens)
        pose[number] = rigid(turn, shift)
        if on is not None and off is not None:
            edge = np.column_stack([board.outline(), np.zeros(4)])
            quad = cv2.projectPoints(edge, turn, shift, matrix, lens)[0][:, 0]
            uv = stripe_on_board(on, off, quad)
            lines = [straightened(uv), straightened(_corrected(matrix, lens, uv))]
            # The lens is ideal: its correction is in the pixels, or is not made.
            points.append([points_on_board(matrix, 0.0, pose[number], line) for line in lines])
    sheets = [
        ransac_plane(np.concatenate([np.zeros((0, 3)), *each]), np.random.default_rng(seed))
        for each in zip(*points, strict=True)
    ]
    if not sheets:
        raise ValueError("No stripe was found on a board.")
    arcs = {}
    for number, record in enumerate(records):
        if record.placement is not None and np.isfinite(pose[number]).all():
            # The board's first corner is its origin.
            arcs.setdefault(record.placement, []).append((float(record.angle), pose[number, :3, 3]))
    longest = max(arcs.values(), key=lambda arc: np.ptp([phi for phi, _ in arc]), default=[])
    if len(longest) < 3:
        raise ValueError("No placement of the board was seen from three angles.")
    direction, point = axis_of([phi for phi, _ in longest], np.array([corner for _, corner in longest]))
    return Horus(matrix, lens, *sheets[0], *sheets[1], direction, point)


def stripe_on_board(on: np.ndarray, off: np.ndarray, quad: np.ndarray) -> np.ndarray:
    """Centroids (u, v) [n, 2] of the stripe on a board whose corners [4, 2] in the image are given; px."""
    inside = np.zeros_like(on)
    cv2.fillConvexPoly(inside, np.round(quad).astype(np.int32), 255)
    u, valid = centres(cv2.bitwise_and(on, inside), cv2.bitwise_and(off, inside), CALIBRATION)
    return np.column_stack([u, np.arange(len(u))])[valid].astype(np.float64)


def straightened(uv: np.ndarray) -> np.ndarray:
    """Centroids [n, 2] moved along their rows to the straight line through most of them; strays are left out."""
    if len(uv) < 2:
        return np.zeros((0, 2))
    u, v = uv.T
    random = np.random.default_rng(len(uv))
    best = np.zeros(len(uv), bool)
    for _ in range(100):
        i, k = random.choice(len(uv), 2, replace=False)
        near = np.abs(u - u[i] - (u[k] - u[i]) / (v[k] - v[i]) * (v - v[i])) < LINE_PX
        best = near if near.sum() > best.sum() else best
    line = np.polyfit(v[best], u[best], 1)
    return np.column_stack([np.polyval(line, v[best]), v[best]])


def ransac_plane(points: np.ndarray, random: np.random.Generator) -> tuple[np.ndarray, float]:
    """Plane normal . p = distance: the best of hypotheses from three points each, then SVD of the points near it.

    Args:
        points: [n, 3], m, origin at the camera.
        random: Of the hypotheses.

    Returns:
        Unit normal [3], and the distance, which is positive.

    Raises:
        ValueError: If there are fewer than three points.
    """
    if len(points) < 3:
        raise ValueError(f"A plane takes at least three points of a stripe, found {len(points)}.")
    tolerance = DESK_TOLERANCE_M * (np.linalg.norm(points, axis=1) / DESK_M) ** 2
    # All points judge the last fit, some of them the hypotheses.
    some = points if len(points) <= 3000 else points[random.choice(len(points), 3000, replace=False)]
    limit = DESK_TOLERANCE_M * (np.linalg.norm(some, axis=1) / DESK_M) ** 2
    best, kept = 0, (np.array([0.0, 0.0, 1.0]), 0.0)
    for _ in range(TRIALS):
        a, b, c = some[random.choice(len(some), 3, replace=False)]
        normal = np.cross(b - a, c - a)
        size = np.linalg.norm(normal)
        if size < 1e-9:
            continue
        normal = normal / size
        count = int((np.abs((some - a) @ normal) < limit).sum())
        if count > best:
            best, kept = count, (normal, float(normal @ a))
    near = points[np.abs(points @ kept[0] - kept[1]) < tolerance]
    centre, (_, _, normal) = principal_axes(near)
    normal = normal * np.sign(normal @ centre)
    return normal, float(normal @ centre)


def fit_circle(points: np.ndarray) -> Circle:
    """Plane through points [n, 3], then the circle in it with the least algebraic error (Kasa 1976)."""
    middle, (first, second, normal) = principal_axes(points)
    x, y = (points - middle) @ first, (points - middle) @ second
    a, b, c = np.linalg.lstsq(np.column_stack([2 * x, 2 * y, np.ones(len(x))]), x**2 + y**2, rcond=None)[0]
    return Circle(normal, middle + a * first + b * second, float(np.sqrt(c + a * a + b * b)))


def axis_of(angles: Sequence[float], corner: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Direction and point of the axis from one corner at several angles of the table.

    Args:
        angles: [n], rad.
        corner: The corner in the camera's frame [n, 3], m.

    Returns:
        Unit direction about which the camera turns right-handed with growing angle, and the circle's centre.
    """
    circle = fit_circle(corner)
    order = np.argsort(angles)
    first, last = corner[order[0]] - circle.centre, corner[order[-1]] - circle.centre
    # Seen from the camera, the room turns in the opposite sense.
    return -np.sign(np.cross(first, last) @ circle.normal) * circle.normal, circle.centre


def points_on_sheet(calibration: Horus, uv: np.ndarray, *, lens: bool = False) -> np.ndarray:
    """Points [..., 3], m, camera frame, at pixels (u, v) [..., 2]; NaN where a ray does not meet the sheet.

    Args:
        calibration: The calibration.
        uv: Pixels.
        lens: Whether the lens is corrected, as the original does not.
    """
    matrix, normal, distance = calibration.matrix, calibration.normal, calibration.distance
    if lens:
        uv, normal, distance = (
            _corrected(matrix, calibration.lens, uv),
            calibration.lens_normal,
            calibration.lens_distance,
        )
    xy = (uv - matrix[:2, 2]) / matrix[[0, 1], [0, 1]]
    ray = np.concatenate([xy, np.ones_like(xy[..., :1])], -1)
    slope = ray @ normal
    return ray * (distance / np.where(slope > 0, slope, np.nan))[..., None]


def cloud(
    calibration: Horus, u: np.ndarray, valid: np.ndarray, angles: np.ndarray, *, lens: bool = False
) -> np.ndarray:
    """Points of a sweep in the camera's frame at angle 0, turned about the axis by the commanded angles.

    Args:
        calibration: The calibration.
        u: Columns of the stripe [records, rows]; px.
        valid: bool [records, rows].
        angles: Of the table [records]; rad.
        lens: As of `points_on_sheet`.

    Returns:
        float64 [records, rows, 3], m; NaN where there is no point.
    """
    rows = np.broadcast_to(np.arange(u.shape[1]), u.shape)
    points = points_on_sheet(calibration, np.stack([np.where(valid, u, np.nan), rows], -1), lens=lens)
    turns = np.stack([cv2.Rodrigues(phi * calibration.direction)[0] for phi in np.asarray(angles, float)])
    return np.einsum("nij,nrj->nri", turns, points - calibration.point) + calibration.point


def save(calibration: Horus, path: Path) -> None:
    """Write a calibration, an npz file."""
    np.savez(path, **calibration._asdict())


def load(path: Path) -> Horus:
    """Read a file of `save`."""
    with np.load(path) as file:
        fields = dict(file)
    return Horus(**fields | {name: float(fields[name]) for name in ("distance", "lens_distance")})


def _corrected(matrix: np.ndarray, lens: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Pixels [..., 2] as a lens without distortion has them; NaN where they are."""
    flat = np.ascontiguousarray(np.nan_to_num(uv.reshape(-1, 1, 2)), dtype=np.float64)
    out = cv2.undistortPoints(flat, matrix, lens, P=matrix) if len(flat) else flat
    return np.where(np.isfinite(uv), out.reshape(uv.shape), np.nan)
