"""Exact corners and stripe points of calibration boards, without rendering.

`add_noise` adds noise. The code is independent of `geometry`: see `ideal_rig`.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxscan.errors import ConfigError
from jaxscan.simulation import LaserSpec, Motion, SimulationConfig, rodrigues

from .ideal_rig import NEAREST_M, IdealRig


_MARGIN_PX = 8.0
_TRIES = 5000
# A board seen flatter than this cosine shows its corners badly.
_FACING = 0.35
# The part of the shorter side of the board that a stripe must at least cross.
_CROSSED = 0.5
_ROLL_DEG = 20.0


class BoardPoses(NamedTuple):
    """Poses of the boards, and the table angles at which each is seen."""

    boards: list[Motion]
    """T_cam0_board of every placement: in the camera frame at angle 0."""
    placement: np.ndarray
    """Placement of each view [views]."""
    angle: np.ndarray
    """Table angle of each view [views], rad."""
    lit: np.ndarray
    """Whether the laser is on in a view [views]."""


class IdealBoards(NamedTuple):
    """Observations of boards, in the shapes that a calibration reads."""

    corner_q: np.ndarray
    """[views, corners, 2], px; all corners are seen."""
    angle: np.ndarray
    placement: np.ndarray
    stripe_q: np.ndarray
    """[stripes, points, 2], px; whole rows (columns for a laser with that stripe axis)."""
    stripe_valid: np.ndarray
    stripe_view: np.ndarray
    stripe_laser: np.ndarray


class PosePlan(NamedTuple):
    """Number of poses to draw, and their table angles."""

    free_views: int
    """Boards seen once."""
    placements: int = 0
    """Boards seen at several angles."""
    angles: int = 1
    """Angles of each placement, evenly spread."""
    span_deg: float = 24.0
    """Range of the angles."""
    around_deg: Sequence[float | int] = (0.0,)
    """Middles of that range, for one placement after the other."""
    lit: int | None = None
    """How many of the free views show a stripe, the last ones; None: all. The others stand anywhere
    in the image. Placements stand across the stripe, which leaves the board where the table has
    turned far."""


def draw_poses(config: SimulationConfig, seed: int, plan: PosePlan) -> BoardPoses:
    """Random poses that show all corners: free views at angle 0, then placements seen while turning.

    Args:
        config: The true rig; `boards` holds range and tilt.

    Raises:
        ConfigError: If there is no such pose.
    """
    half = plan.span_deg / 2
    turns = np.deg2rad(np.linspace(-half, half, plan.angles)) if plan.angles > 1 else np.zeros(1)
    dark = 0 if plan.lit is None else plan.free_views - plan.lit
    random = np.random.default_rng(seed)
    boards, placement, angle = [], [], []
    for number in range(plan.free_views + plan.placements):
        free = number < plan.free_views
        home = 0.0 if free else np.deg2rad(plan.around_deg[(number - plan.free_views) % len(plan.around_deg)])
        stops = np.zeros(1) if free else home + turns
        boards.append(_draw(config, random, stops, home, crossed=number >= dark))
        placement += [number] * len(stops)
        angle += list(stops)
    views = np.array(placement)
    return BoardPoses(boards, views, np.array(angle), views >= dark)


def ideal_boards(
    config: SimulationConfig, poses: BoardPoses, *, points: int = 300, lens_px: float = 0.0
) -> IdealBoards:
    """Corners and stripes of boards in the given poses.

    Bow of board and sheets and errors of the table are those of `config`: an estimator is not to
    know them.

    Args:
        poses: Of `draw_poses`, perhaps for a rig that differs a little.
        points: Points of a stripe at most: of more rows, so many are taken, evenly spread.
        lens_px: An error of the lens model, in the corners of the image [px]: the part of r^8 that
            the five coefficients of the lens cannot take up.
    """
    rig = IdealRig(config, lens_px)
    corners = rig.bowed(config.boards.board().corners()[:, :2])
    seen, rows = [], []
    for view, (number, phi, lit) in enumerate(zip(poses.placement, poses.angle, poses.lit, strict=True)):
        pose = rig.turned(phi).inverse() @ poses.boards[number]
        seen.append(rig.project(pose.apply(corners)))
        for laser in range(len(config.laser)) if lit else ():
            q = rig.stripe(pose, laser, points)
            if len(q):
                rows.append((q, view, laser))
    stripes = np.zeros((len(rows), points, 2))
    valid = np.zeros((len(rows), points), bool)
    for row, (q, _, _) in enumerate(rows):
        stripes[row, : len(q)], valid[row, : len(q)] = q, True
    return IdealBoards(
        corner_q=np.array(seen),
        angle=poses.angle,
        placement=poses.placement.astype(np.int32),
        stripe_q=stripes,
        stripe_valid=valid,
        stripe_view=np.array([view for _, view, _ in rows], np.int32),
        stripe_laser=np.array([laser for _, _, laser in rows], np.int32),
    )


def add_noise(
    ideal: IdealBoards,
    random: np.random.Generator,
    *,
    corner_px: float = 0.1,
    stripe_px: float = 0.15,
    correlation: float = 0.0,
) -> IdealBoards:
    """The same with Gaussian noise.

    Args:
        random: Where the noise comes from.
        corner_px: Standard deviation of each coordinate of a corner [px].
        stripe_px: Standard deviation across the stripe [px].
        correlation: Between neighbouring points of a stripe, falling off as its powers: n points
            are worth n (1 - correlation) / (1 + correlation), a quarter of them at 0.6 [1].
    """
    corner_q = ideal.corner_q + corner_px * random.normal(size=ideal.corner_q.shape)
    white = random.normal(size=ideal.stripe_valid.shape)
    noise = white.copy()
    for point in range(1, white.shape[1]):
        noise[:, point] = correlation * noise[:, point - 1] + np.sqrt(1 - correlation**2) * white[:, point]
    return ideal._replace(corner_q=corner_q, stripe_q=ideal.stripe_q + stripe_px * _beside(ideal, noise))


def _beside(ideal: IdealBoards, shift: np.ndarray) -> np.ndarray:
    """Shifts across the stripes as shifts of whole rows' sub-pixel coordinate [stripes, points, 2]."""
    moved = np.zeros_like(ideal.stripe_q)
    for row, (q, valid) in enumerate(zip(ideal.stripe_q, ideal.stripe_valid, strict=True)):
        q = q[valid]
        if len(q) < 2:
            continue
        along = int(np.all(q[:, 1] == np.round(q[:, 1])))
        # A stripe that leans on its rows moves farther along them than across itself.
        lean = np.gradient(q[:, 1 - along]) / np.gradient(q[:, along])
        moved[row, valid, 1 - along] = shift[row, valid] * np.hypot(1.0, lean)
    return moved


