"""Stripes of a sweep while it is being taken, as `extract_sweep` finds them in the finished one.

What the search knows of a sweep it learns from the first records; a frame's stripes depend on
nothing else beside the frame. So they are the same whenever they are found, and beside which others.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import numpy as np

from jaxscan.geometry import Scanner
from jaxscan.reconstruction.plan import NOISE_RECORDS, make_plan, make_searches, with_colours
from jaxscan.reconstruction.points.locate import Rig
from jaxscan.reconstruction.points.triangulate import Limits
from jaxscan.reconstruction.settings import DEFAULTS, ReconstructSettings
from jaxscan.reconstruction.streaming.batches import chunk_records, padded
from jaxscan.reconstruction.streaming.chunk import Aim, compute_chunk, points_alone
from jaxscan.reconstruction.streaming.grid import GrowingStripes
from jaxscan.reconstruction.sweep import FrameChunk, SweepSource
from jaxscan.stripes.fitting.widths import LEARNED_FRAMES
from jaxscan.stripes.frames.formats import LaserLine, PixelFormat, Response
from jaxscan.stripes.search.search import Search, learn_search
from jaxscan.stripes.stripes import Stripes


class Pair(NamedTuple):
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
    lines: tuple[LaserLine, ...]
    image_size: tuple[int, int]
    carries: str | None
    steps: int
    first: FrameChunk | None = None
    exposures: tuple[float, ...] = (1.0,)
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

    def __init__(self, sweep: PlannedSweep, scanner: Scanner, settings: ReconstructSettings = DEFAULTS) -> None:
        """Check that sweep and scanner fit together.

        Raises:
            CaptureError: If the sweep contradicts itself.
            CalibrationError: If the scanner is not that of the sweep.
            ValueError: If the stripes of a record need its neighbours, or are several.
        """
        if settings.check_steps or settings.stripes.choice == "all":
            raise ValueError("Stripes are found one record at a time: neither `check_steps` nor every candidate.")
        self._sweep, self._scanner = sweep, scanner
        self._plan = make_plan(sweep, scanner, settings)
        self._search: Search | None = None
        self._rig: Rig | None = None
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
        return self._search is not None

    def learn(self, pairs: Sequence[Pair]) -> None:
        """Prepare the search from the first `needed` records, in their order.

        Raises:
            CaptureError: If they do not tell the laser's colour.
        """
        self._sweep.first = FrameChunk(np.stack([pair.on for pair in pairs]), np.stack([pair.off for pair in pairs]))
        # JAX keeps this setting per thread.
        with jax.enable_x64(False):
            self._plan = with_colours(self._plan)
            search = make_searches(self._plan, None)[0]
            self._rig = Rig.of(self._scanner, self._plan.stripe_axis)
            if self._plan.settings.stripes.learn_width:
                some = pairs[: self.size]
                on, off = self._frames([pair.on for pair in some]), self._frames([pair.off for pair in some])
                search = learn_search(search, compute_chunk(on, off, search, None, self._plan.kind(0)).stripes)
        self._sweep.first = None
        self._search = search

    def compute(self, pairs: Sequence[Pair]) -> None:
        """Find the stripes of some records, and count their points.

        Raises:
            ValueError: If nothing was learned yet.
        """
        if self._search is None or self._rig is None:
            raise ValueError("`learn` comes before `compute`.")
        kind, limits = self._plan.kind(0), Limits.of(self._plan.settings)
        ordered = sorted(pairs, key=lambda pair: pair.number)
        for start in range(0, len(ordered), self.size):
            some = ordered[start : start + self.size]
            numbers = np.array([pair.number for pair in some])
            on, off = self._frames([pair.on for pair in some]), self._frames([pair.off for pair in some])
            phi = padded(np.array([pair.angle for pair in some], np.float32), self.size)
            with jax.enable_x64(False):
                result = jax.tree.map(np.asarray, compute_chunk(on, off, self._search, None, kind))
                found = result.stripes
                aim = Aim(self._rig, np.asarray(self._plan.sheet[0], np.int32), phi, limits)
                axis = self._plan.stripe_axis
                valid = np.asarray(points_alone(found.u, found.sigma, found.valid, aim, stripe_axis=axis).valid)
            self._stripes.store(numbers, found, result.rgb)
            self.points[numbers] = np.count_nonzero(valid[: len(some)], axis=1)

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
        return Stripes(**fields, rgb=self._stripes.rgb[rows], record=record, laser=laser)

    def _frames(self, frames: Sequence[np.ndarray]) -> np.ndarray:
        return padded(np.stack(frames), self.size)
