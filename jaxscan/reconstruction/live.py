"""The stripes of a sweep while it is being taken, as `extract` finds them in the finished one."""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from jaxscan.geometry import Scanner
from jaxscan.reconstruction.extraction import LEARNED_RECORDS, Learned, empty_stripes, learn
from jaxscan.reconstruction.plan import chunk_records, plan_sweep
from jaxscan.reconstruction.points import Aim, Centres, empty_points, fill_points
from jaxscan.reconstruction.settings import DEFAULTS, ReconstructSettings
from jaxscan.reconstruction.sweep import Batch, FrameChunk, SweepSource, batches
from jaxscan.stripes import LEARNED_FRAMES, LaserLine, PixelFormat, Response, Stripes


Show = Callable[[np.ndarray, np.ndarray], None]
"""Called with points [n, 3] in the scanner frame [m] and their colours [n, 3], uint8."""


class RecordedPair(NamedTuple):
    """One record as it was taken."""

    number: int
    angle: float
    """[rad from home]"""
    on: np.ndarray
    """uint8 [rows, columns(, 3)]; where there are several exposures, or levels, [exposures, rows, columns(, 3)]"""
    off: np.ndarray


@dataclass(frozen=True)
class PlannedSweep:
    """A sweep to come whose lasers take turns: a `SweepSource` of which the first frames alone are at hand."""

    pixel_format: PixelFormat
    response: Response
    lasers: tuple[LaserLine, ...]
    image_size: tuple[int, int]
    carries: str | None
    steps: int
    first: FrameChunk | None = None
    exposures: tuple[float, ...] = (1.0,)
    compression: str | None = None
    bits: int = 8
    poses: np.ndarray | None = None
    angles: np.ndarray = field(init=False)
    record: np.ndarray = field(init=False)
    laser: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        record = np.arange(self.steps, dtype=np.int32)
        laser = record % max(len(self.lasers), 1)
        for name, values in (("angles", np.zeros(self.steps)), ("record", record), ("laser", laser)):
            object.__setattr__(self, name, values)

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
            show: Gets the points of some records as soon as they are computed, without smoothing.

        Raises:
            CaptureError: If the sweep contradicts itself.
            CalibrationError: If the scanner is not that of the sweep.
            ValueError: If the stripes of a record need its neighbours, or are several.
        """
        if settings.check_steps or settings.stripes.choice == "all":
            raise ValueError("Stripes are found one record at a time: neither `check_steps` nor every candidate.")
        self._sweep, self._plan, self._show = sweep, plan_sweep(sweep, scanner, settings), show
        self._aim = Aim.of(scanner, settings, self._plan.stripe_axis)
        self._learned: Learned | None = None
        self._stripes = empty_stripes(len(sweep), self._plan.lines)
        self.points = np.full(len(sweep), -1, np.int64)
        """Points of each record; -1 where its stripes are not known."""

    @property
    def size(self) -> int:
        """Records computed at a time."""
        return self._plan.size

    @property
    def needed(self) -> int:
        """Records at the start of the sweep from which is learned."""
        return min(len(self.points), max(LEARNED_RECORDS, min(self.size, self._teaching)))

    @property
    def _teaching(self) -> int:
        """Records in which every laser shows the frames that teach its width and speckle."""
        return LEARNED_FRAMES * len(self._sweep.lasers)

    @property
    def learned(self) -> bool:
        """Whether stripes can be found."""
        return self._learned is not None

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the frames, a sentence each, once it is learned."""
        return () if self._learned is None else self._learned.notes

    @property
    def noise(self) -> str:
        """A line on the noise, once it is learned."""
        return "" if self._learned is None else self._learned.noise

    def learn(self, pairs: Sequence[RecordedPair]) -> None:
        """Prepare the search from the first `needed` records, in their order.

        Raises:
            CaptureError: If they do not tell the laser's colour.
        """
        on, off = (np.stack([getattr(pair, name) for pair in pairs]) for name in ("on", "off"))
        first = FrameChunk(on[:LEARNED_RECORDS], off[:LEARNED_RECORDS])
        learned = learn(replace(self._plan, sweep=replace(self._sweep, first=FrameChunk(on, off))), first)
        for batch in batches(self._sweep, self.size, [FrameChunk(on[: self.size], off[: self.size])]):
            learned = learned.taught_by(batch)
        self._learned = replace(learned, plan=self._plan)

    def compute(self, pairs: Sequence[RecordedPair]) -> None:
        """Find the stripes of some records, and count their points.

        Raises:
            ValueError: If nothing was learned yet.
        """
        if self._learned is None:
            raise ValueError("`learn` comes before `compute`.")
        axis, laser = self._plan.stripe_axis, self._sweep.laser
        ordered = sorted(pairs, key=lambda pair: (laser[pair.number], pair.number))
        for one, mine in itertools.groupby(ordered, key=lambda pair: int(laser[pair.number])):
            group = list(mine)
            for start in range(0, len(group), self.size):
                some = group[start : start + self.size]
                numbers, on, off = (
                    np.array([getattr(pair, name) for pair in some]) for name in ("number", "on", "off")
                )
                batch = Batch(numbers, one, on, off)
                found = self._learned.find(batch)
                stripes = found.stripes._asdict() | {"rgb": self._learned.colours(batch, found)}
                for name, to in self._stripes.items():
                    to[batch.profiles] = stripes[name]
                points, aim = empty_points(np.shape(found.stripes.u)), self._aim
                aim = aim._replace(laser=np.asarray(self._plan.sheet[batch.profiles[0]], np.int32))
                centres = Centres(*(stripes[name] for name in Centres._fields))
                phi = np.array([pair.angle for pair in some], np.float32)
                fill_points(points, np.arange(len(some)), aim, centres, phi, stripe_axis=axis)
                valid = points["valid"]
                self.points[batch.profiles] = np.count_nonzero(valid, axis=1)
                if self._show is not None:
                    self._show(points["xyz"][valid], stripes["rgb"][valid])

    def are_of(self, sweep: SweepSource, numbers: Sequence[int]) -> bool:
        """Whether a finished sweep would learn the same from its first records.

        Args:
            sweep: The finished sweep.
            numbers: Of its records, ascending.
        """
        # A shorter sweep may be computed in smaller chunks, of which the first teaches the width.
        taught = min(self.size, self._teaching, self.needed)
        same = min(chunk_records(sweep, self._plan.settings), self._teaching, len(numbers)) == taught
        begins = list(numbers[: self.needed]) == list(range(self.needed))
        fits = self.learned and same and begins and numbers[-1] < len(self.points)
        return fits and np.array_equal(sweep.laser, self._sweep.laser[list(numbers)])

    def finish(self, numbers: Sequence[int]) -> Stripes:
        """Stripes of some records, one profile each, numbered anew from 0."""
        rows = np.asarray(numbers)
        fields = {name: values[rows] for name, values in self._stripes.items()}
        return Stripes(**fields, record=np.arange(len(rows), dtype=np.int32), laser=self._sweep.laser[rows])
