"""What all chunks of a sweep share: what is compiled, which sheet lit what, where to look."""

from dataclasses import dataclass
from itertools import islice

import numpy as np

from jaxscan.errors import CalibrationError, CaptureError
from jaxscan.geometry import Scanner
from jaxscan.reconstruction.batches import chunk_records
from jaxscan.reconstruction.chunk import ChunkKind
from jaxscan.reconstruction.gate import line_gate
from jaxscan.reconstruction.settings import ReconstructSettings
from jaxscan.reconstruction.sweep import FrameChunk, SweepSource
from jaxscan.stripes.extract import Search, prepare_search
from jaxscan.stripes.frames import LaserLine, StripeAxis
from jaxscan.stripes.noise import estimate_noise
from jaxscan.stripes.stripes import NoiseModel, Stripes


NOISE_RECORDS = 8
"""Records at the start of the sweep from which the noise is estimated where it is not given."""
GATE_MARGIN_PX = 40.0
"""How far beyond the range limits a line is searched [px]: a stripe at a limit is seen whole, and
a slightly different calibration finds its stripes among those of this one."""


@dataclass(frozen=True)
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
        width, height = self.sweep.image_size
        return height if self.stripe_axis == "rows" else width

    def kind(self, laser: int) -> ChunkKind:
        """What is compiled for the frames of a laser; the same for lasers that look the same."""
        sweep, line = self.sweep, self.sweep.lines[laser]
        look = LaserLine(colour=line.colour, stripe_axis=line.stripe_axis)
        return ChunkKind(
            sweep.image_size, sweep.pixel_format, sweep.response, look, tuple(sweep.exposures), self.settings
        )


def make_plan(sweep: SweepSource, scanner: Scanner, settings: ReconstructSettings) -> Plan:
    """Refuse what does not fit together; else plan the sweep.

    Raises:
        CaptureError: If the sweep has no records, or contradicts itself.
        CalibrationError: If the scanner is not that of the sweep.
    """
    if len(sweep) == 0:
        raise CaptureError("The sweep has no records; a reconstruction needs at least one. Capture it again.")
    width, height = sweep.image_size
    camera = scanner.camera
    if (camera.width, camera.height) != (width, height):
        raise CalibrationError(
            f"The scanner is calibrated for images of {camera.width} x {camera.height} px, the sweep has "
            f"{width} x {height} px; use the calibration of this camera mode."
        )
    if sweep.carries is not None and sweep.carries != scanner.turntable.carries:
        raise CalibrationError(
            f"The table of the sweep carries the {sweep.carries}, that of the calibration the "
            f"{scanner.turntable.carries}; use a calibration made in the same arrangement."
        )
    known, names = scanner.laser_names, [line.name for line in sweep.lines]
    used = int(sweep.laser.max()) + 1
    if max(used, len(names)) > len(known):
        raise CalibrationError(
            f"The sweep has {max(used, len(names))} lasers, the calibration knows {len(known)} "
            f"({', '.join(known)}); calibrate with all lasers of the sweep."
        )
    if used > len(names):
        raise CaptureError(f"A record names laser {used - 1}, the sweep lists {len(names)}; list every laser.")
    axes = {line.stripe_axis for line in sweep.lines}
    if len(axes) > 1:
        raise CaptureError(
            "The sweep has lasers along the rows and along the columns; one grid holds one kind. "
            "Capture them as two sweeps."
        )
    (stripe_axis,) = axes
    by_name = all(name in known for name in names) and len(set(names)) == len(names)
    of_scanner = [known.index(name) if by_name else i for i, name in enumerate(names)]
    sheet = np.asarray(of_scanner, np.int32)[sweep.laser]
    return Plan(sweep, scanner, settings, stripe_axis, sheet, chunk_records(sweep, settings))


def check_stripes(plan: Plan, stripes: Stripes) -> None:
    """Refuse stripes of another sweep; several profiles of each of its own are welcome."""
    profiles, lines = np.shape(stripes.u)
    expected = len(plan.sweep.record)
    if lines != plan.lines or profiles == 0 or profiles % expected:
        raise CaptureError(
            f"The stripes have {profiles} profiles of {lines} lines, the sweep has {expected} records of "
            f"{plan.lines} lines; pass the stripes of this sweep."
        )


def make_searches(plan: Plan, noise: NoiseModel | None) -> dict[int, Search]:
    """Where the stripes of each laser of the sweep are looked for, and in what noise.

    Raises:
        CaptureError: If stripes of two lasers in one record could be mistaken for each other.
    """
    sweep, settings = plan.sweep, plan.settings
    first = _first(sweep)
    several = len(np.unique(sweep.record)) < len(sweep.record)
    gates, searches = {}, {}
    for laser in np.unique(sweep.laser):
        (sheet,) = np.unique(plan.sheet[sweep.laser == laser])
        gates[laser] = line_gate(
            plan.scanner,
            int(sheet),
            stripe_axis=plan.stripe_axis,
            min_range_m=settings.min_range_m,
            max_range_m=settings.max_range_m,
            margin_px=0.0 if several else GATE_MARGIN_PX,
        )
        noise = noise or _noise(first, sweep, int(laser))
        searches[int(laser)] = prepare_search(
            noise,
            sweep.image_size,
            has_off=first.off is not None,
            pixel_format=sweep.pixel_format,
            response=sweep.response,
            line=sweep.lines[laser],
            settings=settings.stripes,
            gate=(gates[laser].low, gates[laser].high) if settings.gate or several else None,
            near_side=float(gates[laser].near_side),
        )
    if several:
        _check_apart(list(gates.values()))
    return searches


def _check_apart(gates: list) -> None:
    """Lasers that are lit together are told apart by where they can be seen, and only so."""
    for i, one in enumerate(gates):
        for other in gates[i + 1 :]:
            shared = np.minimum(one.high, other.high) - np.maximum(one.low, other.low)
            if np.any(shared > 0):
                raise CaptureError(
                    f"Two lasers that are lit in one record can be seen at the same places (up to {shared.max()} px of "
                    f"a line); narrow min_range_m and max_range_m, or capture a record for each laser."
                )


def _first(sweep: SweepSource) -> FrameChunk:
    # A fixed number of records, so that the result does not depend on the size of the chunks.
    (first,) = islice(sweep.chunks(min(NOISE_RECORDS, len(sweep))), 1)
    return first


def _noise(first: FrameChunk, sweep: SweepSource, laser: int) -> NoiseModel:
    # Of a bracket the shortest exposure, in which least is clipped.
    on, off = first
    if len(sweep.exposures) > 1:
        on, off = on[:, 0], None if off is None else off[:, 0]
    return estimate_noise(on, off, pixel_format=sweep.pixel_format, response=sweep.response, line=sweep.lines[laser])
