"""The plan of a reconstruction: a sweep and a scanner that fit together. It is made once and reads no frame."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from jaxscan.errors import CalibrationError, CaptureError
from jaxscan.geometry import MOTIONS, Scanner, StripeAxis, across_and_along, scanner_doubts
from jaxscan.reconstruction.ahead import workers
from jaxscan.reconstruction.gate import line_gate
from jaxscan.reconstruction.settings import ReconstructSettings
from jaxscan.reconstruction.sweep import SweepSource
from jaxscan.stripes import FrameFormat, LineGate


GATE_MARGIN_PX = 40.0
"""How far beyond the range limits a line is searched [px]: a stripe at a limit is seen whole, and
a slightly different calibration finds its stripes among those of this one."""
_RECORDS = 32
"""Records of a chunk: the path over the lines is one long loop for all of them."""
_BYTES = 100e6
"""Frames of a chunk at most."""


@dataclass(frozen=True, eq=False)
class Plan:
    """A sweep and a scanner that fit together."""

    sweep: SweepSource
    scanner: Scanner
    settings: ReconstructSettings
    stripe_axis: StripeAxis
    sheet: np.ndarray
    """The scanner's laser of each profile of the sweep."""
    size: int
    """Records computed at a time."""

    @property
    def lines(self) -> int:
        """Lines of a profile."""
        return across_and_along(*self.sweep.image_size, self.stripe_axis)[1]

    @property
    def frames(self) -> FrameFormat:
        """How a frame is to be read."""
        return FrameFormat(self.sweep.pixel_format, self.sweep.response)

    @property
    def lit_together(self) -> bool:
        """Whether a record has several lasers lit."""
        return len(np.unique(self.sweep.record)) < len(self.sweep.record)

    @cached_property
    def gates(self) -> dict[int, LineGate]:
        """Where the stripes of each laser are looked for: `GATE_MARGIN_PX` beyond the range limits.

        Lasers that are lit together are told apart by their gates, which then have no margin.
        """
        return self.gates_beyond(0.0 if self.lit_together else GATE_MARGIN_PX)

    def gates_beyond(self, margin_px: float) -> dict[int, LineGate]:
        """Where the stripes of each laser can lie, and so much further [px]."""
        lasers, first = np.unique(self.sweep.laser, return_index=True)
        return {
            int(laser): line_gate(
                self.scanner,
                int(self.sheet[profile]),
                stripe_axis=self.stripe_axis,
                min_range_m=self.settings.min_range_m,
                max_range_m=self.settings.max_range_m,
                margin_px=margin_px,
            )
            for laser, profile in zip(lasers, first, strict=True)
        }


def plan_sweep(sweep: SweepSource, scanner: Scanner, settings: ReconstructSettings) -> Plan:
    """Refuse a sweep and a scanner that do not fit together; else plan the sweep.

    Raises:
        TypeError: If it is no sweep.
        CaptureError: If the sweep has no records, or contradicts itself.
        CalibrationError: If the scanner is not that of the sweep.
    """
    if not isinstance(sweep, SweepSource):
        raise TypeError(
            f"Expected a sweep, got {type(sweep).__name__}; open a capture, or make one of arrays: "
            "Sweep(on, off, angles)."
        )
    if len(sweep) == 0:
        raise CaptureError("The sweep has no records; a reconstruction needs at least one. Capture it again.")
    width, height = sweep.image_size
    camera = scanner.camera
    if (camera.width, camera.height) != (width, height):
        raise CalibrationError(
            f"The scanner is calibrated for images of {camera.width} x {camera.height} px, the sweep has "
            f"{width} x {height} px; use the calibration of this camera mode."
        )
    _check_motion(sweep, scanner)
    if not scanner.laser_names:
        raise CalibrationError(
            "The calibration holds no laser sheet, so nothing can be reconstructed; calibrate with a capture that has "
            "laser images."
        )
    for doubt in scanner_doubts(scanner):
        if doubt.impossible:
            raise CalibrationError(f"The calibration cannot be that of a rig: {doubt.said}.")
    known, names = scanner.laser_names, [line.name for line in sweep.lasers]
    used = int(sweep.laser.max()) + 1
    if max(used, len(names)) > len(known):
        raise CalibrationError(
            f"The sweep has {max(used, len(names))} lasers, the calibration knows {len(known)} "
            f"({', '.join(known)}); calibrate with all lasers of the sweep."
        )
    if used > len(names):
        raise CaptureError(f"A record names laser {used - 1}, the sweep lists {len(names)}; list every laser.")
    axes = {line.stripe_axis for line in sweep.lasers}
    if len(axes) > 1:
        raise CaptureError(
            "The sweep has lasers along the rows and along the columns; one grid holds one kind. "
            "Capture them as two sweeps."
        )
    (stripe_axis,) = axes
    by_name = all(name in known for name in names) and len(set(names)) == len(names)
    of_scanner = [known.index(name) if by_name else i for i, name in enumerate(names)]
    sheet = np.asarray(of_scanner, np.int32)[sweep.laser]
    return Plan(sweep, scanner.along(sweep.poses), settings, stripe_axis, sheet, chunk_records(sweep, settings))


def chunk_records(sweep: SweepSource, settings: ReconstructSettings) -> int:
    """Records that are computed at a time."""
    if settings.chunk_records is not None:
        return min(settings.chunk_records, len(sweep))
    width, height = sweep.image_size
    pair = 2 * width * height * (3 if sweep.pixel_format == "rgb8" else 1) * len(sweep.exposures)
    # A short sweep still has something to do for every core.
    share = -(-len(sweep) // max(workers(), 1))
    # Powers of two, so that short sweeps of all lengths share a few compiled functions.
    return 1 << max(0, math.ceil(math.log2(min(_RECORDS, max(1, _BYTES / pair), share))))


def _check_motion(sweep: SweepSource, scanner: Scanner) -> None:
    """Refuse a sweep that moves otherwise than the scanner."""
    known = scanner.turntable.carries
    if known == "nothing" and sweep.carries != "nothing" and (sweep.carries or np.ptp(sweep.angles) > 0):
        raise CalibrationError(
            "The sweep moves, and the calibration holds camera and sheet without a motion; calibrate with placements "
            'of the board, or say carries = "nothing" for profiles in the frame of the camera.'
        )
    if MOTIONS[known].unit == "m" and sweep.carries is None:
        raise CalibrationError(
            "The calibration is that of a linear stage, and the sweep does not say what moves, so its positions count "
            'as angles; say carries = "linear", with `position_m` in every record.'
        )
    if known != "nothing" and sweep.carries is not None and sweep.carries != known:
        if {known, sweep.carries} == {"scanner", "object"}:
            raise CalibrationError(
                f"The table of the sweep carries the {sweep.carries}, that of the calibration the {known}; use a "
                "calibration made in the same arrangement."
            )
        raise CalibrationError(
            f'The sweep says carries = "{sweep.carries}", the calibration "{known}"; use a calibration made in the '
            "same arrangement."
        )
