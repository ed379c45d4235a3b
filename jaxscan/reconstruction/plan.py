"""The plan of a reconstruction, which all its chunks share: made once, it learns and computes each thing once."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from jaxscan.errors import CalibrationError, CaptureError
from jaxscan.geometry import Array, Scanner, StripeAxis, across_and_along
from jaxscan.reconstruction.colours import NOISE_RECORDS, with_learned_colour
from jaxscan.reconstruction.points import Aim, line_gate
from jaxscan.reconstruction.settings import ReconstructSettings
from jaxscan.reconstruction.streaming import chunk_records
from jaxscan.reconstruction.sweep import FrameChunk, SweepSource
from jaxscan.reconstruction.without_off import PredictedPairs, with_off
from jaxscan.stripes import (
    BlackLevelError,
    ExtractionSetup,
    FrameFormat,
    LaserLine,
    LearnedNoise,
    LineGate,
    NoiseModel,
    StripeEngine,
    Stripes,
    learn_noise,
    prepare_engines,
    speckle_words,
    whole_lines,
)


GATE_MARGIN_PX = 40.0
"""How far beyond the range limits a line is searched [px]: a stripe at a limit is seen whole, and
a slightly different calibration finds its stripes among those of this one."""


@dataclass
class Plan:
    """A sweep and a scanner that fit together, and all that is learned of the frames."""

    sweep: SweepSource
    scanner: Scanner
    settings: ReconstructSettings
    stripe_axis: StripeAxis
    sheet: np.ndarray
    """The scanner's laser of each profile of the sweep."""
    size: int
    """Records computed at a time."""
    notes: list[str] = field(default_factory=list)
    """Notes on the stripes, once they are found; a sentence each."""
    learned: LearnedNoise | None = None
    """Noise of a frame, once it is learned."""
    noise: str = ""
    """A line on it, with the speckle that the stripes told."""

    @property
    def lines(self) -> int:
        """Lines of a profile."""
        return across_and_along(*self.sweep.image_size, self.stripe_axis)[1]

    @property
    def frames(self) -> FrameFormat:
        """How a frame is to be read."""
        return FrameFormat(self.sweep.pixel_format, self.sweep.response)

    @property
    def predicts(self) -> bool:
        """Whether the sweep has no laser-off frames, so that they are predicted."""
        return isinstance(self.sweep, PredictedPairs) and self.sweep.predicts

    @property
    def lit_together(self) -> bool:
        """Whether a record has several lasers lit."""
        return len(np.unique(self.sweep.record)) < len(self.sweep.record)

    @cached_property
    def lasers(self) -> tuple[LaserLine, ...]:
        """The lasers, an "auto" colour learned from the first records that show the laser alone.

        Raises:
            CaptureError: If a colour cannot be learned.
        """
        lasers = list(self.sweep.lasers)
        for laser in np.unique(self.sweep.laser):
            if lasers[laser].colour == "auto":
                lasers[laser] = with_learned_colour(self.sweep, int(laser))
        return tuple(lasers)

    @cached_property
    def gates(self) -> dict[int, LineGate]:
        """Where the stripes of each laser are looked for: `GATE_MARGIN_PX` beyond the range limits.

        Lasers that are lit together are told apart by their gates, which then have no margin.
        """
        return self.gates_beyond(0.0 if self.lit_together else GATE_MARGIN_PX)

    def gates_beyond(self, margin_px: float) -> dict[int, LineGate]:
        """Where the stripes of each laser can lie, and so much further [px]."""
        gates = {}
        for laser in np.unique(self.sweep.laser):
            (sheet,) = np.unique(self.sheet[self.sweep.laser == laser])
            gates[int(laser)] = line_gate(
                self.scanner,
                int(sheet),
                stripe_axis=self.stripe_axis,
                min_range_m=self.settings.min_range_m,
                max_range_m=self.settings.max_range_m,
                margin_px=margin_px,
            )
        return gates

    @cached_property
    def _aim(self) -> Aim:
        return Aim.of(self.scanner, self.settings, self.stripe_axis)

    def aim(self, profile: int) -> Aim:
        """Where the points of a profile, and of others of the same laser, go."""
        return self._aim._replace(laser=np.asarray(self.sheet[profile], np.int32))

    @property
    def learned_from(self) -> int:
        """Records from which the engines learn."""
        return min(NOISE_RECORDS, len(self.sweep))

    def engines(self, noise: NoiseModel | None = None, first: FrameChunk | None = None) -> dict[int, StripeEngine]:
        """The engine of each laser of the sweep.

        Args:
            noise: Noise of a frame; learned from the start of the sweep where not given.
            first: The first `learned_from` records, where they are read already.

        Raises:
            CaptureError: If a colour cannot be learned, the black level is above the picture, or stripes of two
                lasers in one record could be mistaken for each other.
        """
        sweep, settings = self.sweep, self.settings
        with ThreadPoolExecutor(1) as pool:
            gates_to_come = pool.submit(lambda: self.gates)
            # A fixed number of records, so that the result does not depend on the size of the chunks.
            on, off = next(iter(sweep.chunks(self.learned_from))) if first is None else first
            if noise is None:
                noise = self._learn_noise(on, off)
            gates_to_come.result()
        gated = settings.gate or self.lit_together
        if self.lit_together:
            _check_apart(list(self.gates.values()))
        setups, gates = [], []
        for laser, gate in self.gates.items():
            setup = ExtractionSetup(
                sweep.image_size,
                self.frames,
                self.lasers[laser],
                settings.stripes,
                tuple(sweep.exposures),
                all_candidates=settings.check_steps,
            )
            setups.append(setup)
            gates.append(gate if gated else whole_lines(setup, gate.near_side))
        try:
            engines = prepare_engines(on, off, setups, noise=noise, gates=gates)
        except BlackLevelError as problem:
            raise CaptureError(str(problem)) from problem
        if self.predicts:
            engines = [engine.own_channel() for engine in engines]
        return dict(zip(self.gates, engines, strict=True))

    def _learn_noise(self, on: Array, off: Array | None) -> NoiseModel:
        """The noise of the first frames, in the colour of the first laser and the shortest exposure."""
        if len(self.sweep.exposures) > 1:
            on, off = on[:, 0], None if off is None else off[:, 0]
        compressed = self.sweep.compression is not None
        first = self.lasers[int(self.sweep.laser.min())]
        self.learned = learn_noise(on, off, frames=self.frames, line=first, compressed=compressed)
        self.notes.extend(self.learned.doubts)
        return self.learned.noise

    def tell_noise(self, laser: int, engine: StripeEngine) -> None:
        """Add the speckle of a laser to the line on the noise."""
        if self.learned is None:
            return
        found, reason = engine.noise, engine.speckle_reason
        words = speckle_words(found.speckle, reason) if self.noise else self.learned.words(found, reason)
        name = f'laser "{self.lasers[laser].name}": ' if len(self.gates) > 1 else ""
        self.noise = "; ".join(part for part in (self.noise, name + words) if part)


