"""The paper's own method: one step after the other, each taking the result of the one before as exact.

OpenCV's board finder and Zhang's calibration; the rest is the paper's equations as they stand. Nothing of `jaxscan`
takes part.
"""

from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np

from experiments.paper.methods.equations import (
    linear_plane,
    pair_motion,
    points_on_board,
    power,
    rays,
    rigid,
    total_plane,
)
from jaxscan.files import Capture


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

    Args:
        capture: Boards, plain chessboards; records without a laser-on image are views for the camera alone.
        extract: How the stripe is found.

    Returns:
        The calibration.

    Raises:
        ValueError: If fewer than three boards are found, the last two are not, or no stripe is on any board.
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
        grid: Columns and rows of inner corners.
        square: Side of a square [m].

    Returns:
        None if it is not found.
    """
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    found, corners = cv2.findChessboardCorners(image, grid, flags=flags)
    if not found:
        # Small squares are found in an image that is enlarged.
        found, corners = cv2.findChessboardCorners(cv2.resize(image, None, fx=2, fy=2), grid, flags=flags)
        if not found:
            return None
        corners = (corners - 0.5) / 2
    pixels = corners.reshape(grid[1], grid[0], 2)
    smallest = min(np.linalg.norm(np.diff(pixels, axis=axis), axis=-1).min() for axis in (0, 1))
    half = int(np.clip(smallest // 3, 2, 11))
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-3)
    pixels = cv2.cornerSubPix(image, pixels.reshape(-1, 1, 2).astype(np.float32), (half, half), (-1, -1), stop)
    pixels = _from_black(image, pixels.reshape(grid[1], grid[0], 2)).reshape(-1, 2)
    x, y = np.meshgrid(np.arange(grid[0]), np.arange(grid[1]))
    places = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]) * square
    return BoardCorners(pixels, places.astype(np.float32))


def calibrate_camera(found: list[BoardCorners | None], size: tuple[int, int]) -> tuple[np.ndarray, float, np.ndarray]:
    """Zhang's calibration with one radial coefficient, equations (1) to (3), without skew.

    Args:
        found: Corners of each view.
        size: Width and height of the images [px].

    Returns:
        matrix: A [3, 3].
        k: The radial coefficient.
        pose: T_cam_board of each view [views, 4, 4]; NaN where there is no board.

    Raises:
        ValueError: If there are fewer than three boards.
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
        k: The radial coefficient.
        found: Its corners.
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
        matrix: A.
        k: The radial coefficient.
        pose: T_cam_board [4, 4].
        outline: Corners of the printed area in the board's frame [4, 2], m.
        found: The stripe in the whole frame, of `Extract`.
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
        way: The calibration.
        uv: Pixels [..., 2].
        plane: a, b, c; without it those of the linear fit.

    Returns:
        [..., 3], camera frame [m]; NaN where a ray does not meet the sheet in front of the camera.
    """
    a, b, c = way.linear if plane is None else plane
    along = rays(way.matrix, way.k, np.asarray(uv, np.float64))
    share = a * along[..., 0] + b * along[..., 1] + 1
    depth = c / np.where(share * c > 0, share, np.nan)
    return along * depth[..., None]


def cloud(way: PaperWay, u: np.ndarray, valid: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Points of a sweep, equations (4), (11) and (12).

    Args:
        way: The calibration.
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
