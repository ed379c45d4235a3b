"""Stripes of a sweep while it is being taken, as `extract_sweep` finds them in the finished one.

The engine learns from the first records; after that a frame's stripes depend on nothing but the
frame. So they are the same whenever they are found, and in whatever chunk.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from jaxscan.geometry import Scanner
from jaxscan.reconstruction.colours import NOISE_RECORDS
from jaxscan.reconstruction.plan import make_plan
from jaxscan.reconstruction.points import Centres, points_alone, stripe_colours
from jaxscan.reconstruction.settings import DEFAULTS, ReconstructSettings
from jaxscan.reconstruction.streaming import GrowingStripes, chunk_records
from jaxscan.reconstruction.sweep import FrameChunk, SweepSource
from jaxscan.stripes import (
    LEARNED_FRAMES,
    LaserLine,
    PixelFormat,
    Response,
    StripeEngine,
    Stripes,
)


Show = Callable[[np.ndarray, np.ndarray], None]
"""Called with points [n, 3] in the scanner frame [m] and their colours [n, 3], uint8."""


class RecordedPair(NamedTuple):
    """One record as it was taken."""

    number: int
    angle: float
    """[rad from home]"""
    on: np.ndarray
    """uint8 [rows, columns(, 3)]"""
    off: np.ndarray


@dataclass
class PlannedSweep:
    """A sweep of one laser that is to come: a `SweepSource` of which the first frames alone are at hand."""

    pixel_format: PixelFormat
    response: Response
    lasers: tuple[LaserLine, ...]
    image_size: tuple[int, int]
    carries: str | None
    steps: int
    first: FrameChunk | None = None
    exposures: tuple[float, ...] = (1.0,)
    compression: str | None = None
    angles: np.ndarray = field(init=False)
    record: np.ndarray = field(init=False)
    laser: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.angles = np.zeros(self.steps)
        self.record = np.arange(self.steps, dtype=np.int32)
        self.laser = np.zeros(self.steps, np.int32)

    def __len__(self) -> int:
        return self.steps

    def chunks(self, size: int) -> Iterator[FrameChunk]:
        if self.first is not None:
            on, off = self.first
            yield FrameChunk(on[:size], None if off is None else off[:size])


class IncomingStripes:
    """Stripes of the records so far; `learn` once, then `compute` in any order."""

    def __init__(
        self,
        sweep: PlannedSweep,
        scanner: Scanner,
        settings: ReconstructSettings = DEFAULTS,
        show: Show | None = None,
    ) -> None:
        """Check that sweep and scanner fit together.

        Args:
            sweep: The sweep to come.
            scanner: The calibrated rig.
            settings: As for `reconstruct`.
            show: Gets the points of some records as soon as they are computed, without smoothing.

        Raises:
            CaptureError: If the sweep contradicts itself.
            CalibrationError: If the scanner is not that of the sweep.
            ValueError: If the stripes of a record need its neighbours, or are several.
        """
        if settings.check_steps or settings.stripes.choice == "all":
            raise ValueError("Stripes are found one record at a time: neither `check_steps` nor every candidate.")
        self._sweep, self._show = sweep, show
        self._plan = make_plan(sweep, scanner, settings)
        self._engine: StripeEngine | None = None
        self._stripes = GrowingStripes(len(sweep), self._plan.lines)
        self.points = np.full(len(sweep), -1, np.int64)
        """Points of each record; -1 where its stripes are not known."""

    @property
    def size(self) -> int:
        """Records computed at a time."""
        return self._plan.size

    @property
    def needed(self) -> int:
        """Records at the start of the sweep from which is learned."""
        return min(len(self._sweep), NOISE_RECORDS)

    @property
    def learned(self) -> bool:
        """Whether stripes can be found."""
        return self._engine is not None

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the frames, a sentence each, once it is learned."""
        return tuple(self._plan.notes)

    @property
    def noise(self) -> str:
        """A line on the noise, once it is learned."""
        return self._plan.noise

    def learn(self, pairs: Sequence[RecordedPair]) -> None:
        """Prepare the search from the first `needed` records, in their order.

        Raises:
            CaptureError: If they do not tell the laser's colour.
        """
        self._sweep.first = FrameChunk(np.stack([pair.on for pair in pairs]), np.stack([pair.off for pair in pairs]))
        (engine,) = self._plan.engines().values()
        self._engine = engine.learn(*_frames(pairs[: self.size]), self.size)
        self._plan.tell_noise(0, self._engine)
        self._sweep.first = None

    def compute(self, pairs: Sequence[RecordedPair]) -> None:
        """Find the stripes of some records, and count their points.

        Raises:
            ValueError: If nothing was learned yet.
        """
        if self._engine is None:
            raise ValueError("`learn` comes before `compute`.")
        plan = self._plan
        ordered = sorted(pairs, key=lambda pair: pair.number)
        for start in range(0, len(ordered), self.size):
            some = ordered[start : start + self.size]
            numbers, (on, off) = np.array([pair.number for pair in some]), _frames(some)
            phi = np.array([pair.angle for pair in some], np.float32)
            found = self._engine.extract(on, off, self.size).stripes
            rgb = stripe_colours(found, off, plan.frames, plan.stripe_axis)
            points = points_alone(plan.aim(0), Centres.of(found), phi, self.size, stripe_axis=plan.stripe_axis)
            valid = np.asarray(points.valid)
            self._stripes.store(numbers, found, rgb)
            self.points[numbers] = np.count_nonzero(valid, axis=1)
            if self._show is not None:
                self._show(np.asarray(points.xyz)[valid], rgb[valid])

    def are_of(self, sweep: SweepSource, numbers: Sequence[int]) -> bool:
        """Whether a finished sweep would learn the same from its first records.

        Args:
            sweep: The finished sweep.
            numbers: Of its records, ascending.
        """
        # A shorter sweep may be computed in smaller chunks, of which the first teaches the width.
        taught = min(self.size, LEARNED_FRAMES, self.needed)
        same = min(chunk_records(sweep, self._plan.settings), LEARNED_FRAMES, len(numbers)) == taught
        begins = list(numbers[: self.needed]) == list(range(self.needed))
        return self.learned and same and begins and numbers[-1] < len(self.points)

    def finish(self, numbers: Sequence[int]) -> Stripes:
        """Stripes of some records, one profile each, numbered anew from 0."""
        rows, count = np.asarray(numbers), len(numbers)
        fields = {name: values[rows] for name, values in self._stripes.fields.items()}
        record, laser = np.arange(count, dtype=np.int32), np.zeros(count, np.int32)
        return Stripes(**fields, record=record, laser=laser)


def _frames(pairs: Sequence[RecordedPair]) -> tuple[np.ndarray, np.ndarray]:
    return np.stack([pair.on for pair in pairs]), np.stack([pair.off for pair in pairs])
