"""Predicted pixels of the corners of a board and of the stripe on it, from a first solve."""

from typing import NamedTuple

import jax
import numpy as np

from jaxscan.geometry import (
    AbstractBoard,
    AbstractCamera,
    AbstractMotion,
    BoardPicture,
    BowedBoard,
    LaserSheet,
    Scanner,
    StripeAxis,
    across_and_along,
    compose,
    corner_frame,
    invert,
    transform,
    turn,
)


# Points along the stripe on a board; between them it is straight to much less than its noise.
_SAMPLES = 128
# Step of the differences that show how the lens bends an edge, in squares.
_BEND_SHARE = 0.1
# Largest angle [rad] between a point and the ray of its pixel; beyond it the lens folds or the point is behind.
_SAME_RAY = 1e-3


class SolvedRig(NamedTuple):
    """Result of a first solve: the rig and the poses of the board."""

    camera: AbstractCamera
    scanner: Scanner | None
    """None where the camera alone was solved."""
    board: AbstractBoard
    shape: np.ndarray
    """Bow kx, ky [m] and relative error of the pitch [1]; see `BowedBoard`."""
    poses: np.ndarray
    """T_cam_board of every view in the observations [views, 4, 4]."""
    used: np.ndarray
    """bool [views]: the solve used corners of that view."""
    corner_rms_px: float
    """Root mean square residual of the corners."""
    believed: tuple[str, ...] = ()
    """The lasers with whose sheet most boards agree: their stripes are looked for near it only."""
    bend: np.ndarray = np.zeros(0)
    """Coefficients of the board's `bend_functions` [m]; empty for a parabola."""
    offset: np.ndarray = np.zeros((0, 3))
    """Where every corner stands beside the surface [corners, 3], m; empty for a parabola."""
    picture: BoardPicture | None = None
    """The print of the board; None where it is not known."""

    @property
    def laser_names(self) -> tuple[str, ...]:
        """The lasers whose sheets were solved."""
        return () if self.scanner is None else self.scanner.laser_names

    def surface(self) -> BowedBoard:
        """The bowed board."""
        frame = corner_frame(self.board.corners())
        return BowedBoard(*(np.asarray(part, np.float64) for part in (frame, self.shape, self.bend)))


class PredictedCorners(NamedTuple):
    """Corners of the board in one view, or (with a leading axis) in several."""

    q: np.ndarray
    """float64 [..., corners, 2]: (u, v) [px]."""
    edges: np.ndarray
    """float64 [..., corners, 2, 2]: unit vectors in the image along the board's x and y."""
    bend: np.ndarray
    """float64 [..., corners, 2]: curvature of these edges by the lens, positive where one along u bends
    towards v [1 / px]."""
    size: np.ndarray
    """float64 [..., corners]: shorter side of a square [px]."""
    visible: np.ndarray
    """bool [..., corners]: in front of the lens and inside the image."""


class PredictedStripe(NamedTuple):
    """The stripe on the board, per line of the image."""

    u: np.ndarray
    """float64 [lines]: across the line [px]; 0 where not `on_board`."""
    on_board: np.ndarray
    """bool [lines]: the sheet meets the printed area there."""


def turn_boards(motion: AbstractMotion, poses: np.ndarray, at: np.ndarray, to: np.ndarray) -> np.ndarray:
    """T_cam_board of unmoved boards at other positions of the scanner.

    Args:
        motion: Of the scanner.
        poses: T_cam_board [n, 4, 4].
        at: Angles of the table, or positions of the stage, of these poses [n], rad or m.
        to: Those of the new poses [n].
    """
    motion = jax.tree.map(np.asarray, motion)
    return np.asarray(compose(compose(invert(motion.motion(to)), motion.motion(at)), poses))


