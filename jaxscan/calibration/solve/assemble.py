"""The least-squares problem put together: which unknowns there are, their priors, their scales."""

from dataclasses import replace

import jax
import numpy as np

from jaxscan.calibration.parameters import BOARD_PARAMETERS, block_of, parameter_scales
from jaxscan.calibration.settings import CalibrationSettings
from jaxscan.calibration.solve.prepare import Prepared
from jaxscan.calibration.solve.problem import Problem
from jaxscan.geometry import AbstractCamera, LaserSheet, Turntable, corner_frame, stack_lasers
from jaxscan.geometry.laser import LASER_PARAMETERS
from jaxscan.geometry.turntable import AXIS_PARAMETERS, Carries


def make_problem(
    camera: AbstractCamera,
    lasers: LaserSheet | None,
    table: Turntable | None,
    poses: np.ndarray,
    data: Prepared,
    settings: CalibrationSettings,
) -> Problem:
    """The least-squares problem of these observations, seen from first values; its weights are still 0.

    Args:
        camera: First camera.
        lasers: First sheets, stacked; None where only the camera is sought.
        table: First table; None where only the camera is sought.
        poses: T_cam0_board of every placement, as many as views [views, 4, 4].
        data: Of `prepare`.
        settings: Free blocks and priors.
    """
    centre = (data.size[0] - 1) / 2, (data.size[1] - 1) / 2
    # The solver needs neither names nor sizes, and would compile again for each.
    camera = replace(camera, width=0, height=0)
    sheets = stack_lasers([LaserSheet.from_plane(np.array([1.0, 0.0, 0.0]), 1.0)]) if lasers is None else lasers
    if lasers is None:
        sheets = jax.tree.map(lambda leaf: leaf[:0], sheets)
    names = shared_names(camera, tuple(str(i) for i in range(len(sheets.distance))), table is not None)
    expected = {"cx": centre[0], "cy": centre[1], "fx": 1.0, "gain": 1.0}
    return Problem(
        camera=camera,
        lasers=sheets,
        turntable=None if table is None else carrying(table, "scanner"),
        poses=poses,
        shape=np.zeros(len(BOARD_PARAMETERS)),
        scales=parameter_scales(names, settings.free, settings.camera),
        expected=np.array([expected.get(name, 0.0) for name in names]),
        prior_weight=prior_weights(names, settings),
        board=data.board,
        frame=corner_frame(data.board),
        corner_q=data.corner_q,
        corner_weight=np.zeros(data.corner_valid.shape),
        angle=data.angle,
        placement=data.placement,
        stripe_q=data.stripe_q,
        stripe_weight=np.zeros(data.stripe_valid.shape),
        stripe_view=data.stripe_view,
        stripe_laser=data.stripe_laser,
    )


def shared_names(camera: AbstractCamera, lasers: tuple[str, ...], turns: bool) -> tuple[str, ...]:
    """Names of the shared unknowns: the scanner's minimal coordinates, then the board's."""
    sheets = tuple(f"laser.{name}.{part}" for name in lasers for part in LASER_PARAMETERS)
    return camera.parameter_names() + sheets + (AXIS_PARAMETERS if turns else ()) + BOARD_PARAMETERS


def prior_weights(names: tuple[str, ...], settings: CalibrationSettings) -> np.ndarray:
    """1 / standard deviation of every prior; 0 where there is none, and for held unknowns."""
    priors = settings.priors
    sigma = {
        **dict.fromkeys(("cx", "cy"), priors.centre_px),
        "fx": priors.aspect,
        **dict.fromkeys(("p1", "p2"), priors.tangential),
        **dict.fromkeys(("k3", "k4", "k5", "k6"), priors.k3),
        "gain": priors.gain,
        **dict.fromkeys(("c1", "s1", "c2", "s2"), priors.harmonics),
        **dict.fromkeys(("b2", "b3"), priors.bow),
        **dict.fromkeys(("warp.x", "warp.y"), priors.warp),
        "pitch": priors.pitch,
    }
    free = [block_of(name, settings.camera) in settings.free for name in names]
    return np.array(
        [
            1.0 / sigma.get(name.rsplit(".", 1)[-1] if name.startswith("laser.") else name, np.inf) * is_free
            for name, is_free in zip(names, free, strict=True)
        ]
    )


def carrying(table: Turntable, carries: Carries) -> Turntable:
    """The same motion of boards in front of the camera: a table that turns backwards turns the other part."""
    if table.carries == carries:
        return table
    return Turntable(table.direction, table.point, -table.gain, -table.harmonics, table.basis, carries)
