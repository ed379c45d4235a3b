"""The least-squares problem put together: which unknowns there are, their priors, their scales."""

from dataclasses import replace

import numpy as np

from jaxscan.calibration.settings import CalibrationSettings
from jaxscan.calibration.solve.prepare import Prepared
from jaxscan.calibration.solve.problem import BoardModes, Problem, no_modes, problem_layout
from jaxscan.geometry import AbstractCamera, AbstractMotion, LaserSheet, Layout, corner_frame


def make_problem(
    camera: AbstractCamera,
    lasers: LaserSheet,
    motion: AbstractMotion,
    poses: np.ndarray,
    data: Prepared,
    settings: CalibrationSettings,
) -> Problem:
    """The least-squares problem of these observations, seen from first values; its weights are still 0.

    Args:
        camera: First camera.
        lasers: First sheets, stacked, perhaps none.
        motion: First motion between the records; `Still` where every view has a pose of its own.
        poses: T_cam0_board of every placement, as many as views [views, 4, 4].
        data: Of `prepare`.
        settings: Free blocks and priors.
    """
    layout = problem_layout(camera, lasers, motion)
    centre = {"cx": (data.size[0] - 1) / 2, "cy": (data.size[1] - 1) / 2}
    return Problem(
        # A problem of its own for each size would be compiled again for each.
        camera=camera.without_size(),
        lasers=lasers,
        turntable=motion.carrying("scanner"),
        poses=poses,
        shape=np.zeros(3),
        scales=parameter_scales(layout, settings.free),
        expected=np.array([centre.get(name, block.expected) for name, block in zip(*layout[:2], strict=True)]),
        prior_weight=prior_weights(layout, settings),
        board=data.board,
        frame=corner_frame(data.board),
        modes=no_modes(len(data.board)),
        corner_q=data.corner_q,
        corner_weight=np.zeros(data.corner_valid.shape),
        angle=data.angle,
        placement=data.placement,
        seen=np.any(data.corner_valid, axis=1),
        stripe_q=data.stripe_q,
        stripe_weight=np.zeros(data.stripe_valid.shape),
        stripe_view=data.stripe_view,
        stripe_laser=data.stripe_laser,
        lit=np.any(data.stripe_valid, axis=1),
    )


def with_modes(problem: Problem, modes: BoardModes, settings: CalibrationSettings) -> Problem:
    """The same problem with more modes of the board's shape, which begin at 0; modes that move nothing are held."""
    layout = problem_layout(problem.camera, problem.lasers, problem.turntable, modes.corner.shape[-1])
    count = layout.board.start + 3
    there = np.concatenate([np.ones(count), np.any(modes.corner != 0, axis=(0, 1))])
    expected = np.zeros(len(there))
    expected[:count] = problem.expected[:count]
    return replace(
        problem,
        shape=np.pad(np.asarray(problem.shape), (0, len(there) - count + 3 - len(problem.shape))),
        scales=parameter_scales(layout, settings.free) * there,
        expected=expected,
        prior_weight=prior_weights(layout, settings) * there,
        modes=modes,
    )


def parameter_scales(layout: Layout, free: tuple[str, ...]) -> np.ndarray:
    """Size of one scaled unit of each shared unknown [px, 1, rad, m]; 0 where it is held.

    The damping is scale-invariant; the scales make tolerances mean the same for all.
    """
    return np.array([block.scale * (block.name in free) for block in layout.blocks])


def prior_weights(layout: Layout, settings: CalibrationSettings) -> np.ndarray:
    """1 / standard deviation of every prior; 0 where there is none, and for unknowns that are held."""
    return np.array(
        [(block.name in settings.free) / settings.priors.get(block.prior, block.sigma) for block in layout.blocks]
    )