def predict_corners(rig: SolvedRig, poses: np.ndarray) -> PredictedCorners:
    """Predict the corners of the board.

    Args:
        poses: T_cam_board [views, 4, 4].
    """
    surface, camera, flat = rig.surface(), jax.tree.map(np.asarray, rig.camera), rig.board.corners()[:, :2]
    poses = np.asarray(poses, np.float64)[:, None]
    p = np.asarray(transform(poses, surface.point(flat) + (rig.offset if len(rig.offset) else 0.0)))
    by_point, slope = np.asarray(camera.slopes(p)), surface.slope(flat)
    tangent = np.zeros((2, len(flat), 3))
    tangent[[0, 1], :, [0, 1]], tangent[..., 2] = 1.0 + surface.shape[2], slope.T
    by = np.stack([np.einsum("vcij,vcj->vci", by_point, turn(poses[..., :3, :3], along)) for along in tangent], -2)
    (q, same), length = _seen(camera, p), np.linalg.norm(by, axis=-1)
    edges = by / np.maximum(length, 1e-12)[..., None]
    # Bends are second differences, over a small part of a square to either side.
    step = _BEND_SHARE * rig.board.square
    sides = [
        [camera.project(p + sign * step * turn(poses[..., :3, :3], along)) for sign in (1, -1)] for along in tangent
    ]
    second = np.stack([np.asarray(ahead + back - 2.0 * q) for ahead, back in sides], -2) / step**2
    aside = edges[..., 0] * second[..., 1] - edges[..., 1] * second[..., 0]
    bend = aside / np.maximum(length, 1e-12) ** 2
    limit = np.array([rig.camera.width, rig.camera.height]) - 1.0
    visible = same & np.isfinite(q).all(-1) & ((q >= 0.0) & (q <= limit)).all(-1)
    return PredictedCorners(
        q, edges, np.where(visible[..., None], bend, 0.0), length.min(-1) * rig.board.square, visible
    )


def predict_stripe(rig: SolvedRig, pose: np.ndarray, laser: int, stripe_axis: StripeAxis = "rows") -> PredictedStripe:
    """Predict the stripe of a laser on a board, for every line of the image.

    Args:
        rig: The rig, with a scanner, and its board.

    Returns:
        The stripe; lines where it misses the printed area are not `on_board`.
    """
    if rig.scanner is None:
        raise ValueError("A camera alone predicts no stripe.")
    outline = rig.board.outline()
    q, xy, same = _curve(rig, rig.scanner.laser(laser), np.asarray(pose), outline)
    lines = across_and_along(rig.camera.width, rig.camera.height, stripe_axis)[1]
    inside = same & np.isfinite(q).all(-1) & ((xy > outline.min(0)) & (xy < outline.max(0))).all(-1)
    if inside.sum() < 2:
        return PredictedStripe(np.zeros(lines), np.zeros(lines, bool))
    across, along = q[inside].T if stripe_axis == "rows" else q[inside, ::-1].T
    order = np.argsort(along)
    at = np.arange(lines, dtype=np.float64)
    on_board = (at >= along[order[0]]) & (at <= along[order[-1]])
    return PredictedStripe(np.where(on_board, np.interp(at, along[order], across[order]), 0.0), on_board)


def lift_to_board(rig: SolvedRig, pose: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Board coordinates (x, y) [n, 2], m, on the board as drawn, of the points seen at pixels `q` [n, 2]."""
    surface, camera = rig.surface(), jax.tree.map(np.asarray, rig.camera)
    _, p = surface.meet(np.asarray(pose), camera.unproject(np.asarray(q, np.float64)))
    return np.asarray(p[:, :2] / (1.0 + surface.shape[2]))


def _seen(camera: AbstractCamera, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of points, and whether the ray of that pixel leads to the point; none leads to the camera's own centre."""
    q = np.asarray(camera.project(p))
    ray = p / np.maximum(np.linalg.norm(p, axis=-1, keepdims=True), 1e-12)
    return q, np.linalg.norm(np.asarray(camera.unproject(q)) - ray, axis=-1) < _SAME_RAY


def _curve(
    rig: SolvedRig, sheet: LaserSheet, pose: np.ndarray, outline: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of the sheet on the board: pixels, board coordinates, and whether they are seen."""
    surface, middle, reach = rig.surface(), outline.mean(0), np.linalg.norm(np.ptp(outline, axis=0)) / 2
    place = lambda xy: transform(pose, surface.point(xy))
    # On the flat board the sheet is the straight line across . xy = level.
    across = (pose[:3, :2].T @ sheet.normal) * (1.0 + surface.shape[2])
    length = max(float(np.linalg.norm(across)), 1e-9)
    across = across / length
    xy = middle + np.outer(np.linspace(-reach, reach, _SAMPLES), [-across[1], across[0]])
    # Bows of sheet and board change the slope by less than a hundredth, so each round gains two digits.
    for _ in range(4):
        xy = xy - np.outer(np.asarray(sheet.offset(place(xy))) / length, across)
    q, same = _seen(jax.tree.map(np.asarray, rig.camera), np.asarray(place(xy)))
    return q, xy, same
