"""The paper's method: Zhang's calibration with one radial coefficient, then its equations (3) to (12), one by one.

The paper does not say how it found its stripe: a centre of gravity and the highest pixel are both here.
"""

from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np
from scipy.linalg import expm, logm  # type: ignore[import-untyped]

from experiments.plain import chessboard, principal_axes, rigid
from jaxscan.files import Capture


def rays(matrix: np.ndarray, k: float, uv: np.ndarray) -> np.ndarray:
    """Directions of pixels: equation (3) solved for the undistorted radius by Newton's method.

    Args:
        matrix: A [3, 3], px.
        uv: Pixels [..., 2].

    Returns:
        (x, y, 1) [..., 3], normalised coordinates.
    """
    distorted = np.stack([(uv[..., 0] - matrix[0, 2]) / matrix[0, 0], (uv[..., 1] - matrix[1, 2]) / matrix[1, 1]], -1)
    wanted = np.linalg.norm(distorted, axis=-1)
    radius = wanted.copy()
    for _ in range(8):
        radius -= (radius * (1 + k * radius**2) - wanted) / (1 + 3 * k * radius**2)
    out = np.ones((*wanted.shape, 3))
    out[..., :2] = distorted / (1 + k * radius**2)[..., None]
    return out


def points_on_board(matrix: np.ndarray, k: float, pose: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Points of a board at pixels: rays meet the board, equations (5) to (7).

    Args:
        matrix: A [3, 3], px.
        pose: T_cam_board [4, 4].
        uv: Pixels [n, 2].

    Returns:
        [n, 3], camera frame [m].
    """
    along, normal = rays(matrix, k, uv), pose[:3, 2]
    return along * ((normal @ pose[:3, 3]) / (along @ normal))[:, None]


def linear_plane(points: np.ndarray) -> np.ndarray:
    """a, b, c of a X + b Y + Z = c from points [n, 3] by linear least squares, equation (8)."""
    columns = np.column_stack([points[:, 0], points[:, 1], -np.ones(len(points))])
    return np.linalg.lstsq(columns, -points[:, 2], rcond=None)[0]


def total_plane(points: np.ndarray) -> np.ndarray:
    """a, b, c of the same by total least squares: the sum of squared distances from the plane is least."""
    middle, (_, _, normal) = principal_axes(points)
    return np.array([normal[0], normal[1], normal @ middle]) / normal[2]


def pair_motion(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Tr [4, 4] from the poses of one board that is seen from two table positions, equation (10)."""
    return first @ np.linalg.inv(second)


def power(tr: np.ndarray, n: np.ndarray) -> np.ndarray:
    """Tr^n [n, 4, 4], n any real numbers [n]: equation (11), by the logarithm of the motion."""
    return expm(np.asarray(n, np.float64)[:, None, None] * np.real(logm(tr)))


THRESHOLD = 25
"""Difference above which a pixel counts as the stripe's light [DN]: above the noise of all but the brightest pixels."""
REACH = 8
"""Pixels to both sides of the highest one that a centre of gravity may use."""


def highest(on: np.ndarray, off: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The whole pixel of each row at which the difference of the frames is highest.

    Args:
        on: Laser-on frames, uint8 [rows, columns] or [records, rows, columns].

    Returns:
        u: Column, float64 [(records,) rows]; zero where not valid. The first of equals.
        valid: Whether it is above the threshold, bool of the same shape.
    """
    _, at, valid = _strongest(on, off)
    return np.where(valid, at, 0).astype(np.float64), valid


def gravity(on: np.ndarray, off: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The centre of gravity of the difference, over the pixels round the highest one that are above the threshold.

    Args:
        on: Laser-on frames, uint8 [rows, columns] or [records, rows, columns].

    Returns:
        u: Column, float64 [(records,) rows]; zero where not valid.
        valid: Whether the highest pixel is above the threshold, bool of the same shape.
    """
    light, at, valid = _strongest(on, off)
    steps = np.arange(-REACH, REACH + 1)
    columns = at[..., None] + steps
    inside = (columns >= 0) & (columns < light.shape[-1])
    near = np.take_along_axis(light, np.clip(columns, 0, light.shape[-1] - 1), -1).astype(np.float64)
    over = inside & (near > THRESHOLD)
    # A pixel counts if all between it and the highest one do.
    right = np.logical_and.accumulate(over[..., REACH:], -1)
    left = np.logical_and.accumulate(over[..., REACH::-1], -1)[..., ::-1]
    weight = np.where(np.concatenate([left[..., :-1], right], -1), near, 0.0)
    total = weight.sum(-1)
    shift = (weight * steps).sum(-1) / np.where(total > 0, total, 1.0)
    return np.where(valid, at + shift, 0.0), valid


def _strongest(on: np.ndarray, off: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Difference of the frames [DN], column of the highest pixel of each row, and whether it is above the threshold."""
    if on.shape != off.shape or on.dtype != np.uint8 or off.dtype != np.uint8 or on.ndim not in (2, 3):
        raise ValueError(
            f"Frames must be uint8 [(records,) rows, columns] of one shape, got {on.dtype} {on.shape} and "
            f"{off.dtype} {off.shape}."
        )
    light = on.astype(np.int16)
    light -= off
    at = light.argmax(-1)
    top = np.take_along_axis(light, at[..., None], -1)[..., 0]
    return light, at, top > THRESHOLD


EXTRACTORS = {"gravity": gravity, "highest": highest}
"""Both by name."""
METHODS = {"gravity": "paper's method, centre of gravity", "highest": "paper's method, highest pixel"}
"""The paper's method with either of them, in the words of tables and pictures."""


Extract = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""A stripe finder of `plain_stripes`: frames on and off to columns [rows], and which are valid."""
STRAY = 10.0
"""Pixels farther than this from the straight line through a board's stripe do not belong to it [px]."""


class PaperWay(NamedTuple):
    """A calibration by the paper's method, with its poses and stripes. Lengths in metres."""

    matrix: np.ndarray
    """A of equation (1), [3, 3]; px."""
    k: float
    """The one radial coefficient of equation (3)."""
    pose: np.ndarray
    """T_cam_board of every view [views, 4, 4]; NaN where no board was found."""
    stripe: list[np.ndarray]
    """Pixels (u, v) of the stripe on the board [n, 2], of every view; empty where the view shows none."""
    linear: np.ndarray
    """a, b, c of equations (4) and (8): a X + b Y + Z = c [3]; c in metres."""
    total: np.ndarray
    """The same plane by total least squares [3]."""
    tr: np.ndarray
    """Tr of equation (10): the camera's motion from one table position to the other [4, 4]."""
    pair_angle: float
    """The table's angle between both positions, as commanded [rad]."""


class BoardCorners(NamedTuple):
    """Corners that were found, and where they are on the board."""

    pixels: np.ndarray
    """float32 [corners, 2]."""
    places: np.ndarray
    """float32 [corners, 3], m."""


def calibrate_paper_way(capture: Capture, extract: Extract) -> PaperWay:
    """The paper's calibration of a capture of boards.

    All laser-off images give camera and poses; all pairs with the laser on give the sheet; the last two give Tr.
    """
    board = capture.board
    pairs = [capture.frames(index) for index in range(len(capture.records))]
    found = [None if off is None else find_board(off, board.grid(), board.square) for _, off in pairs]
    matrix, k, pose = calibrate_camera(found, capture.image_size)
    if np.isnan(pose[-2:]).any():
        raise ValueError("The board was not found in the last two views, from which Tr is made.")
    stripe = [np.zeros((0, 2)) for _ in pairs]
    for index, (on, off) in enumerate(pairs):
        if on is not None and off is not None and np.isfinite(pose[index]).all():
            stripe[index] = stripe_on_board(matrix, k, pose[index], board.outline(), extract(on, off))
    lifted = [points_on_board(matrix, k, at, uv) for at, uv in zip(pose, stripe, strict=True) if len(uv)]
    every = np.concatenate([*lifted, np.zeros((0, 3))])
    if len(every) < 3:
        raise ValueError("No stripe was found on a board.")
    first, second = capture.records[-2:]
    turn = float(second.angle - first.angle)
    tr = pair_motion(*pose[-2:])
    return PaperWay(matrix, k, pose, stripe, linear_plane(every), total_plane(every), tr, turn)


def find_board(image: np.ndarray, grid: tuple[int, int], square: float) -> BoardCorners | None:
    """The chessboard in an image, corners refined by OpenCV's `cornerSubPix`.

    Args:
        image: uint8 [rows, columns].
        square: Side of a square [m].
    """
    pixels = chessboard(image, grid, steps=50, least=1e-3, enlarged=True)
    if pixels is None:
        return None
    pixels = _from_black(image, pixels).reshape(-1, 2)
    x, y = np.meshgrid(np.arange(grid[0]), np.arange(grid[1]))
    places = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]) * square
    return BoardCorners(pixels, places.astype(np.float32))


def calibrate_camera(found: list[BoardCorners | None], size: tuple[int, int]) -> tuple[np.ndarray, float, np.ndarray]:
    """Zhang's calibration with one radial coefficient, equations (1) to (3), without skew.

    Args:
        size: Width and height of the images [px].

    Returns:
        matrix: A [3, 3].
        k: The radial coefficient.
        pose: T_cam_board of each view [views, 4, 4]; NaN where there is no board.
    """
    seen = [view for view in found if view is not None]
    if len(seen) < 3:
        raise ValueError(f"A calibration takes at least three boards, found {len(seen)} in {len(found)} views.")
    flags = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    places, pixels = [view.places for view in seen], [view.pixels for view in seen]
    _, matrix, lens, turns, shifts = cv2.calibrateCamera(places, pixels, size, None, None, flags=flags)
    pose = np.full((len(found), 4, 4), np.nan)
    which = [index for index, view in enumerate(found) if view is not None]
    for index, turn, shift in zip(which, turns, shifts, strict=True):
        pose[index] = rigid(turn, shift)
    return matrix, float(lens.ravel()[0]), pose


def board_pose(matrix: np.ndarray, k: float, found: BoardCorners) -> np.ndarray:
    """T_cam_board [4, 4] of a board that took no part in the calibration, by OpenCV's `solvePnP`.

    Args:
        matrix: A [3, 3], px.
    """
    lens = np.array([k, 0.0, 0.0, 0.0])
    _, turn, shift = cv2.solvePnP(found.places, found.pixels, matrix, lens, flags=cv2.SOLVEPNP_ITERATIVE)
    return rigid(turn, shift)


def in_window(way: PaperWay, first: int) -> PaperWay:
    """The same calibration for a camera whose image begins at column `first` of the whole one."""
    matrix = way.matrix.copy()
    matrix[0, 2] -= first
    return way._replace(matrix=matrix)


def stripe_on_board(
    matrix: np.ndarray, k: float, pose: np.ndarray, outline: np.ndarray, found: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """Pixels (u, v) [n, 2] of a stripe that lie on a board's print, without strays.

    Args:
        pose: T_cam_board [4, 4].
        outline: Corners of the printed area in the board's frame [4, 2], m.
    """
    u, valid = found
    uv = np.column_stack([u, np.arange(len(u))])[valid]
    points = points_on_board(matrix, k, pose, uv)
    place = ((points - pose[:3, 3]) @ pose[:3, :3])[:, :2]
    uv = uv[((place > outline[0]) & (place < outline[2])).all(1)]
    return uv[_near_line(uv)]


def points_on_sheet(way: PaperWay, uv: np.ndarray, plane: np.ndarray | None = None) -> np.ndarray:
    """Points of the laser's sheet at pixels, equation (4).

    Args:
        uv: Pixels [..., 2].

    Returns:
        [..., 3], camera frame [m]; NaN where a ray does not meet the sheet in front of the camera.
    """
    a, b, c = way.linear if plane is None else plane
    along = rays(way.matrix, way.k, np.asarray(uv, np.float64))
    share = a * along[..., 0] + b * along[..., 1] + 1
    depth = c / np.where(share * c > 0, share, np.nan)
    return along * depth[..., None]


def paper_cloud(way: PaperWay, u: np.ndarray, valid: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Points of a sweep, equations (4), (11) and (12).

    Args:
        u: Columns of the stripe [records, rows], px.
        valid: Which of them are, bool [records, rows].
        angles: The table's angle of each record [rad].

    Returns:
        float64 [records, rows, 3], m, in the camera's frame at angle 0; NaN where there is no point.
    """
    rows = np.broadcast_to(np.arange(u.shape[1]), u.shape)
    points = points_on_sheet(way, np.stack([np.where(valid, u, np.nan), rows], -1))
    motion = power(way.tr, np.asarray(angles) / way.pair_angle)
    return np.einsum("nij,nrj->nri", motion[:, :3, :3], points) + motion[:, None, :3, 3]


def _from_black(image: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """Corners [rows, columns, 2] in the order that begins at a corner whose square between corners is black.

    A board of one even and one odd number of corners then has one order in all views.
    """
    middles = (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]) / 4
    at = np.clip(np.rint(middles).astype(int), 0, np.array(image.shape[::-1]) - 1)
    bright = image[at[..., 1], at[..., 0]].astype(np.float64)
    even = np.add.outer(np.arange(bright.shape[0]), np.arange(bright.shape[1])) % 2 == 0
    return grid if bright[even].mean() < bright[~even].mean() else grid[::-1, ::-1]


def _near_line(uv: np.ndarray) -> np.ndarray:
    """Which pixels [n, 2] lie near the straight line u(v) through most of them."""
    half = len(uv) // 2
    if half == 0:
        return np.zeros(len(uv), bool)
    # Each pixel of the upper half with one of the lower: the median does not feel a few strays.
    change = uv[half : 2 * half] - uv[:half]
    rest = uv[:, 0] - np.median(change[:, 0] / change[:, 1]) * uv[:, 1]
    return np.abs(rest - np.median(rest)) < STRAY
