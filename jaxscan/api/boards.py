"""Calibration captures to observations: corners of the board and stripes on it, in batches of frames."""

import functools
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np

from jaxscan.calibration import BoardStripe, BoardViews, Observations, select_board_stripes, stack_stripes
from jaxscan.errors import CalibrationError, CaptureError
from jaxscan.files.capture import Capture, Record
from jaxscan.geometry import AbstractBoard, Charuco
from jaxscan.geometry.turntable import Carries
from jaxscan.stripes import Stripes, extract_stripes


if TYPE_CHECKING:
    from jaxscan.vision.boards import FoundCorners


Progress = Callable[[int, int], None]

BATCH_RECORDS = 8
"""Board records looked at together: enough for all cores, little against any memory."""


def observe_boards(
    captures: Sequence[Capture], *, with_stripes: bool = True, progress: Progress | None = None
) -> Observations:
    """Find the board's corners, and the stripes on it, in calibration captures.

    Corners are looked for in the laser-off image where there is one. Views with the same
    placement share a board pose; a view of unknown table angle is a placement of its own.

    Args:
        captures: Calibration captures of the same board, camera and rig.
        with_stripes: Look for stripes too; they are not needed for a camera alone.
        progress: Called with (records done, records in all).

    Returns:
        What `calibrate` solves from.

    Raises:
        CaptureError: If a capture is not a calibration capture, or they do not belong together.
        CalibrationError: If the board is found in no image.
    """
    board = _common_board(captures)
    total = sum(len(capture) for capture in captures)
    views: list[_View] = []
    done = 0
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for number, capture in enumerate(captures):
            for start in range(0, len(capture), BATCH_RECORDS):
                indices = range(start, min(start + BATCH_RECORDS, len(capture)))
                looked = list(pool.map(functools.partial(_look_for_board, number, capture, board), indices))
                seen = _with_stripes(looked, capture, board) if with_stripes else looked
                # Frames go as soon as they are read: a capture may be larger than the memory.
                views += [view._replace(on=None, off=None) for view in seen]
                done += len(indices)
                if progress is not None:
                    progress(done, total)
    found = [view for view in views if view.corners is not None]
    if not found:
        raise CalibrationError(
            f"The board ({_describe(board)}) was found in none of {total} records: check the [board] table of "
            "capture.toml (columns and rows count inner corners for a chessboard, squares for ChArUco), and that the "
            "board is sharp, well lit and wholly in the image."
        )
    return _observations(found, captures[0], board)


class _View(NamedTuple):
    """One record on its way to an observation."""

    capture: int
    record: Record
    on: np.ndarray | None
    off: np.ndarray | None
    corners: "FoundCorners | None"
    stripe: BoardStripe | None = None


def _common_board(captures: Sequence[Capture]) -> AbstractBoard:
    """The board of all captures, which must show one board to one rig."""
    first = captures[0]
    for capture in captures:
        if capture.board is None:
            raise CaptureError(f"{capture.path}: is a sweep; a calibration needs captures of a board.")
        for what in ("camera", "laser", "turntable", "board"):
            if getattr(capture.header, what) != getattr(first.header, what):
                raise CaptureError(
                    f"{capture.path}: its [{what}] differs from that of {first.path}; "
                    "captures calibrated together must show the same board to the same rig."
                )
    return cast(AbstractBoard, first.board)


def _look_for_board(number: int, capture: Capture, board: AbstractBoard, index: int) -> _View:
    # Here, so that `import jaxscan` does not load OpenCV.
    from jaxscan.vision.boards import find_corners
    from jaxscan.vision.grey import to_grey

    on, off = capture.frames(index)
    image = on if off is None else off
    corners = None if image is None else find_corners(to_grey(image, capture.pixel_format), board)
    return _View(number, capture.records[index], on, off, corners)


def _with_stripes(views: list[_View], capture: Capture, board: AbstractBoard) -> list[_View]:
    """The views of one batch with the stripes that lie on their boards."""
    lit = [i for i, view in enumerate(views) if view.corners is not None and view.on is not None]
    for laser, line in enumerate(capture.lines):
        for with_off in (True, False):
            group = [i for i in lit if views[i].record.laser == laser and (views[i].off is not None) == with_off]
            if not group:
                continue
            # Padded to the batch's size, so that the extraction compiles once.
            padded = [group[min(k, len(group) - 1)] for k in range(BATCH_RECORDS)]
            on = np.stack([cast(np.ndarray, views[i].on) for i in padded])
            off = np.stack([cast(np.ndarray, views[i].off) for i in padded]) if with_off else None
            stripes = extract_stripes(on, off, pixel_format=capture.pixel_format, response=capture.response, line=line)
            for row, i in enumerate(group):
                views[i] = views[i]._replace(stripe=_board_stripe(stripes, row, views[i], capture, board))
    return views


def _board_stripe(stripes: Stripes, row: int, view: _View, capture: Capture, board: AbstractBoard) -> BoardStripe:
    from jaxscan.vision.grey import to_grey

    corners, line = cast("FoundCorners", view.corners), capture.lines[cast(int, view.record.laser)]
    u, sigma, valid, width = (
        np.asarray(field)[row] for field in (stripes.u, stripes.sigma, stripes.valid, stripes.width)
    )
    return select_board_stripes(
        u,
        sigma,
        valid,
        corners=corners.q,
        corners_valid=corners.valid,
        board=board,
        off=None if view.off is None else to_grey(view.off, capture.pixel_format),
        width=np.where(valid, width, 1.0),
        stripe_axis=line.stripe_axis,
    )


def _observations(views: list[_View], first: Capture, board: AbstractBoard) -> Observations:
    """The padded grids that the solve reads."""
    corners = [cast("FoundCorners", view.corners) for view in views]
    # A view that shares its placement with no other, or whose angle is unknown, stands alone.
    keys = [
        (view.capture, "alone", view.record.i)
        if view.record.placement is None or view.record.angle is None
        else (view.capture, "placement", view.record.placement)
        for view in views
    ]
    number = {key: index for index, key in enumerate(dict.fromkeys(keys))}
    stripes = [
        (view.stripe, index, cast(int, view.record.laser))
        for index, view in enumerate(views)
        if view.stripe is not None
    ]
    width, height = first.image_size
    return Observations(
        board=board,
        corners=BoardViews(
            q=np.stack([found.q for found in corners]),
            sigma=np.stack([found.sigma for found in corners]),
            valid=np.stack([found.valid for found in corners]),
            angle=np.array([view.record.angle or 0.0 for view in views]),
            placement=np.array([number[key] for key in keys], np.int32),
            record=np.array([view.record.i for view in views], np.int32),
        ),
        stripes=stack_stripes(stripes),
        width=width,
        height=height,
        laser_names=tuple(line.name for line in first.lines),
        up=first.header.camera.up,
        carries=cast(Carries, first.carries or "scanner"),
    )


def _describe(board: AbstractBoard) -> str:
    columns, rows = board.grid()
    kind = "ChArUco" if isinstance(board, Charuco) else "chessboard"
    return f"{kind}, {columns} x {rows} inner corners, {1e3 * board.square:g} mm"
