"""Errors of a room by the paper's method against the turn between the two views of its Tr."""

from typing import NamedTuple

import numpy as np

from experiments.paper.figures.room_clouds import Size, box_of, paper_points, size_of
from experiments.paper.methods.equations import pair_motion
from experiments.paper.methods.paper_way import BoardCorners, PaperWay, board_pose, find_board
from experiments.paper.products.draws import Draw
from experiments.paper.products.held_out import WORKING_M
from experiments.paper.products.room import PlainStripes
from experiments.paper.rendering.boards import PAIR_DEG, BoardPlan, expect_each
from experiments.paper.stage import Stage
from jaxscan.simulation import Motion, Placement, SimulationConfig, make_rig, rodrigues, take_frame
from jaxscan.simulation.rig import project


ANGLES_DEG = (0.5, 1.0, PAIR_DEG, 4.0, 8.0, 16.0, 24.0)
QUICK_DEG = (PAIR_DEG, 16.0)
CALIBRATIONS, QUICK_CALIBRATIONS = 4, 1
"""Number of calibrations by the paper's method that take their Tr from another pair."""
DRAWS, QUICK_DRAWS = 3, 2
"""Draws of the noise of each pair, for each calibration."""
_STREAM = 91
_TILT = rodrigues(np.array([np.cos(0.7), np.sin(0.7), 0.0]), np.deg2rad(30.0))
_MARGIN = 0.01
"""Of the image's size, between the board and the image's edge."""


class PairAngle(NamedTuple):
    """Results of pairs of one angle."""

    angle_deg: float
    depth_m: float
    """Of the board from the camera, midway between both views."""
    sizes: list[list[Size]]
    """By each calibration, with each draw of the pair's noise."""

    def rms(self, truth: Size) -> np.ndarray:
        """Root mean square error of width and length [2], mm; where walls were found."""
        errors = self._errors(truth)
        return np.sqrt(np.nanmean(errors**2, axis=(0, 1)))

    def scatter(self, truth: Size) -> np.ndarray:
        """Standard deviation of width and length [2], mm, by the noise of the pair alone: calibrations stay."""
        errors = self._errors(truth)
        apart = errors - np.nanmean(errors, axis=1, keepdims=True)
        seen = np.isfinite(errors).sum(1)
        return np.sqrt(np.nansum(apart**2, axis=(0, 1)) / np.maximum(seen - 1, 0).sum(0))

    def _errors(self, truth: Size) -> np.ndarray:
        return np.array([[size.errors(truth) for size in sizes] for sizes in self.sizes])


def pair_angles(stage: Stage, known: list[Draw], plain: PlainStripes, angles: np.ndarray) -> list[PairAngle]:
    """The room by the paper's method, with Tr from pairs of larger turns; camera and plane are those of its draws.

    Args:
        stage: The world.
        known: Calibrations by the paper's method, of which Tr is replaced.
        plain: Stripes of the room.
        angles: Of the table, of each record [rad].
    """
    out = []
    for degrees in QUICK_DEG if stage.quick else ANGLES_DEG:
        place = place_pair(stage.config, np.deg2rad(degrees))
        if place is None:
            continue
        placement, depth = place
        records = list(expect_each(stage, BoardPlan([placement], [False, False])))
        some = known[: QUICK_CALIBRATIONS if stage.quick else CALIBRATIONS]
        sizes: list[list[Size]] = [[] for _ in some]
        for draw in range(QUICK_DRAWS if stage.quick else DRAWS):
            for number, calibration in enumerate(some):
                random = stage.generator(_STREAM, round(100 * degrees), draw, number)
                views = [_corners(stage.config, record.off, random) for record in records]
                way = with_pair(calibration.paper, views, np.deg2rad(degrees))
                box = None if way is None else box_of(paper_points(way, plain, angles))
                sizes[number].append(size_of(box))
        out.append(PairAngle(degrees, depth, sizes))
    return out


def with_pair(way: PaperWay, views: list[BoardCorners | None], angle: float) -> PaperWay | None:
    """The same calibration with Tr from two other views, equation (10).

    Args:
        way: The calibration.
        views: The board in both views.
        angle: The table's turn between them, as commanded [rad].

    Returns:
        None if a board was not found.
    """
    poses = []
    for view in views:
        if view is None:
            return None
        poses.append(board_pose(way.matrix, way.k, view))
    return way._replace(tr=pair_motion(*poses), pair_angle=angle)


def place_pair(config: SimulationConfig, angle: float) -> tuple[Placement, float] | None:
    """A board before the camera, seen from half the angle on either side, as near to the working distance as it fits.

    Returns:
        The placement, and the board's depth midway [m]; None if the field of view is too small for the turn.
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
    return None


def smallest_angle(angles: np.ndarray, values: np.ndarray, wanted: float) -> float:
    """The angle at which a value falls to another, by the power law through all angles that were tried.

    Few draws at each angle scatter by a quarter: a first crossing would be too early.

    Args:
        angles: Of the pairs [deg].
        values: Of each [mm]; those that are not finite are left out.
        wanted: The value to reach [mm].

    Returns:
        The angle [deg], perhaps beyond those that were tried; infinite if values do not fall.
    """
    known = np.isfinite(values) & (values > 0)
    if known.sum() < 2:
        return np.inf
    slope, start = np.polyfit(np.log(angles[known]), np.log(values[known]), 1)
    return float(np.exp((np.log(wanted) - start) / slope)) if slope < 0 else np.inf


def _corners(config: SimulationConfig, light: np.ndarray, random: np.random.Generator) -> BoardCorners | None:
    """The board in one exposure without laser."""
    flicker = max(0.0, 1 + config.light.flicker * random.standard_normal())
    board = config.boards.board()
    return find_board(take_frame(light * np.float32(flicker), config, random), board.grid(), board.square)
