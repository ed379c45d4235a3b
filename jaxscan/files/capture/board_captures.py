"""Check that captures of a board can be calibrated together."""

import itertools
from collections.abc import Sequence
from typing import cast

import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.files.capture.capture import Capture
from jaxscan.geometry import AbstractBoard


def common_board(captures: Sequence[Capture], *, single_lasers: bool) -> AbstractBoard:
    """The common board of captures that are calibrated together; all must come from one rig.

    Args:
        captures: The captures.
        single_lasers: No record may show several lasers at once, since their stripes cannot be told apart.

    Raises:
        CaptureError: With the capture that differs from the first, that is given twice, or the record with several
            lasers.
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
    refuse_copies(captures)
    for capture in captures if single_lasers else ():
        for record in capture.records:
            if len(record.lasers) > 1:
                names = ", ".join(capture.lasers[laser].name for laser in record.lasers)
                raise CaptureError(
                    f"{capture.path}: record {record.i}: several lasers are lit at once ({names}), but a calibration "
                    'needs one per record; capture a record for each, and name it there: "lasers": ["..."].'
                )
    return cast(AbstractBoard, first.board)


def refuse_copies(captures: Sequence[Capture]) -> None:
    """Refuse a capture that is given twice, by another name or as a copy.

    Raises:
        CaptureError: With both names.
    """
    for one, other in itertools.combinations(captures, 2):
        if _are_copies(one, other):
            raise CaptureError(
                f"{other.path}: is the same capture as {one.path}; its images would count twice, and every uncertainty "
                "would come out too small. Give each capture once."
            )


def _are_copies(one: Capture, other: Capture) -> bool:
    """Whether two captures hold the same images, under two names or as copies.

    Equal texts do not suffice: of two captures written by hand, only the images may differ.
    """
    if one.path.samefile(other.path):
        return True
    if one.digest() != other.digest():
        return False
    record = one.records[0]
    return all(np.array_equal(one.image(image), other.image(image)) for image in (*record.on, *record.off))
