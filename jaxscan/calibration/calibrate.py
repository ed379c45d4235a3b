"""Observations to a calibration: seed, joint solve, conclusion."""

import contextlib
import time
from collections.abc import Iterator
from dataclasses import replace

import equinox as eqx
import jax
import numpy as np

from jaxscan.calibration.board_shape import choose_shape, describe_board
from jaxscan.calibration.conclude import conclude
from jaxscan.calibration.parameters import CAMERA_BLOCKS
from jaxscan.calibration.result import Calibration
from jaxscan.calibration.seed import average_placements, lift_stripes, seed_axis, seed_camera, seed_plane
from jaxscan.calibration.settings import CalibrationSettings
from jaxscan.calibration.solve import Adjustment, Prepared, adjust, make_problem, not_converged, prepare
from jaxscan.calibration.solve.noise import huber_weights
from jaxscan.calibration.solve.problem import Problem
from jaxscan.errors import CalibrationError
from jaxscan.geometry import AbstractCamera, LaserSheet, Turntable, point_up, stack_lasers
from jaxscan.geometry.scanner import UP_VECTORS
from jaxscan.observation import Observations


@contextlib.contextmanager
def _contradictions() -> Iterator[None]:
    """Report equations without a solution as a fault of the observations."""
    try:
        yield
    except np.linalg.LinAlgError as problem:
        raise CalibrationError(
            f"The observations contradict each other, so no calibration fits them ({problem}): check the board's size "
            "and the angles of the table, or capture the board again."
        ) from problem


def calibrate_observations(observations: Observations, *, settings: CalibrationSettings | None = None) -> Calibration:
    """Camera, laser sheets and axis in one least-squares problem, with their covariance.

    Closed-form first values; then a robust joint solve, rejection of outliers, estimation of the
    noise of corners and stripes, and a last plain solve. Runs in float64 whatever the caller's
    JAX settings.

    Args:
        observations: Board corners, stripes on boards, table angles.
        settings: Free blocks, priors, thresholds.

    Returns:
        The calibration; its `quality` says first whether the solve converged, and with
        `settings.judge` it has predicted lengths and a verdict.

    Raises:
        CalibrationError: If the observations do not determine the scanner; it names the captures that are missing.

    Source: PAPER.md equations (1)-(12), solved together.
    """
    settings = settings or CalibrationSettings()
    started = time.perf_counter()
    if not observations.laser_names:
        raise CalibrationError("The observations name no laser, so there is no laser sheet to be found.")
    with jax.enable_x64(True), _contradictions():
        data = prepare(observations)
        # Each view by itself, without stripes and table: lasers and table are held and meet no
        # observation, so that both solves are one compiled function.
        apart = _apart(data)._replace(stripe_valid=np.zeros_like(data.stripe_valid))
        cameras, poses = seed_camera(apart, settings.camera)
        free = tuple(block for block in settings.free if block in CAMERA_BLOCKS)
        held, stand_ins = replace(settings, free=free), _stand_ins(observations)
        starts = [make_problem(camera, *stand_ins, poses, apart, held) for camera in cameras]
        first = _lowest(starts, apart, settings)
        camera, poses = _named(first.problem.camera, observations, settings), np.asarray(first.problem.poses)
        try:
            lasers = [
                seed_plane(lift_stripes(data, camera, poses, index), name)
                for index, name in enumerate(observations.laser_names)
            ]
            table = seed_axis(poses, data, observations.carries, observations.up)
        except CalibrationError:
            if first.converged:
                raise
            # The diagnosis would be of numbers that mean nothing.
            raise CalibrationError(not_converged(settings)) from None
        placements = average_placements(poses, data, table)
        problem = make_problem(first.problem.camera, stack_lasers(lasers), table, placements, data, settings)
        result = _pointed_up(adjust(problem, data, settings), observations, settings)
        return _concluded(result, observations, settings, started)


def calibrate_camera(observations: Observations, *, settings: CalibrationSettings | None = None) -> Calibration:
    """The camera alone, from boards in any poses; stripes, angles and placements are not used.

    Args:
        observations: Board corners.
        settings: As for `calibrate_observations`.

    Returns:
        A calibration without a scanner; `order` and `covariance` are the camera's.

    Raises:
        CalibrationError: If the views do not determine a camera.

    Source: PAPER.md equations (1), (2), (4), after Zhang.
    """
    settings = settings or CalibrationSettings()
    started = time.perf_counter()
    free = tuple(block for block in settings.free if block in (*CAMERA_BLOCKS, "warp", "pitch", "shape"))
    settings = replace(settings, free=free)
    with jax.enable_x64(True), _contradictions():
        data = _without_stripes(_apart(prepare(observations)))
        cameras, poses = seed_camera(data, settings.camera)
        starts = [make_problem(camera, None, None, poses, data, settings) for camera in cameras]
        problem = starts[0] if len(starts) == 1 else _lowest(starts, data, settings).problem
        return _concluded(adjust(problem, data, settings), observations, settings, started)


def _lowest(starts: list[Problem], data: Prepared, settings: CalibrationSettings) -> Adjustment:
    """Of robust solves from each start the one that fits the corners best."""

    def cost(found: Adjustment) -> float:
        size = np.linalg.norm(found.corner_error, axis=-1)[data.corner_valid] / data.corner_sigma[data.corner_valid]
        return float(np.sum(huber_weights(size, settings.huber) ** 2 * size**2))

    return min((adjust(start, data, settings, rejection=False) for start in starts), key=cost)


def _apart(data: Prepared) -> Prepared:
    """Every view a placement of its own, so that a board moved by mistake does no harm."""
    return data._replace(
        placement=np.where(data.usable, np.arange(len(data.usable)), 0).astype(np.int32),
        angle=np.zeros_like(data.angle),
    )


def _without_stripes(data: Prepared) -> Prepared:
    return data._replace(**{name: getattr(data, name)[:0] for name in data._fields if name.startswith("stripe_")})


def _stand_ins(observations: Observations) -> tuple[LaserSheet, Turntable]:
    sheet = LaserSheet.from_plane(np.array([1.0, 0.0, 0.0]), 1.0)
    table = Turntable.from_axis(np.array(UP_VECTORS[observations.up]), np.array([0.0, 0.0, -0.1]))
    return stack_lasers([sheet] * len(observations.laser_names)), table


def _named(camera: AbstractCamera, observations: Observations, settings: CalibrationSettings) -> AbstractCamera:
    """The solver's camera with its size, and without optional coefficients that nobody asked for."""
    count = sum(len(block.parameters) for block in camera.lens if not block.optional or block.name in settings.free)
    distortion = np.asarray(camera.distortion)[:count]
    return replace(camera, distortion=distortion, width=observations.width, height=observations.height)


def _pointed_up(result: Adjustment, observations: Observations, settings: CalibrationSettings) -> Adjustment:
    """The seed points up; only an axis that lies across the image can have swung over since."""
    before = result.problem.turntable
    table = before if before is None else point_up(before, observations.up)
    if table is before:
        return result
    return adjust(eqx.tree_at(lambda p: p.turntable, result.problem, table), result.data, settings)


def _concluded(
    result: Adjustment, observations: Observations, settings: CalibrationSettings, started: float
) -> Calibration:
    result, choice = choose_shape(result, observations, settings)
    calibration = conclude(result, _named(result.problem.camera, observations, settings), observations, settings)
    board = describe_board(result, observations, calibration, choice)
    seconds = time.perf_counter() - started
    return replace(calibration, quality=replace(calibration.quality, board=board, seconds=seconds))
