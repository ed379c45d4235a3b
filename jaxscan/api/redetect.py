"""The second look at a capture: boards and stripes where a first calibration says that they are."""

import functools
from collections.abc import Sequence

import numpy as np

from jaxscan.api.board_stripes import View, with_stripes
from jaxscan.api.boards import Progress, common_board, look_at_boards
from jaxscan.calibration import Calibration, SecondLook
from jaxscan.calibration.predict import PredictedCorners, board_poses, predict_corners
from jaxscan.files.capture import Capture
from jaxscan.geometry import AbstractBoard


# A corner is believed within so many standard deviations of the first solve's residuals, ...
_REACH_SIGMA = 5.0
# ... and this much more [px]: in a view that helped to predict itself, and in one that did not.
_REACH_PX = 0.3
_REACH_UNSEEN_PX = 1.5
# The second solve may whiten worse by this factor: corners at the rim of the image are harder to explain.
_NOT_WORSE = 1.05


def look_again(
    captures: Sequence[Capture],
    views: Sequence[View],
    first: Calibration,
    *,
    stripes: bool,
    progress: Progress | None = None,
) -> list[View]:
    """Every record once more, with the geometry of a first calibration.

    Corners are refined from where they should be, those that were missed are looked for, and so
    are boards that were not found but were seen from other angles. Stripes are extracted from a
    band round where the sheet meets the board.

    Args:
        captures: As of the first look.
        views: What it found, of all records.
        first: What was solved from that.
        stripes: Look for stripes too.
        progress: Called with (records done, records in all).
    """
    board = common_board(captures)
    poses = _poses(views, first)
    predicted = predict_corners(first, np.array([np.eye(4) if pose is None else pose for pose in poses]))
    at = {(view.capture, view.record.i): number for number, view in enumerate(views)}
    spread = _REACH_SIGMA * (first.quality.corner_rms_px or 0.0)

    def look(number: int, index: int) -> View:
        view = View.of(captures[number], number, index)
        known = at[number, view.record.i]
        before = views[known]
        view = view._replace(corners=before.corners, pose=poses[known], noise=before.noise)
        if view.pose is None:
            return view
        reach = spread + (_REACH_PX if before.corners is not None else _REACH_UNSEEN_PX)
        return _corners_again(view, board, PredictedCorners(*(part[known] for part in predicted)), reach)

    again = functools.partial(with_stripes, calibration=first) if stripes else lambda views, capture: views
    return look_at_boards(captures, look, again, progress)


def _corners_again(view: View, board: AbstractBoard, predicted: PredictedCorners, reach: float) -> View:
    from jaxscan.vision.redetect import redetect_corners

    image = view.picture()
    if image is None:
        return view
    found = redetect_corners(image, board, *predicted, reach=reach, first=view.corners)
    return view._replace(corners=found)


def _poses(views: Sequence[View], first: Calibration) -> list[np.ndarray | None]:
    """T_cam_board of every record as far as the first calibration knows it."""
    fit = first.fit
    poses: list[np.ndarray | None] = [None] * len(views)
    if fit is None:
        return poses
    rows = dict(zip([n for n, view in enumerate(views) if view.corners is not None], range(len(views)), strict=False))
    used = np.any(fit.corner_kept, axis=1).tolist()
    seen: dict[tuple[int, int], int] = {}
    for number, row in rows.items():
        if not used[row]:
            continue
        poses[number] = fit.pose[row]
        view = views[number]
        if view.record.placement is not None and view.record.angle is not None:
            seen[view.capture, view.record.placement] = row
    if first.scanner is None:
        return poses
    for number, view in enumerate(views):
        if poses[number] is None and view.record.placement is not None and view.record.angle is not None:
            key = (view.capture, view.record.placement)
            if key in seen:
                poses[number] = board_poses(first, np.array([view.record.angle]), np.array([seen[key]]))[0]
    return poses


def choose(first: Calibration, second: Calibration) -> tuple[Calibration, SecondLook]:
    """The second calibration unless it explains its observations worse, and the gains of the second look."""
    names = ("corner_rms_whitened", "stripe_rms_whitened", "views", "corners", "stripe_points")
    before, after = ({name: vars(calibration.quality)[name] for name in names} for calibration in (first, second))
    kept = bool(second.quality.converged) and all(after[name] <= _NOT_WORSE * before[name] for name in names[:2])
    look = SecondLook(
        kept,
        **{f"{name}_gained": after[name] - before[name] for name in names[2:]},
        **{f"{name}_before": before[name] for name in names[:2]},
        **{f"{name}_after": after[name] for name in names[:2]},
    )
    return second if kept else first, look
