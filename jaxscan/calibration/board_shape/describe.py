"""The shape of a board as it was found: a map of its heights and of its print."""

import numpy as np

from jaxscan.calibration.board_shape.choose import ShapeChoice
from jaxscan.calibration.result import Calibration
from jaxscan.calibration.solve import Adjustment
from jaxscan.calibration.verdict import BoardMap
from jaxscan.geometry import BowedBoard
from jaxscan.observation import Observations


def describe_board(
    result: Adjustment, observations: Observations, calibration: Calibration, choice: ShapeChoice
) -> BoardMap | None:
    """Heights over the best plane and places in it, of every corner, with their standard deviations.

    Args:
        result: The finished solve.
        observations: Its observations.
        calibration: The calibration that was concluded from it.
        choice: Of `choose_shape`.

    Returns:
        The map; None of a solve that did not converge.
    """
    if not result.converged or calibration.fit is None:
        return None
    first = len(calibration.order)
    covariance = calibration.fit.covariance[first:, first:]
    board = np.asarray(observations.board.corners(), np.float64)
    shape = np.asarray(result.problem.shape)
    surface = BowedBoard(np.asarray(result.problem.frame), shape[:3])
    bow = np.stack([np.asarray(surface.rise(xy)) for xy in board[:, :2]])
    modes = np.asarray(result.problem.modes.corner)[: len(board)]
    # The pitch moves the corners in the plane, and is told by itself.
    numbers = np.array([0, 1, *range(3, len(shape))])
    heights = np.concatenate([bow, modes[:, 2]], axis=1)
    plane = np.column_stack([np.ones(len(board)), board[:, :2]])
    heights = heights - plane @ np.linalg.lstsq(plane, heights, rcond=None)[0]
    height = heights @ shape[numbers]
    shift = modes[:, :2] @ shape[3:]
    sigma = lambda slopes, part: np.sqrt(np.maximum(np.sum((slopes @ part) * slopes, axis=-1), 0.0))
    own = covariance[3:, 3:]
    return BoardMap(
        free=choice.free,
        rms_off_flat_m=float(np.sqrt(np.mean(height**2))),
        held_out_rms_parabola_px=choice.before_px,
        held_out_rms_px=choice.after_px,
        height_m=tuple(height.tolist()),
        height_sigma_m=tuple(sigma(heights, covariance[np.ix_(numbers, numbers)]).tolist()),
        shift_m=tuple((x, y) for x, y in shift.tolist()),
        shift_sigma_m=tuple(zip(*(sigma(modes[:, axis], own).tolist() for axis in (0, 1)), strict=True)),
    )
