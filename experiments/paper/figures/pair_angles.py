"""How well the paper's Tr serves a room, by the angle between the two views that it is made from."""

from typing import NamedTuple

import cv2
import numpy as np

from experiments.paper.figures.room_clouds import Size, box_of, paper_points, size_of
from experiments.paper.methods.paper_way import BoardCorners, PaperWay, find_board, pair_motion
from experiments.paper.products.draws import Draw
from experiments.paper.products.room import PlainStripes
from experiments.paper.rendering.boards import PAIR_DEG, BoardPlan, expect_each
from experiments.paper.stage import Stage
from jaxscan.simulation import Motion, Placement, SimulationConfig, make_rig, rodrigues, take_frame
from jaxscan.simulation.rays import project


ANGLES_DEG = (PAIR_DEG, 4.0, 8.0, 12.0, 16.0, 20.0, 24.0, 30.0)
QUICK_DEG = (PAIR_DEG, 16.0)
DRAWS, QUICK_DRAWS = 12, 1
WORKING_M = 1.3
"""Depth of the board where the turn allows it: the paper's working distance."""
_STREAM = 91
_TILT = rodrigues(np.array([np.cos(0.7), np.sin(0.7), 0.0]), np.deg2rad(30.0))
_MARGIN = 0.01
"""Of the image's size, between the board and the image's edge."""


class PairAngle(NamedTuple):
    """Results of pairs of one angle."""

    angle_deg: float
    depth_m: float
    """Of the board from the camera, midway between both views."""
    sizes: list[Size]
    """Of each draw of noise."""

    def rms(self, truth: Size) -> np.ndarray:
        """Root mean square error of width and length [2], mm; of the draws in which walls were found."""
        errors = np.array([size.errors(truth) for size in self.sizes]).reshape(-1, 2)
        return np.sqrt(np.nanmean(errors**2, axis=0)) if np.isfinite(errors).any() else np.full(2, np.inf)


def pair_angles(stage: Stage, known: list[Draw], plain: PlainStripes, angles: np.ndarray) -> list[PairAngle]:
    """The room by the paper's way, with Tr from pairs of larger turns; all else as it was in its draws.

    Args:
        stage: The world.
        known: Calibrations by the paper's way, of which Tr is replaced.
        plain: Stripes of the room.
        angles: Of the table, of each record [rad].
    """
    out = []
    for number, degrees in enumerate(QUICK_DEG if stage.quick else ANGLES_DEG):
        placement, depth = place_pair(stage.config, np.deg2rad(degrees))
        records = list(expect_each(stage, BoardPlan([placement], [False, False])))
        sizes = []
        for draw in range(QUICK_DRAWS if stage.quick else DRAWS):
            random = stage.generator(_STREAM, number, draw)
            views = [_corners(stage.config, record.off, random) for record in records]
            if all(view is not None for view in views):
                way = with_pair(known[draw % len(known)].paper, views, np.deg2rad(degrees))
                sizes.append(size_of(box_of(paper_points(way, plain, angles))))
        out.append(PairAngle(degrees, depth, sizes))
    return out


def with_pair(way: PaperWay, views: list[BoardCorners | None], angle: float) -> PaperWay:
    """The same calibration with Tr from two other views, equation (10); `angle` between them [rad]."""
    lens = np.array([way.k, 0, 0, 0, 0])
    poses = []
    for view in views:
        assert view is not None
        _, turn, shift = cv2.solvePnP(view.places, view.pixels, way.matrix, lens)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(turn)[0], shift[:, 0]
        poses.append(pose)
    return way._replace(tr=pair_motion(*poses), pair_angle=angle)


def place_pair(config: SimulationConfig, angle: float) -> tuple[Placement, float]:
    """A board before the camera, seen from half the angle on either side, as near to the working distance as it fits.

    Returns:
        The placement, and the board's depth midway [m].
    """
    rig = make_rig(config)
    outline = config.boards.board().outline()
    middle = np.append(outline.mean(0), 0.0)
    edge = np.column_stack([outline, np.zeros(len(outline))])
    size = np.array([config.camera.width, config.camera.height])
    angles = (-angle / 2, angle / 2)
    for depth in np.arange(WORKING_M, 2.8, 0.05):
        pose = rig.pose(0.0) @ Motion(_TILT, np.array([0.0, 0.0, depth]) - _TILT @ middle)
        seen = np.concatenate([(rig.pose(phi).inverse() @ pose).apply(edge) for phi in angles])
        pixels = np.stack(project(config.camera, seen), -1)
        if np.all((pixels > _MARGIN * size) & (pixels < (1 - _MARGIN) * size)):
            return Placement(pose, angles, 0), float(depth)
    raise ValueError(f"No board fits into the image over a turn of {np.rad2deg(angle):.1f} degrees.")


def smallest_angle(pairs: list[PairAngle], rms: np.ndarray, wanted: float) -> float:
    """The angle at which the rms error falls to a value, between those that were tried; infinite if it never does.

    Args:
        pairs: In the order of their angles.
        rms: Of each [mm].
        wanted: The value [mm].
    """
    good = np.flatnonzero(rms <= wanted)
    if len(good) == 0:
        return np.inf
    at, angle = good[0], [pair.angle_deg for pair in pairs]
    if at == 0:
        return angle[0]
    share = np.log(rms[at - 1] / wanted) / np.log(rms[at - 1] / rms[at])
    return float(angle[at - 1] * (angle[at] / angle[at - 1]) ** share)


def _corners(config: SimulationConfig, light: np.ndarray, random: np.random.Generator) -> BoardCorners | None:
    """The board in one exposure without laser."""
    flicker = max(0.0, 1 + config.light.flicker * random.standard_normal())
    board = config.boards.board()
    return find_board(take_frame(light * np.float32(flicker), config, random), board.grid(), board.square)
