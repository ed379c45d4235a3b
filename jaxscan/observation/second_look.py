"""The second look at captures: corners and stripes at the places that a first solve predicts."""

from collections.abc import Sequence

import numpy as np

from jaxscan.geometry import BoardPicture
from jaxscan.observation.first_look import Eyes, Look, Progress, go_through
from jaxscan.observation.prediction import (
    PredictedCorners,
    SolvedRig,
    predict_corners,
    turn_boards,
)
from jaxscan.observation.records import BoardSource, SeenRecord


# A corner is accepted within this many standard deviations of the first solve's residuals,
_REACH_SIGMA = 5.0
# plus this margin [px]: for views that the first solve used, and for views that it did not.
_REACH_PX = 0.3
_REACH_UNSEEN_PX = 1.5


def look_again(
    captures: Sequence[BoardSource],
    first: Look,
    rig: SolvedRig,
    eyes: Eyes,
    *,
    progress: Progress | None = None,
) -> Look:
    """Look at every record again, with the geometry of a first solve.

    All predicted corners are fitted, also those that the first look missed, and also on boards
    that it missed but saw at another angle of the same placement. If the first look extracted
    stripes, they are extracted again from a band around the predicted stripe, and fitted through the print.

    Args:
        rig: The rig solved from it.
        eyes: The functions that read images; with the print that they draw stripes are fitted through it.
    """
    if eyes.draw_print is not None and first.lines is not None:
        rig = rig._replace(picture=BoardPicture.of(first.board, eyes.draw_print(first.board)))
    poses = _poses(first.records, rig)
    predicted = predict_corners(rig, np.array([np.eye(4) if pose is None else pose for pose in poses]))
    starts = np.cumsum([0, *(len(capture.records) for capture in captures)])

    def look(number: int, index: int) -> SeenRecord:
        at = starts[number] + index
        before, pose = first.records[at], poses[at]
        view = before if before.grey is not None else SeenRecord.read(captures, number, index, eyes.to_grey)
        view = view._replace(corners=before.corners, stripes=(), pose=pose, light=before.light)
        if pose is None or view.grey is None:
            return view
        reach = _REACH_SIGMA * rig.corner_rms_px + (_REACH_UNSEEN_PX if before.corners is None else _REACH_PX)
        expected = PredictedCorners(*(part[at] for part in predicted))
        found = eyes.refit_corners(view.grey, first.board, expected, reach, before.corners)
        return view._replace(corners=found)

    return go_through(captures, look, first, rig=rig, progress=progress)


def _poses(views: Sequence[SeenRecord], rig: SolvedRig) -> list[np.ndarray | None]:
    """T_cam_board of every record; None where the first solve does not give it."""
    poses: list[np.ndarray | None] = [None] * len(views)
    seen: dict[tuple[int, int], tuple[np.ndarray, np.ndarray]] = {}
    found = [number for number, view in enumerate(views) if view.corners is not None]
    for number, pose, used in zip(found, rig.poses, rig.used, strict=True):
        if used:
            poses[number] = pose
            placement = views[number].placement
            if placement is not None:
                seen[placement] = pose[None], np.array([views[number].record.angle])
    for number, view in enumerate(views):
        there = None if view.placement is None else seen.get(view.placement)
        if rig.scanner is not None and rig.scanner.turntable.blocks and poses[number] is None and there is not None:
            poses[number] = turn_boards(rig.scanner.turntable, *there, np.array([view.record.angle]))[0]
    return poses
