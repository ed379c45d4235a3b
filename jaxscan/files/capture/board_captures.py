"""Check that captures of a board can be calibrated together."""

from collections.abc import Sequence
from typing import cast

from jaxscan.errors import CaptureError
from jaxscan.files.capture.capture import Capture
from jaxscan.geometry import AbstractBoard


def common_board(captures: Sequence[Capture], *, single_lasers: bool) -> AbstractBoard:
    """The common board of captures that are calibrated together; all must come from one rig.

    Args:
        captures: The captures.
        single_lasers: No record may show several lasers at once, since their stripes cannot be told apart.

    Raises:
        CaptureError: With the capture that differs from the first, or the record with several lasers.
    """
    first = captures[0]
    for capture in captures:
        if capture.board is None:
            raise CaptureError(f"{capture.path}: is a sweep; a calibration needs captures of a board.")
        for table in ("camera", "laser", "turntable", "board"):
            if getattr(capture.header, table) != getattr(first.header, table):
                raise CaptureError(
                    f"{capture.path}: its [{table}] is not the same as in {first.path}; "
                    "captures calibrated together must show the same board to the same rig."
                )
    for capture in captures if single_lasers else ():
        for record in capture.records:
            if len(record.lasers) > 1:
                names = ", ".join(capture.lasers[laser].name for laser in record.lasers)
                raise CaptureError(
                    f"{capture.path}: record {record.i}: several lasers are lit at once ({names}), but a calibration "
                    'needs one per record; capture a record for each, and name it there: "lasers": ["..."].'
                )
    return cast(AbstractBoard, first.board)
