"""First values of the motion, and of the placements that it passes."""

import itertools

import jax
import numpy as np

from jaxscan.calibration.rigs import MIN_TRAVEL_M, MIN_TURN_RAD
from jaxscan.calibration.solve.prepare import Prepared
from jaxscan.errors import CalibrationError
from jaxscan.geometry import AbstractMotion, Carries, LinearStage, Turntable, fit_axis, nearest_rotation, point_up
from jaxscan.geometry.scanner import Up


# Boards before a linear stage do not turn; their poses from a first camera may be off by less than this.
_MAX_TILT_DEG = 5.0


def seed_motion(poses: np.ndarray, data: Prepared, carries: Carries, up: Up) -> AbstractMotion:
    """The motion from placements seen at several positions.

    Args:
        poses: T_cam_board of every view [views, 4, 4].
        data: For the position and placement of each view.
        carries: The kind of motion.
        up: The image's up direction.

    Raises:
        CalibrationError: If no placement was seen from two positions, or the boards did not move like that.
    """
    if carries in ("scanner", "object"):
        return _seed_axis(poses, data, carries, up)
    return _seed_travel(poses, data)


def _seed_axis(poses: np.ndarray, data: Prepared, carries: Carries, up: Up) -> AbstractMotion:
    """Axis and sense of the table.

    Source: the paper, equation (10), for all pairs of angles.
    """
    pairs = _pairs(data, MIN_TURN_RAD)
    if not pairs:
        raise CalibrationError(
            "No board placement was seen from two table angles, so the axis cannot be determined: "
            "leave the board standing and turn the table between images (same `placement`, other `angle_deg`)."
        )
    turn = np.array([data.angle[first] - data.angle[second] for first, second in pairs])
    motion = np.array([poses[second] @ np.linalg.inv(poses[first]) for first, second in pairs])
    try:
        axis = fit_axis(motion)
    except ValueError:
        raise CalibrationError(
            f"The commanded angles differ by up to {np.degrees(np.abs(turn).max()):.1f} degrees but the board did not "
            "move in the image: the table did not turn, or the board turned with the camera."
        ) from None
    seen = _signed_angles(motion[:, :3, :3], axis.direction)
    gain = _gain(turn, seen)
    if not 0.8 < abs(gain) < 1.25:
        raise CalibrationError(
            f"The boards turned by {gain:.3f} times the commanded angles: check the steps per turn of the table, and "
            "that records with the same `placement` saw the board unmoved."
        )
    start = Turntable.from_axis(axis.direction, axis.point, gain=float(np.sign(gain))).carrying(carries)
    return point_up(start, up)


def _seed_travel(poses: np.ndarray, data: Prepared) -> LinearStage:
    """Direction of travel, as the mean of the boards' shifts over the commanded ones."""
    pairs = _pairs(data, MIN_TRAVEL_M)
    if not pairs:
        raise CalibrationError(
            "No board placement was seen from two positions of the stage, so its direction cannot be determined: leave "
            "the board standing and move the stage between images (same `placement`, other `position_m`)."
        )
    first, second = np.array(pairs).T
    travel = data.angle[second] - data.angle[first]
    shift = poses[first, :3, 3] - poses[second, :3, 3]
    turned = np.swapaxes(poses[first, :3, :3], 1, 2) @ poses[second, :3, :3]
    tilt = np.degrees(np.arccos(np.clip((np.trace(turned, axis1=1, axis2=2) - 1) / 2, -1.0, 1.0)))
    if np.median(tilt) > _MAX_TILT_DEG:
        raise CalibrationError(
            f"The boards turned by {np.median(tilt):.1f} degrees while the stage moved, and a linear stage only "
            "shifts them: check `carries` in capture.toml, and that records with the same `placement` saw the board "
            "unmoved."
        )
    direction = travel @ shift / (travel @ travel)
    gain = float(np.linalg.norm(direction))
    if not 0.8 < gain < 1.25:
        raise CalibrationError(
            f"The boards moved by {gain:.3f} times the commanded travel: check that position_m is in metres, the size "
            "of the board's squares, and that records with the same `placement` saw the board unmoved."
        )
    return LinearStage.from_direction(direction)


def _pairs(data: Prepared, least: float) -> list[tuple[int, int]]:
    """Views of the same placement at positions that differ by more than `least`."""
    pairs = []
    for number in np.unique(data.placement[data.usable]):
        views = np.flatnonzero(data.usable & (data.placement == number))
        pairs += [
            (i, j) for i, j in itertools.combinations(views.tolist(), 2) if abs(data.angle[i] - data.angle[j]) > least
        ]
    return pairs


def average_placements(poses: np.ndarray, data: Prepared, motion: AbstractMotion) -> np.ndarray:
    """T_cam0_board of every placement [views, 4, 4] (as many as views; the rest is identity)."""
    motions = np.asarray(jax.tree.map(np.asarray, motion).motion(data.angle))
    result = np.tile(np.eye(4), (len(data.usable), 1, 1))
    for number in np.unique(data.placement[data.usable]):
        views = np.flatnonzero(data.usable & (data.placement == number))
        still = motions[views] @ poses[views]
        result[number, :3, :3] = nearest_rotation(still[:, :3, :3].mean(0))
        result[number, :3, 3] = np.median(still[:, :3, 3], axis=0)
    return result


def _signed_angles(rotations: np.ndarray, direction: np.ndarray) -> np.ndarray:
    skew = rotations - np.swapaxes(rotations, 1, 2)
    vector = np.column_stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]]) / 2
    return np.arctan2(vector @ direction, (np.trace(rotations, axis1=1, axis2=2) - 1) / 2)


def _gain(commanded: np.ndarray, seen: np.ndarray) -> float:
    """Seen over commanded angle, whichever sense fits; `seen` is known up to full turns."""
    best, error = 0.0, np.inf
    for sense in (1.0, -1.0):
        full = seen + 2 * np.pi * np.round((sense * commanded - seen) / (2 * np.pi))
        gain = float(commanded @ full / (commanded @ commanded))
        misfit = float(np.abs(full - gain * commanded).mean() + np.abs(full - sense * commanded).mean())
        if misfit < error:
            best, error = gain, misfit
    return best
