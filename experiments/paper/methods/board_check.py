"""Points of a stripe by the pose of the board that it lies on, against the same points by camera and sheet."""

import cv2
import jax
import numpy as np

import jaxscan
from experiments.paper.methods.paper_way import (
    Extract,
    PaperWay,
    board_pose,
    find_board,
    points_on_board,
    points_on_sheet,
    stripe_on_board,
)
from jaxscan.observation import Observations


Differences = list[np.ndarray]
"""Of each board [points, 3]: by sheet minus by board, camera frame [m]."""


def paper_own(way: PaperWay) -> Differences:
    """On the boards that the sheet was fitted to, with the poses of the calibration."""
    pairs = zip(way.pose, way.stripe, strict=True)
    return [points_on_sheet(way, uv) - points_on_board(way.matrix, way.k, pose, uv) for pose, uv in pairs if len(uv)]


def paper_held_out(way: PaperWay, capture: jaxscan.Capture, extract: Extract) -> Differences:
    """On boards that took no part in the calibration."""
    board, out = capture.board, []
    for index in range(len(capture.records)):
        on, off = capture.frames(index)
        found = find_board(off, board.grid(), board.square)
        if found is None:
            continue
        pose = board_pose(way.matrix, way.k, found)
        uv = stripe_on_board(way.matrix, way.k, pose, board.outline(), extract(on, off))
        out.append(points_on_sheet(way, uv) - points_on_board(way.matrix, way.k, pose, uv))
    return out


def ours(scanner: jaxscan.Scanner, warp: tuple[float, float], observations: Observations) -> Differences:
    """Of our stripes; poses are found from corners alone, so that the sheet has no say in them.

    Args:
        scanner: The calibration.
        warp: Heights of the board's bow [m], as the calibration found them.
        observations: Corners and stripes.
    """
    out = []
    corners, stripes = observations.corners, observations.stripes
    shape = _Bow(observations.board.corners(), warp)
    for index, view in enumerate(np.asarray(stripes.view)):
        seen = np.asarray(corners.valid[view])
        pose = _pose(shape.corners()[seen], _rays(scanner, np.asarray(corners.q[view])[seen]))
        rays = _rays(scanner, np.asarray(stripes.q[index])[np.asarray(stripes.valid[index])])
        out.append(_on_sheet(scanner, rays) - shape.meet(pose, rays))
    return out


class _Bow:
    """A board with a parabolic bow: kx (1 - x'^2) + ky (1 - y'^2), x' and y' = +-1 at the outer corners."""

    def __init__(self, flat: np.ndarray, warp: tuple[float, float]) -> None:
        low, high = flat[:, :2].min(0), flat[:, :2].max(0)
        self.flat, self.warp, self.middle, self.half = flat, np.array(warp), (low + high) / 2, (high - low) / 2

    def height(self, xy: np.ndarray) -> np.ndarray:
        return (1 - ((xy - self.middle) / self.half) ** 2) @ self.warp

    def corners(self) -> np.ndarray:
        return np.column_stack([self.flat[:, :2], self.height(self.flat[:, :2])])

    def meet(self, pose: np.ndarray, rays: np.ndarray) -> np.ndarray:
        """Where rays [n, 3] meet the board, camera frame."""
        origin, along = -pose[:3, :3].T @ pose[:3, 3], rays @ pose[:3, :3]
        distance = -origin[2] / along[:, 2]
        for _ in range(5):
            distance = (self.height(origin[:2] + distance[:, None] * along[:, :2]) - origin[2]) / along[:, 2]
        return distance[:, None] * rays


def _pose(places: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """T_cam_board [4, 4] of corners [n, 3] that are seen along rays [n, 3]."""
    seen = rays[:, :2] / rays[:, 2:]
    _, turn, shift = cv2.solvePnP(places, seen, np.eye(3), None, flags=cv2.SOLVEPNP_ITERATIVE)
    # The bow makes the corners no plane: from the first pose to the best one.
    turn, shift = cv2.solvePnPRefineLM(places, seen, np.eye(3), None, turn, shift)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(turn)[0], shift[:, 0]
    return pose


def _rays(scanner: jaxscan.Scanner, q: np.ndarray) -> np.ndarray:
    with jax.enable_x64(True):
        return np.asarray(jax.vmap(scanner.as_dtype(np.float64).camera.unproject)(q))


def _on_sheet(scanner: jaxscan.Scanner, rays: np.ndarray) -> np.ndarray:
    with jax.enable_x64(True):
        distance, _ = jax.vmap(scanner.as_dtype(np.float64).laser(0).intersect)(rays)
    return np.asarray(distance)[:, None] * rays
