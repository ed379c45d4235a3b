"""Boards that were captured with the rig as it is now: their information on the scanner's unknowns.

Poses and shape of the boards are solved with the scanner held, and eliminated. The equations that remain are linear in
a step of the scanner: as many equations as it has unknowns. With a better scanner they are formed again, so that the
whole is one joint least squares, by Gauss' and Newton's method.
"""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from jaxscan.calibration import CalibrationSettings
from jaxscan.calibration.adjust import Adjustment
from jaxscan.calibration.adjust import adjust as solve_boards
from jaxscan.calibration.first_values import average_placements, seed_poses
from jaxscan.calibration.joint import linearise
from jaxscan.calibration.problem import Prepared, make_problem, prepare
from jaxscan.errors import CalibrationError
from jaxscan.geometry import Rig, Scanner, carrying, square_root
from jaxscan.geometry.motions import ANGLE_PARAMETERS
from jaxscan.observation import Observations
from jaxscan.recalibration.adjust.room import Room


# Unknowns of the boards beside the scanner's; the squares have their nominal size.
_FREE = ("warp",)


class BoardEquations(NamedTuple):
    """Linear equations in a step of the scanner from the one that the boards were seen with."""

    rows: Float[np.ndarray, "params params"]
    """Right-hand side, in standard deviations; 0 for directions without information from boards."""
    value: Float[np.ndarray, " params"]
    result: Adjustment


def prepare_boards(observations: Observations, scanner: Scanner) -> Prepared:
    """The boards as the solver wants them, with the lasers in the scanner's order.

    Raises:
        CalibrationError: If they are of another camera or have other lasers.
    """
    camera = scanner.camera
    if (observations.width, observations.height) != (camera.width, camera.height):
        raise CalibrationError(
            f"The boards' images have {observations.width} x {observations.height} px, those of the stored calibration "
            f"{camera.width} x {camera.height} px: give captures of this camera mode."
        )
    unknown = sorted(set(observations.laser_names) - set(scanner.laser_names))
    if unknown:
        raise CalibrationError(
            f"The boards were lit by laser {unknown[0]!r}, the stored calibration has "
            f"{', '.join(scanner.laser_names)}: give captures of this rig."
        )
    number = np.array([scanner.laser_names.index(name) for name in observations.laser_names], np.int32)
    stripes = replace(observations.stripes, laser=number[np.asarray(observations.stripes.laser)])
    data = prepare(replace(observations, stripes=stripes, laser_names=scanner.laser_names))
    if not data.fixes_pose.any():
        raise CalibrationError("The board was found in no view of the captured boards, so they carry no information.")
    return data


def board_equations(rig: Rig, data: Prepared, before: BoardEquations | None) -> BoardEquations:
    """The information of boards on a step from the present rig, after that of a scanner nearby; call in 64 bit."""
    settings = CalibrationSettings(free=_FREE, judge=False)
    if before is None:
        poses = average_placements(seed_poses(data, rig.camera), data, carrying(rig.motion, "scanner"))
    else:
        poses = np.asarray(before.result.problem.poses)
    problem = make_problem(rig.camera, rig.lasers, rig.motion, poses, data, settings)
    result = solve_boards(problem, data, settings)
    # A motion that carries the object is described for the scanner: its angles turn backwards.
    turned = -1.0 if rig.motion.carries == "object" else 1.0
    names = rig.layout().names
    scales = np.array(result.problem.scales)
    scales[: len(names)] = [turned if name in ANGLE_PARAMETERS else 1.0 for name in names]
    free = linearise(replace(result.problem, scales=scales))
    # Poses are at their minimum.
    information, gradient = np.array(free.reduced), np.asarray(free.arrow.shared_gradient)
    empty = np.diagonal(free.arrow.shared) == 0
    information[empty], information[:, empty] = 0.0, 0.0
    count = len(names)
    shape = np.flatnonzero(~empty[count:]) + count
    beside = information[:count][:, shape]
    taken = np.linalg.solve(information[np.ix_(shape, shape)], beside.T)
    root = square_root(information[:count, :count] - beside @ taken)
    # |steps x - value|^2 has this second derivative, and this first one at 0.
    value = -root.inverse.T @ (gradient[:count] - gradient[shape] @ taken)
    return BoardEquations(root.steps, value, result)


def with_boards(room: Room, z: Float[np.ndarray, " params"], equations: BoardEquations) -> Room:
    """The room's problem with these equations of a step from the scanner at `z` in the last of its `linear_rows`."""
    rows = equations.rows @ room.root
    every, values = np.array(room.linear_rows), np.array(room.linear_values)
    every[-len(rows) :], values[-len(rows) :] = rows, equations.value + rows @ z
    return eqx.tree_at(lambda r: (r.linear_rows, r.linear_values), room, (every, values))