def make_plan(sweep: SweepSource, scanner: Scanner, settings: ReconstructSettings) -> Plan:
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
    paired = with_off(sweep, scanner, settings)
    return Plan(paired, scanner, settings, stripe_axis, sheet, chunk_records(sweep, settings))


def _check_motion(sweep: SweepSource, scanner: Scanner) -> None:
    """Refuse a sweep that moves otherwise than the scanner."""
    known = scanner.turntable.carries
    if known == "nothing" and sweep.carries != "nothing" and (sweep.carries or np.ptp(sweep.angles) > 0):
        raise CalibrationError(
            "The sweep moves, and the calibration holds camera and sheet without a motion; calibrate with placements "
            'of the board, or say carries = "nothing" for profiles in the frame of the camera.'
        )
    if known == "linear" and sweep.carries is None:
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


def check_stripes(plan: Plan, stripes: Stripes) -> None:
    """Refuse stripes of another sweep; several profiles of each of its own are welcome."""
    profiles, lines = np.shape(stripes.u)
    expected = len(plan.sweep.record)
    if lines != plan.lines or profiles == 0 or profiles % expected:
        raise CaptureError(
            f"The stripes have {profiles} profiles of {lines} lines, the sweep has {expected} records of "
            f"{plan.lines} lines; pass the stripes of this sweep."
        )


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
