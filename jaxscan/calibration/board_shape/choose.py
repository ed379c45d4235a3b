"""Which shape a board may have: the one that predicts best views that had no part in the solve; and how it is told."""

from typing import Literal, NamedTuple

import numpy as np

from jaxscan.calibration.board_shape.held_out import HeldOut, hold_out
from jaxscan.calibration.board_shape.modes import bent_modes, corner_modes, smooth_modes
from jaxscan.calibration.result import Calibration
from jaxscan.calibration.settings import CalibrationSettings
from jaxscan.calibration.solve import Adjustment, adjust_further, undetermined_shares, with_modes
from jaxscan.calibration.solve.problem import BoardModes
from jaxscan.calibration.verdict import BoardMap
from jaxscan.errors import CalibrationError
from jaxscan.geometry import BowedBoard
from jaxscan.observation import Observations


FreeShape = Literal["parabola", "bent", "smooth", "corners"]
# Fewer placements are too few to leave some out.
_LEAST_PLACEMENTS = 8
# A shape must raise the likelihood of the views left out by this much (natural logarithm) ...
_LEAST_GAIN = 10.0
# ... and be better for more placements than half of them by this many standard deviations of a toss-up.
_LEAST_SIGNIFICANCE = 2.0
# Single corners take their time: the residuals left out must promise to fall by this factor.
_WORTH = 0.95
_MOST_CORNERS = 192
# Derivatives of all corner rows by all unknowns may take this much memory [bytes]; a few copies of them are made.
_MOST_BYTES = 3e8


class ShapeChoice(NamedTuple):
    """The shape of the board that was freed, and residuals of views that were left out."""

    free: FreeShape
    before_px: float | None = None
    """Root mean square corner distance of the views left out, with a parabola [px]; None where nobody has tried."""
    after_px: float | None = None
    """The same with the shape that was chosen."""


def choose_shape(
    result: Adjustment, observations: Observations, settings: CalibrationSettings
) -> tuple[Adjustment, ShapeChoice]:
    """The solve with the shape of the board that predicts best; call in 64 bit.

    Whether other shapes are worth a solve is seen to first order from the solve that is there.

    Args:
        result: The solve with a parabola.
        observations: Its observations.
        settings: Of the solve; the shape stays a parabola where "shape" or "warp" is held.
    """
    stay = result, ShapeChoice("parabola")
    placements = len(np.unique(result.data.placement[result.view_kept & result.data.usable]))
    wanted = {"shape", "warp"} <= set(settings.free)
    if not wanted or not result.converged or placements < _LEAST_PLACEMENTS:
        return stay
    if undetermined_shares(result.linearised, np.asarray(result.problem.scales)).any():
        return stay
    board, frame = np.asarray(observations.board.corners(), np.float64), np.asarray(result.problem.frame)
    smooth = smooth_modes(board, frame, len(result.data.board))
    bent = bent_modes(smooth)
    before, *promises = hold_out(result, (bent, smooth))
    parabola = result, ShapeChoice("parabola", _rms(before), _rms(before))
    if not any(_is_better(promise, before, result) for promise in promises):
        return parabola
    # The fewest unknowns first, but single corners are not reached by steps: each is a solve of its own size.
    shapes: list[tuple[FreeShape, BoardModes]] = [("bent", bent), ("smooth", smooth)]
    if len(board) <= _MOST_CORNERS and 8 * result.errors.corner.size * 3 * len(board) < _MOST_BYTES:
        corners = corner_modes(smooth, board, frame)
        _, least, finest = hold_out(result, (smooth, corners))
        if _rms(finest) < _WORTH * _rms(least) and _is_better(finest, least, result):
            found = _solved(result, corners, settings)
            after = before if found is None else hold_out(found)[0]
            if found is not None and _is_better(after, before, result):
                return found, ShapeChoice("corners", _rms(before), _rms(after))
    best, last = result, before
    free: FreeShape = "parabola"
    for name, modes in shapes:
        promise = hold_out(best, (modes,))[1]
        found = _solved(best, modes, settings) if _is_better(promise, last, best) else None
        after = last if found is None else hold_out(found)[0]
        if found is not None and _is_better(after, last, best):
            best, last, free = found, after, name
    return best, ShapeChoice(free, _rms(before), _rms(last))


def _solved(result: Adjustment, modes: BoardModes, settings: CalibrationSettings) -> Adjustment | None:
    """The solve with other modes; None where it finds no minimum."""
    try:
        found = adjust_further(result, with_modes(result.problem, modes, settings), settings)
    except CalibrationError:
        # The parabola did find one, and is kept.
        return None
    return found if found.converged else None


def _is_better(after: HeldOut, before: HeldOut, result: Adjustment) -> bool:
    """Whether one model predicts the views that were left out better than another, beyond chance."""
    both = after.counted & before.counted
    squares = lambda held: np.where(both, np.sum(held.error**2, axis=-1) / result.corner_sigma**2, 0.0).sum(1)
    used = both.any(1)
    owner = np.unique(result.data.placement[used], return_inverse=True)[1]
    gain = np.bincount(owner, (squares(before) - squares(after))[used])
    # Most placements must agree: a count, because few of them have most of the views.
    agreeing = 2 * np.count_nonzero(gain > 0) - len(gain)
    return bool(gain.sum() > 2 * _LEAST_GAIN and agreeing > _LEAST_SIGNIFICANCE * np.sqrt(len(gain)))


def _rms(held: HeldOut) -> float:
    return float(np.sqrt(np.sum(held.error**2) / max(int(held.counted.sum()), 1)))


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
