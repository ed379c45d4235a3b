"""Where a calibrated rig will see a board: its corners, and the stripe on it."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxscan.calibration.result import Calibration
from jaxscan.calibration.solve.problem import warp_height
from jaxscan.geometry import AbstractBoard, AbstractCamera, Array, LaserSheet, invert, transform


# Points along the stripe on a board; between them it is straight to far less than its noise.
_SAMPLES = 128
# A ray that comes back within this angle [rad] was projected, not folded over or from behind.
_SAME_RAY = 1e-3


class PredictedCorners(NamedTuple):
    """Corners of the board in one view, or (with a leading axis) in several."""

    q: np.ndarray
    """float64 [..., corners, 2]: (u, v) [px]."""
    edges: np.ndarray
    """float64 [..., corners, 2, 2]: unit vectors in the image along the board's x and y."""
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


def board_poses(calibration: Calibration, angle: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """T_cam_board at other angles of the table than that at which a board was seen.

    Args:
        calibration: With a scanner, and the views that it was made from.
        angle: Of the table [n], rad from home.
        seen: View of the same unmoved board [n], row of the observations.

    Returns:
        Poses [n, 4, 4].
    """
    fit, observations, scanner = calibration.fit, calibration.observations, calibration.scanner
    if fit is None or observations is None or scanner is None:
        raise ValueError("The calibration holds no views or no turntable.")
    with jax.enable_x64(True):
        from_angle = np.asarray(observations.corners.angle)[seen]
        table = jax.tree.map(jnp.asarray, scanner.turntable)
        turn = jax.vmap(lambda to, at, pose: invert(table.motion(to)) @ table.motion(at) @ pose)
        return np.asarray(turn(jnp.asarray(angle), jnp.asarray(from_angle), jnp.asarray(fit.pose[seen])))


def predict_corners(calibration: Calibration, poses: np.ndarray) -> PredictedCorners:
    """Where the corners of the board are seen.

    Args:
        calibration: With the views that it was made from.
        poses: T_cam_board [views, 4, 4].

    Returns:
        Corners of all views.
    """
    board, shape = _board(calibration)
    with jax.enable_x64(True):
        corners, frame = jnp.asarray(board.corners()), _frame(board)
        camera = jax.tree.map(jnp.asarray, calibration.camera)
        q, by_x, by_y, same = (np.asarray(part) for part in _corners(camera, jnp.asarray(poses), corners, frame, shape))
    length = np.stack([np.linalg.norm(by, axis=-1) for by in (by_x, by_y)], -1)
    edges = np.stack([by_x, by_y], -2) / np.maximum(length, 1e-12)[..., None]
    limit = np.array([calibration.camera.width, calibration.camera.height]) - 1.0
    visible = same & np.isfinite(q).all(-1) & ((q >= 0.0) & (q <= limit)).all(-1)
    return PredictedCorners(q, edges, length.min(-1) * board.square, visible)


def predict_stripe(
    calibration: Calibration, pose: np.ndarray, laser: int, lines: int, stripe_axis: str = "rows"
) -> PredictedStripe:
    """Where the stripe of a laser lies on a board, for every line of the image.

    Args:
        calibration: With a scanner, and the views that it was made from.
        pose: T_cam_board [4, 4].
        laser: Which of its sheets.
        lines: Rows of the image, or columns where `stripe_axis` is "columns".
        stripe_axis: "rows" where a line is an image row.

    Returns:
        The stripe; lines that it passes beside the printed area are not `on_board`.
    """
    board, shape = _board(calibration)
    if calibration.scanner is None:
        raise ValueError("A camera alone predicts no stripe.")
    outline = board.outline()
    with jax.enable_x64(True):
        camera = jax.tree.map(jnp.asarray, calibration.camera)
        sheet = jax.tree.map(jnp.asarray, calibration.scanner.laser(laser))
        middle, reach = jnp.asarray(outline.mean(0)), float(np.linalg.norm(np.ptp(outline, axis=0)) / 2)
        curve = _curve(camera, sheet, jnp.asarray(pose), middle, jnp.asarray(reach), _frame(board), shape)
        q, xy, same = (np.asarray(part) for part in curve)
    inside = same & np.isfinite(q).all(-1) & ((xy > outline.min(0)) & (xy < outline.max(0))).all(-1)
    if inside.sum() < 2:
        return PredictedStripe(np.zeros(lines), np.zeros(lines, bool))
    across, along = (q[inside, 0], q[inside, 1]) if stripe_axis == "rows" else (q[inside, 1], q[inside, 0])
    order = np.argsort(along)
    at = np.arange(lines, dtype=np.float64)
    on_board = (at >= along[order[0]]) & (at <= along[order[-1]])
    return PredictedStripe(np.where(on_board, np.interp(at, along[order], across[order]), 0.0), on_board)


def lift_to_board(calibration: Calibration, pose: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Board coordinates (x, y) [n, 2], m, of the points of the board that pixels `q` [n, 2] see."""
    board, shape = _board(calibration)
    with jax.enable_x64(True):
        camera = jax.tree.map(jnp.asarray, calibration.camera)
        return np.asarray(_lift(camera, jnp.asarray(pose), jnp.asarray(q), _frame(board), shape))


def _board(calibration: Calibration) -> tuple[AbstractBoard, np.ndarray]:
    if calibration.fit is None or calibration.observations is None:
        raise ValueError("The calibration holds no views.")
    return calibration.observations.board, np.array([*calibration.fit.warp, calibration.fit.pitch])


def _frame(board: AbstractBoard) -> np.ndarray:
    xy = board.corners()[:, :2]
    return np.concatenate([(xy.min(0) + xy.max(0)) / 2, np.maximum(np.ptp(xy, axis=0) / 2, 1e-12)])


def _bowed(xy: Float[Array, "2"], frame: Float[Array, "4"], shape: Float[Array, "3"]) -> Float[Array, "3"]:
    """The point of the board as it is at (x, y) of the board as it was drawn [m]."""
    return jnp.append(xy * (1.0 + shape[2]), warp_height(frame, shape, xy[0], xy[1]))


def _seen(camera: AbstractCamera, p: Float[Array, "3"]) -> tuple[Float[Array, "2"], Array]:
    """Pixel of a point, and whether that pixel looks at the point."""
    q = camera.project(p)
    return q, jnp.linalg.norm(camera.unproject(q) - p / jnp.linalg.norm(p)) < _SAME_RAY


@jax.jit
def _corners(
    camera: AbstractCamera,
    poses: Float[Array, "views 4 4"],
    corners: Float[Array, "corners 3"],
    frame: Float[Array, "4"],
    shape: Float[Array, "3"],
) -> tuple[Array, Array, Array, Array]:
    def one(pose, corner):
        see = lambda xy: camera.project(transform(pose, _bowed(xy, frame, shape)))
        slopes = jax.jacfwd(see)(corner[:2])
        q, same = _seen(camera, transform(pose, _bowed(corner[:2], frame, shape)))
        return q, slopes[:, 0], slopes[:, 1], same

    return jax.vmap(lambda pose: jax.vmap(lambda corner: one(pose, corner))(corners))(poses)


@jax.jit
def _curve(
    camera: AbstractCamera,
    sheet: LaserSheet,
    pose: Float[Array, "4 4"],
    middle: Float[Array, "2"],
    reach: Float[Array, ""],
    frame: Float[Array, "4"],
    shape: Float[Array, "3"],
) -> tuple[Array, Array, Array]:
    """Points of the sheet on the board: pixels, board coordinates, and whether they are seen."""
    # On the flat board the sheet is the straight line across . xy = level.
    offset = lambda xy: sheet.offset(transform(pose, _bowed(xy, frame, shape)))
    across = (pose[:3, :2].T @ sheet.normal) * (1.0 + shape[2])
    length = jnp.maximum(jnp.linalg.norm(across), 1e-9)
    across = across / length
    along = jnp.stack([-across[1], across[0]])

    def point(s):
        xy = middle + s * reach * along
        # Bows of sheet and board change the slope by less than a hundredth, so each round gains two digits.
        for _ in range(4):
            xy = xy - across * offset(xy) / length
        q, same = _seen(camera, transform(pose, _bowed(xy, frame, shape)))
        return q, xy, same

    return jax.vmap(point)(jnp.linspace(-1.0, 1.0, _SAMPLES))


@jax.jit
def _lift(
    camera: AbstractCamera,
    pose: Float[Array, "4 4"],
    q: Float[Array, "n 2"],
    frame: Float[Array, "4"],
    shape: Float[Array, "3"],
) -> Array:
    board_from_camera = invert(pose)

    def one(pixel):
        direction = board_from_camera[:3, :3] @ camera.unproject(pixel)
        origin = board_from_camera[:3, 3]
        along_z = jnp.where(direction[2] == 0, 1.0, direction[2]).astype(direction.dtype)
        range_m = -origin[2] / along_z
        for _ in range(3):
            xy = (origin + range_m * direction)[:2] / (1.0 + shape[2])
            range_m = (warp_height(frame, shape, xy[0], xy[1]) - origin[2]) / along_z
        return (origin + range_m * direction)[:2] / (1.0 + shape[2])

    return jax.vmap(one)(q)
