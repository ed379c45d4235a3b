"""What all chunks of a sweep share: what is compiled, which sheet lit what, where to look."""

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np

from jaxscan.errors import CalibrationError, CaptureError
from jaxscan.geometry import Scanner
from jaxscan.reconstruction.points.gate import LineGate, line_gate
from jaxscan.reconstruction.settings import ReconstructSettings
from jaxscan.reconstruction.streaming.batches import chunk_records
from jaxscan.reconstruction.streaming.chunk import ChunkKind
from jaxscan.reconstruction.sweep import FrameChunk, SweepSource
from jaxscan.stripes.frames.formats import LaserLine, StripeAxis
from jaxscan.stripes.frames.learn_colour import with_colour
from jaxscan.stripes.frames.noise import estimate_noise
from jaxscan.stripes.search.search import Search, prepare_search
from jaxscan.stripes.stripes import NoiseModel, Stripes


NOISE_RECORDS = 8
"""Records at the start of the sweep from which noise and colours are taken where they are not given."""
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
    lasers: tuple[LaserLine, ...]
    """The lasers of the sweep."""
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
        sweep, line, settings = self.sweep, self.lasers[laser], self.settings
        look = LaserLine(stripe_axis=line.stripe_axis)
        if sweep.pixel_format != "mono8":
            look = dataclasses.replace(look, colour=line.colour)
        return ChunkKind(
            sweep.image_size,
            sweep.pixel_format,
            sweep.response,
            look,
            tuple(sweep.exposures),
            settings.stripes,
            settings.check_steps,
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
    return Plan(sweep, scanner, settings, stripe_axis, tuple(sweep.lines), sheet, chunk_records(sweep, settings))


def check_stripes(plan: Plan, stripes: Stripes) -> None:
    """Refuse stripes of another sweep; several profiles of each of its own are welcome."""
    profiles, lines = np.shape(stripes.u)
    expected = len(plan.sweep.record)
    if lines != plan.lines or profiles == 0 or profiles % expected:
        raise CaptureError(
            f"The stripes have {profiles} profiles of {lines} lines, the sweep has {expected} records of "
            f"{plan.lines} lines; pass the stripes of this sweep."
        )


def with_colours(plan: Plan) -> Plan:
    """The plan with every laser's colour, learned from the first records that show it where it is "auto".

    Raises:
        CaptureError: If a colour cannot be learned.
    """
    lasers = list(plan.lasers)
    for laser in np.unique(plan.sweep.laser):
        if lasers[laser].colour == "auto":
            lasers[laser] = _learned(plan.sweep, int(laser))
    return dataclasses.replace(plan, lasers=tuple(lasers))


def _learned(sweep: SweepSource, laser: int) -> LaserLine:
    line, problem = sweep.lines[laser], "it is never lit alone."
    if sweep.pixel_format == "mono8":
        return dataclasses.replace(line, colour="red")
    for on, off in _pairs_of(sweep, laser):
        try:
            return with_colour(line, on, off, sweep.pixel_format)
        except ValueError as error:
            problem = str(error)
    raise CaptureError(f'The colour of the laser "{line.name}" is "auto" and cannot be learned: {problem}')


def search_gates(plan: Plan, *, margin_px: float | None = None) -> dict[int, LineGate]:
    """Where the stripes of each laser of the sweep can lie.

    Args:
        plan: Sweep and scanner.
        margin_px: How far beyond the range limits; where not given, as far as stripes are looked for:
            `GATE_MARGIN_PX`, and nothing where lasers that are lit together are told apart by it.
    """
    settings = plan.settings
    if margin_px is None:
        margin_px = 0.0 if _several(plan.sweep) else GATE_MARGIN_PX
    gates = {}
    for laser in np.unique(plan.sweep.laser):
        (sheet,) = np.unique(plan.sheet[plan.sweep.laser == laser])
        gates[int(laser)] = line_gate(
            plan.scanner,
            int(sheet),
            stripe_axis=plan.stripe_axis,
            min_range_m=settings.min_range_m,
            max_range_m=settings.max_range_m,
            margin_px=margin_px,
        )
    return gates


def make_searches(plan: Plan, noise: NoiseModel | None) -> dict[int, Search]:
    """Where the stripes of each laser of the sweep are looked for, and in what noise.

    Args:
        plan: Of which all colours are known.
        noise: Noise of a frame; estimated from the start of the sweep where not given.

    Raises:
        CaptureError: If stripes of two lasers in one record could be mistaken for each other.
    """
    sweep, settings = plan.sweep, plan.settings
    several, gates, searches = _several(sweep), search_gates(plan), {}
    if several:
        _check_apart(list(gates.values()))
    first = _first(sweep)
    for laser, gate in gates.items():
        noise = noise or _noise(first, sweep, plan.lasers[laser])
        searches[laser] = prepare_search(
            noise,
            sweep.image_size,
            has_off=first.off is not None,
            pixel_format=sweep.pixel_format,
            response=sweep.response,
            line=plan.lasers[laser],
            settings=settings.stripes,
            gate=(gate.low, gate.high) if settings.gate or several else None,
            near_side=float(gate.near_side),
        )
    return searches


def _several(sweep: SweepSource) -> bool:
    """Whether a record has several lasers lit."""
    return len(np.unique(sweep.record)) < len(sweep.record)


def _pairs_of(sweep: SweepSource, laser: int) -> Iterator[FrameChunk]:
    """Pairs, of all exposures, of the records in which one laser alone is lit."""
    lit = np.bincount(sweep.record, minlength=len(sweep))
    own = np.zeros(len(sweep), bool)
    own[sweep.record[sweep.laser == laser]] = True
    own &= lit == 1
    start = 0
    for on, off in sweep.chunks(min(NOISE_RECORDS, len(sweep))):
        rows = np.flatnonzero(own[start : start + len(on)])
        start += len(on)
        if len(rows):
            on, off = np.asarray(on)[rows], None if off is None else np.asarray(off)[rows]
            if len(sweep.exposures) > 1:
                on, off = on.reshape(-1, *on.shape[2:]), None if off is None else off.reshape(-1, *off.shape[2:])
            yield FrameChunk(on, off)


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


def _noise(first: FrameChunk, sweep: SweepSource, line: LaserLine) -> NoiseModel:
    # Of a bracket the shortest exposure, in which least is clipped.
    on, off = first
    if len(sweep.exposures) > 1:
        on, off = on[:, 0], None if off is None else off[:, 0]
    return estimate_noise(on, off, pixel_format=sweep.pixel_format, response=sweep.response, line=line)
