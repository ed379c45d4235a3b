"""Stripe points by the pose of their board against the same points by camera and sheet, as in Fig. 6."""

from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

import jaxscan
from experiments.paper.methods.equations import points_on_board, rigid
from experiments.paper.methods.paper_way import (
    Extract,
    PaperWay,
    board_pose,
    find_board,
    points_on_sheet,
    stripe_on_board,
)
from jaxscan.calibration import Quality
from jaxscan.geometry import lit_points
from jaxscan.observation import Observations, StripeViews
from jaxscan.stripes import smooth_profiles


_POINTS = 512
"""Most points of a stripe on a board, and most corners."""
_STEP_PX = 0.01
_FITTED = ("even print", "weak edge", "strong edge")
_CONTRASTS = (*_FITTED, *(f"{name}, not through the print" for name in _FITTED))
"""Names of the contrast classes of `StripeViews` in `Quality.stripe_noise_by_contrast`."""


class Check(NamedTuple):
    """The stripe of one board."""

    record: int
    row: np.ndarray
    """Image rows [points]."""
    difference: np.ndarray
    """By sheet minus by board, camera frame [points, 3], m."""
    predicted: np.ndarray
    """Standard deviation of the difference's Z by the stripe's noise alone [points], m; NaN where not known."""

    def at_rows_of(self, others: list["Check"]) -> "Check":
        """The points of rows at which another method has one too.

        Args:
            others: Of that method; those of other records are ignored.
        """
        rows = [other.row for other in others if other.record == self.record]
        kept = np.isin(self.row, np.concatenate(rows)) if rows else np.zeros(len(self.row), bool)
        return Check(self.record, self.row[kept], self.difference[kept], self.predicted[kept])


def paper_own(way: PaperWay) -> list[Check]:
    """By the paper's method, on the boards to which its plane was fitted, with the poses of its calibration."""
    pairs = enumerate(zip(way.pose, way.stripe, strict=True))
    return [_paper_check(way, record, pose, uv) for record, (pose, uv) in pairs if len(uv)]


def paper_held_out(way: PaperWay, capture: jaxscan.Capture, extract: Extract) -> list[Check]:
    """By the paper's method, on boards that no calibration has seen.

    Args:
        way: The calibration.
        capture: Of the boards, each with its stripe.
        extract: The stripe finder.
    """
    board, out = capture.board, []
    for index in range(len(capture.records)):
        on, off = capture.frames(index)
        found = find_board(off, board.grid(), board.square)
        if found is not None:
            pose = board_pose(way.matrix, way.k, found)
            uv = stripe_on_board(way.matrix, way.k, pose, board.outline(), extract(on, off))
            out.append(_paper_check(way, index, pose, uv))
    return out


def ours(calibration: jaxscan.Calibration, observations: Observations) -> list[Check]:
    """By our method. The poses are found from corners alone: the sheet does not influence them.

    Args:
        calibration: The rig, the board's bow, and the noise of stripes that the calibration estimated.
        observations: Corners and stripes.

    Raises:
        ValueError: If the calibration has no scanner.
    """
    scanner, quality = calibration.scanner, calibration.quality
    if scanner is None:
        raise ValueError("The calibration has no scanner.")
    out = []
    corners, stripes = observations.corners, observations.stripes
    shape = _Bow(observations.board.corners(), quality.board_warp_m or (0.0, 0.0))
    for index, view in enumerate(np.asarray(stripes.view)):
        seen = np.asarray(corners.valid[view])
        pose = _pose(shape.corners()[seen], _rays(scanner, np.asarray(corners.q[view])[seen])[0])
        kept = np.asarray(stripes.valid[index])
        uv = np.asarray(stripes.q[index])[kept]

        def by_both(uv: np.ndarray, pose: np.ndarray = pose) -> np.ndarray:
            rays, on_sheet = _rays(scanner, uv)
            return on_sheet - shape.meet(pose, rays)

        difference = by_both(uv)
        slope = (by_both(uv + [_STEP_PX, 0.0]) - difference)[:, 2] / _STEP_PX
        predicted = np.abs(slope) * _stripe_noise(quality, stripes, index)[kept]
        out.append(Check(int(corners.record[view]), np.rint(uv[:, 1]).astype(int), difference, predicted))
    return out


def along_the_stripe(observations: Observations) -> Observations:
    """The same with stripes smoothed over neighbouring rows, as `jaxscan.reconstruct` does before it makes points."""
    stripes = observations.stripes
    q, sigma, valid = (np.array(part) for part in (stripes.q, stripes.sigma, stripes.valid))
    for index in range(len(q)):
        rows = np.rint(q[index, valid[index], 1]).astype(int)
        u, deviation, there = np.zeros((3, 1, observations.height))
        u[0, rows], deviation[0, rows], there[0, rows] = q[index, valid[index], 0], sigma[index, valid[index]], 1
        found = smooth_profiles(u.astype(np.float32), deviation.astype(np.float32), there.astype(bool))
        q[index, valid[index], 0], sigma[index, valid[index]] = found.u[0, rows], found.sigma[0, rows]
    return replace(observations, stripes=replace(stripes, q=q, sigma=sigma))


def _stripe_noise(quality: Quality, stripes: StripeViews, index: int) -> np.ndarray:
    """Standard deviation of a stripe's centres [points], px: the extractor's times the calibration's factor."""
    promised = np.asarray(stripes.sigma[index])
    rest = quality.stripe_noise_over_sigma or 1.0
    factors = np.array([(quality.stripe_noise_by_contrast or {}).get(name, rest) for name in _CONTRASTS])
    return promised * (rest if stripes.contrast is None else factors[np.asarray(stripes.contrast[index])])


def _paper_check(way: PaperWay, record: int, pose: np.ndarray, uv: np.ndarray) -> Check:
    difference = points_on_sheet(way, uv) - points_on_board(way.matrix, way.k, pose, uv)
    return Check(record, uv[:, 1].astype(int), difference, np.full(len(uv), np.nan))


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
    # The corners of a bowed board are not in a plane: the first pose is refined.
    turn, shift = cv2.solvePnPRefineLM(places, seen, np.eye(3), None, turn, shift)
    return rigid(turn, shift)


def _rays(scanner: jaxscan.Scanner, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit rays [n, 3] of pixels [n, 2], and where they meet the sheet [n, 3], camera frame."""
    return np.asarray(jaxscan.rays(scanner.rig, q)), np.asarray(lit_points(scanner.rig, q, 0)[0])