def _draw(
    config: SimulationConfig, random: np.random.Generator, stops: np.ndarray, home: float, *, crossed: bool
) -> Motion:
    """T_cam0_board of a board that is wholly seen at every stop."""
    rig, spec = IdealRig(config), config.boards
    corners = np.column_stack([spec.board().corners()[:, :2], np.zeros(len(spec.board().corners()))])
    middle = np.append(rig.middle, 0.0)
    size = np.ptp(rig.outline, axis=0)
    for _ in range(_TRIES):
        z = float(np.exp(random.uniform(*np.log(spec.range_m))))
        laser = config.laser[int(random.integers(len(config.laser)))]
        n, d = laser.plane()
        x = random.uniform(-0.45, 0.45) * z * config.camera.width / config.camera.fx
        y = random.uniform(-0.45, 0.45) * z * config.camera.height / config.camera.fy
        if crossed and laser.stripe_axis == "rows":
            x = (d - n[2] * z - n[1] * y) / n[0] + random.uniform(-0.3, 0.3) * size[0]
        elif crossed:
            y = (d - n[2] * z - n[0] * x) / n[1] + random.uniform(-0.3, 0.3) * size[1]
        way = random.uniform(0, 2 * np.pi)
        tilt, roll = np.deg2rad([random.uniform(*spec.tilt_deg), random.uniform(-_ROLL_DEG, _ROLL_DEG)])
        rotation = rodrigues(np.array([np.cos(way), np.sin(way), 0.0]), tilt)
        rotation = rotation @ rodrigues(np.array([0.0, 0.0, 1.0]), roll)
        seen_home = Motion(rotation, np.array([x, y, z]) - rotation @ middle)
        if crossed and not _crosses(rig, seen_home, laser):
            continue
        pose = rig.turned(home) @ seen_home
        if all(_shows(rig, rig.turned(phi).inverse() @ pose, corners) for phi in stops):
            return pose
    raise ConfigError(
        f"No pose of the board ({spec.columns} x {spec.rows}, {spec.square_mm} mm) was found within "
        f"{list(spec.range_m)} m that the camera sees whole at {len(stops)} table angle(s): change [boards] range_m."
    )


def _shows(rig: IdealRig, pose: Motion, corners: np.ndarray) -> bool:
    p = pose.apply(corners)
    middle = p.mean(0)
    facing = pose.rotation[:, 2] @ middle > _FACING * np.linalg.norm(middle)
    # Beyond the field of view the lens model folds back into the image.
    camera = rig.config.camera
    reach = 0.7 * np.hypot(camera.width / camera.fx, camera.height / camera.fy)
    ahead = (p[:, 2] > NEAREST_M) & (np.hypot(p[:, 0], p[:, 1]) < reach * p[:, 2])
    return bool(facing and ahead.all() and rig.inside(rig.project(p), _MARGIN_PX).all())


def _crosses(rig: IdealRig, pose: Motion, laser: LaserSpec) -> bool:
    xy = rig.crossing(pose, laser)
    return len(xy) > 1 and bool(np.linalg.norm(xy[-1] - xy[0]) >= _CROSSED * np.ptp(rig.outline, axis=0).min())
