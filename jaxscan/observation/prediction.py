"""Predicted pixels of the corners of a board and of the stripe on it, from a first solve."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxscan.compiling import compile_quickly, compile_sooner
from jaxscan.geometry import (
    AbstractBoard,
    AbstractCamera,
    AbstractMotion,
    Array,
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
)


# Points along the stripe on a board; between them it is straight to much less than its noise.
_SAMPLES = 128
# Pixels that are lifted to a board at a time, and views whose corners are predicted at a time.
_LIFTED = 4096
_VIEWS = 32
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
        """The bowed board; call in 64 bit."""
        frame = corner_frame(self.board.corners())
        return BowedBoard(*(jnp.asarray(part) for part in (frame, self.shape, self.bend)))


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


def turn_boards(motion: AbstractMotion, poses: np.ndarray, at: np.ndarray, to: np.ndarray) -> np.ndarray:
    """T_cam_board of unmoved boards at other positions of the scanner.

    Args:
        motion: Of the scanner.
        poses: T_cam_board [n, 4, 4].
        at: Angles of the table, or positions of the stage, of these poses [n], rad or m.
        to: Those of the new poses [n].

    Returns:
        Poses [n, 4, 4].
    """
    motion = jax.tree.map(np.asarray, motion)
    return np.asarray(compose(compose(invert(motion.motion(to)), motion.motion(at)), poses))


def predict_corners(rig: SolvedRig, poses: np.ndarray) -> PredictedCorners:
    """Predict the corners of the board.

    Args:
        rig: The rig and its board.
        poses: T_cam_board [views, 4, 4].

    Returns:
        Corners of all views.
    """
    with jax.enable_x64(True):
        corners = rig.board.corners()[:, :2]
        offset = rig.offset if len(rig.offset) else np.zeros((len(corners), 3))
        camera, corners, offset = jax.tree.map(jnp.asarray, (rig.camera, corners, offset))
        surface, parts = rig.surface(), max(-(-len(poses) // _VIEWS), 1)
        # Always as many at a time, so that all captures share one compilation.
        padded = np.resize(np.asarray(poses, np.float64), (parts, _VIEWS, 4, 4))
        found = [_corners(camera, jnp.asarray(some), (corners, offset), surface) for some in padded]
        q, by_x, by_y, same = (np.concatenate(part)[: len(poses)] for part in zip(*found, strict=True))
    length = np.stack([np.linalg.norm(by, axis=-1) for by in (by_x, by_y)], -1)
    edges = np.stack([by_x, by_y], -2) / np.maximum(length, 1e-12)[..., None]
    limit = np.array([rig.camera.width, rig.camera.height]) - 1.0
    visible = same & np.isfinite(q).all(-1) & ((q >= 0.0) & (q <= limit)).all(-1)
    return PredictedCorners(q, edges, length.min(-1) * rig.board.square, visible)


def predict_stripe(rig: SolvedRig, pose: np.ndarray, laser: int, stripe_axis: StripeAxis = "rows") -> PredictedStripe:
    """Predict the stripe of a laser on a board, for every line of the image.

    Args:
        rig: The rig, with a scanner, and its board.
        pose: T_cam_board [4, 4].
        laser: Index of the sheet.
        stripe_axis: Whether a line is an image row or an image column.

    Returns:
        The stripe; lines where it misses the printed area are not `on_board`.
    """
    if rig.scanner is None:
        raise ValueError("A camera alone predicts no stripe.")
    outline = rig.board.outline()
    with jax.enable_x64(True):
        camera, sheet = jax.tree.map(jnp.asarray, (rig.camera, rig.scanner.laser(laser)))
        middle, reach = jnp.asarray(outline.mean(0)), float(np.linalg.norm(np.ptp(outline, axis=0)) / 2)
        curve = _curve(camera, sheet, rig.surface(), jnp.asarray(pose), middle, jnp.asarray(reach))
        q, xy, same = (np.asarray(part) for part in curve)
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
    # Always as many at a time, so that all captures share one compilation.
    parts = -(-len(q) // _LIFTED)
    padded = np.resize(np.asarray(q, np.float64), (parts, _LIFTED, 2)) if len(q) else np.zeros((0, _LIFTED, 2))
    with jax.enable_x64(True):
        camera, surface = jax.tree.map(jnp.asarray, rig.camera), rig.surface()
        lifted = [_lift(camera, surface, jnp.asarray(pose), jnp.asarray(part)) for part in padded]
        return np.concatenate([np.zeros((0, 2)), *(np.asarray(part) for part in lifted)])[: len(q)]


def _seen(camera: AbstractCamera, p: Float[Array, "3"]) -> tuple[Float[Array, "2"], Array]:
    """Pixel of a point, and whether the ray of that pixel leads to the point."""
    q = camera.project(p)
    return q, jnp.linalg.norm(camera.unproject(q) - p / jnp.linalg.norm(p)) < _SAME_RAY


@compile_quickly
def _corners(
    camera: AbstractCamera,
    poses: Float[Array, "views 4 4"],
    corners: tuple[Float[Array, "corners 2"], Float[Array, "corners 3"]],
    surface: BowedBoard,
) -> tuple[Array, Array, Array, Array]:
    """Of corners, and their places beside the surface: pixels, slopes, and whether they are seen."""

    def one(pose, corner, offset):
        place = lambda xy: transform(pose, surface.point(xy) + offset)
        slopes = jax.jacfwd(lambda xy: camera.project(place(xy)))(corner)
        q, same = _seen(camera, place(corner))
        return q, slopes[:, 0], slopes[:, 1], same

    return jax.vmap(lambda pose: jax.vmap(lambda *corner: one(pose, *corner))(*corners))(poses)


@compile_quickly
def _curve(
    camera: AbstractCamera,
    sheet: LaserSheet,
    surface: BowedBoard,
    pose: Float[Array, "4 4"],
    middle: Float[Array, "2"],
    reach: Float[Array, ""],
) -> tuple[Array, Array, Array]:
    """Points of the sheet on the board: pixels, board coordinates, and whether they are seen."""
    place = lambda xy: transform(pose, surface.point(xy))
    # On the flat board the sheet is the straight line across . xy = level.
    across = (pose[:3, :2].T @ sheet.normal) * (1.0 + surface.shape[2])
    length = jnp.maximum(jnp.linalg.norm(across), 1e-9)
    across = across / length
    along = jnp.stack([-across[1], across[0]])

    def point(s):
        xy = middle + s * reach * along
        # Bows of sheet and board change the slope by less than a hundredth, so each round gains two digits.
        for _ in range(4):
            xy = xy - across * sheet.offset(place(xy)) / length
        q, same = _seen(camera, place(xy))
        return q, xy, same

    return jax.vmap(point)(jnp.linspace(-1.0, 1.0, _SAMPLES))


@compile_sooner
def _lift(camera: AbstractCamera, surface: BowedBoard, pose: Float[Array, "4 4"], q: Float[Array, "n 2"]) -> Array:
    points = jax.vmap(lambda pixel: surface.meet(pose, camera.unproject(pixel))[1])(q)
    return points[:, :2] / (1.0 + surface.shape[2])
