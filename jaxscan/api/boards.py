"""Calibration captures to observations: corners of the board and stripes on it, in batches of frames."""

import functools
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, cast

import numpy as np

from jaxscan.api.board_stripes import BATCH_RECORDS, View, check_single_lasers, with_stripes
from jaxscan.calibration import BoardViews, Observations, stack_stripes
from jaxscan.errors import CalibrationError, CaptureError
from jaxscan.files.capture import Capture
from jaxscan.geometry import AbstractBoard, Charuco
from jaxscan.geometry.turntable import Carries


if TYPE_CHECKING:
    from jaxscan.vision.boards import FoundCorners


Progress = Callable[[int, int], None]


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
    return to_observations(find_boards(captures, with_stripes=with_stripes, progress=progress), captures)


def find_boards(captures: Sequence[Capture], *, with_stripes: bool, progress: Progress | None = None) -> list[View]:
    """Every record with what was found in it; see `observe_boards`."""
    board = common_board(captures)
    if with_stripes:
        for capture in captures:
            check_single_lasers(capture)
    views = look_at_boards(captures, functools.partial(_find, captures, board), _stripes(with_stripes), progress)
    if all(view.corners is None for view in views):
        raise CalibrationError(
            f"The board ({_describe(board)}) was found in none of {len(views)} records: check the [board] table of "
            "capture.toml (columns and rows count inner corners for a chessboard, squares for ChArUco), and that the "
            "board is sharp, well lit and wholly in the image."
        )
    return views


def look_at_boards(
    captures: Sequence[Capture],
    look: Callable[[int, int], View],
    stripes: Callable[[list[View], Capture], list[View]],
    progress: Progress | None = None,
) -> list[View]:
    """Go through all records: `look` at each (capture, index) in threads, then `stripes` of a batch together."""
    total = sum(len(capture) for capture in captures)
    views: list[View] = []
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for number, capture in enumerate(captures):
            for start in range(0, len(capture), BATCH_RECORDS):
                indices = range(start, min(start + BATCH_RECORDS, len(capture)))
                seen = stripes(list(pool.map(functools.partial(look, number), indices)), capture)
                # Frames go as soon as they are read: a capture may be larger than the memory.
                views += [view._replace(on=None, off=None) for view in seen]
                if progress is not None:
                    progress(len(views), total)
    return views


def _stripes(wanted: bool) -> Callable[[list[View], Capture], list[View]]:
    return with_stripes if wanted else lambda views, capture: views


def common_board(captures: Sequence[Capture]) -> AbstractBoard:
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


def _find(captures: Sequence[Capture], board: AbstractBoard, number: int, index: int) -> View:
    # Here, so that `import jaxscan` does not load OpenCV.
    from jaxscan.vision.boards import find_corners

    view = View.of(captures[number], number, index)
    image = view.picture()
    return view if image is None else view._replace(corners=find_corners(image, board))


def to_observations(views: Sequence[View], captures: Sequence[Capture]) -> Observations:
    """The padded grids that the solve reads, of the views with a board."""
    first, board = captures[0], common_board(captures)
    views = [view for view in views if view.corners is not None]
    corners = [cast("FoundCorners", view.corners) for view in views]
    # A view that shares its placement with no other, or whose angle is unknown, stands alone.
    keys = [
        (view.capture, "alone", view.record.i)
        if view.record.placement is None or view.record.angle is None
        else (view.capture, "placement", view.record.placement)
        for view in views
    ]
    number = {key: index for index, key in enumerate(dict.fromkeys(keys))}
    stripes = [(view.stripe, index, view.laser) for index, view in enumerate(views) if view.stripe is not None]
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
