"""Warm calibrations from observations, for `speed.py`: the whole rig, and the camera beside OpenCV's.

The rig has 40 views of 88 corners and 40 stripes of 1000 points, about 46 000 residuals. Times
exclude compilation and include all that a call does: preparing, seeds, solve, rejection, covariance
and quality.
"""

import time
from collections.abc import Callable
from typing import Any

import cv2
import jax
import numpy as np
from measuring.speed_times import Figure, take_turns
from worlds import calibration_trials as trials
from worlds.ideal_boards import PosePlan, add_noise, draw_poses, ideal_boards

from jaxscan.calibration import Calibration, CalibrationSettings, calibrate_camera, calibrate_observations
from jaxscan.observation import Observations


VIEWS, POINTS, CAMERA_VIEWS = 40, 1000, 23
FEWER_VIEWS = 37
"""Of a second calibration in the same process, which should compile nothing."""
COMPILING = "/jax/core/compile/backend_compile_duration"


def calibration_figures(repeats: int) -> list[Figure]:
    """Warm times, and the time of compiling for another number of views."""
    rig, fewer = _rig(VIEWS), _rig(FEWER_VIEWS)
    plain = CalibrationSettings(judge=False)
    first = time.perf_counter()
    calibrate_observations(rig)
    first = time.perf_counter() - first
    compiled: list[float] = []

    def listen(event: str, duration: float, **_: object) -> None:
        if event == COMPILING:
            compiled.append(duration)

    jax.monitoring.register_event_duration_secs_listener(listen)
    calibrate_observations(fewer)
    others, seconds = len(compiled), sum(compiled)
    ours, theirs = camera_contest()
    times = take_turns(
        {
            "plain": lambda: calibrate_observations(rig, settings=plain),
            "judged": lambda: calibrate_observations(rig),
            "ours": ours,
            "opencv": theirs,
        },
        repeats,
    )
    return [
        Figure("calibrate_observations, 40 views, first call", first, "s", "lower", 0.3),
        Figure("calibrate_observations, 40 views, warm", times["plain"].best, "s", "lower", 0.2, 0.4),
        Figure("calibrate_observations, 40 views, models judged", times["judged"].best, "s", "lower", 0.2),
        Figure(f"functions compiled for {FEWER_VIEWS} views after {VIEWS}", others, "", "lower", 0.0, 0.0),
        Figure("time of compiling these", seconds, "s", "lower", 0.3),
        Figure("camera alone", 1e3 * times["ours"].best, "ms", "lower", 0.2),
        Figure("camera alone / OpenCV", times["ours"].best / times["opencv"].best, "1", "lower", 0.2, 1.0),
    ]


def camera_contest() -> tuple[Callable[[], Calibration], Callable[[], Any]]:
    """The camera from the same 23 views by ours, with seed, covariance and rejection, and by OpenCV's."""
    config = trials.reference()
    poses = draw_poses(config, 5, PosePlan(free_views=CAMERA_VIEWS, placements=0, angles=1, lit=0))
    observed = trials.observations(add_noise(ideal_boards(config, poses), np.random.default_rng(0)), config)
    points = [observed.board.corners().astype(np.float32)] * CAMERA_VIEWS
    pixels = [q.astype(np.float32) for q in observed.corners.q]
    size = (config.camera.width, config.camera.height)
    plain = CalibrationSettings(judge=False)
    return (
        lambda: calibrate_camera(observed, settings=plain),
        lambda: cv2.calibrateCamera(points, pixels, size, None, None),
    )


def _rig(views: int) -> Observations:
    """All views of a rig, with the noise of a detector."""
    config = trials.reference()
    poses = draw_poses(config, 3, PosePlan(free_views=views - 9, placements=3, angles=3))
    noisy = add_noise(ideal_boards(config, poses, points=POINTS), np.random.default_rng(0))
    return trials.observations(noisy, config)
