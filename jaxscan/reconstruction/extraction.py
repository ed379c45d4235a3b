"""The stripes of a sweep, found chunk by chunk: of all its records, or of a part of them in a process of its own.

What is learned is learned from the first records; after that the stripes of a frame depend on nothing but the frame. So
parts that were found apart are together what the whole would have given.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from jaxscan.reconstruction.ahead import map_ahead, workers
from jaxscan.reconstruction.decoys import Chance, DecoyWatch, judge
from jaxscan.reconstruction.plan import Plan
from jaxscan.reconstruction.points import stripe_colours
from jaxscan.reconstruction.streaming import Batch, GrowingStripes, batches
from jaxscan.reconstruction.sweep import FrameChunk
from jaxscan.stripes import ChunkStripes, NoiseModel, StripeEngine, Stripes, pick_by_steps


Progress = Callable[[int, int], None] | None


def stripes_of_plan(plan: Plan, *, noise: NoiseModel | None = None, progress: Progress = None) -> Stripes:
    """`extract` by a plan that is made."""
    sweep = plan.sweep
    profiles = len(sweep.record)
    frames = _Ahead(plan)
    engines = plan.engines(noise, frames.first(plan.learned_from))
    search = _Search(plan, engines, DecoyWatch(profiles, predicted=plan.predicts))
    each = search.each
    stripes = GrowingStripes(each * profiles, plan.lines)
    chosen = np.full((profiles, plan.lines), -1, np.int8)
    for batch, found, rgb in search.results(frames.chunks(), progress):
        stripes.store(rows_of(batch.profiles, each), found.stripes, rgb)
        if found.chosen is not None:
            chosen[batch.profiles] = found.chosen
    if plan.settings.check_steps:
        stripes.fields = pick_by_steps(stripes.fields, chosen, sweep.laser, sweep.angles[sweep.record])
        each = 1
    chance = search.decoys.judge(search.find, plan.size)
    plan.notes.extend([chance.note] if chance.note else [])
    stripes.keep_clear(chance.least)
    profile = np.arange(each * profiles) // each
    return stripes.finish(sweep.record[profile], sweep.laser[profile])


class StripePart(NamedTuple):
    """The stripes of some neighbouring records of a sweep, before the decoys of all have judged them."""

    fields: dict[str, np.ndarray]
    """As of `GrowingStripes`, a profile for each laser in a record."""
    clear: np.ndarray
    """Clearness of the stripes [1] in profiles that were searched for decoys, float32 [searched, lines]."""
    decoys: np.ndarray
    """The same of the decoys."""
    found: int
    """Stripes, before any is left out."""


def can_be_split(plan: Plan) -> bool:
    """Whether parts of a sweep, found apart, are to the last bit what the whole gives.

    Not where laser-off frames are predicted from neighbours, steps are compared, a line has several stripes, or a laser
    is first lit after the records from which is learned.
    """
    sweep, settings = plan.sweep, plan.settings
    shown = np.unique(sweep.laser[sweep.record < plan.size])
    one_each = not settings.check_steps and settings.stripes.choice != "all"
    return one_each and not plan.predicts and len(shown) == len(np.unique(sweep.laser))


def stripes_of_part(
    plan: Plan, part: Plan, first: int, *, noise: NoiseModel | None = None, progress: Progress = None
) -> StripePart:
    """The stripes of some neighbouring records.

    Args:
        plan: Of the whole sweep, that `can_be_split`; its first chunk is read to learn from.
        part: Of those records alone.
        first: Number of profiles of the sweep before them.
        noise: Noise of a frame; learned where not given.
        progress: Called with (records done, records of the part) after every chunk.
    """
    part.size = plan.size
    decoys = DecoyWatch(len(plan.sweep.record), predicted=False, first=first)
    search = _Search(part, _learned(plan, noise), decoys, learned=True)
    stripes = GrowingStripes(len(part.sweep.record), part.lines)
    for batch, found, rgb in search.results(part.sweep.chunks(part.size), progress):
        stripes.store(batch.profiles, found.stripes, rgb)
    clear, lost = decoys.compared(search.find, part.size)
    return StripePart(stripes.fields, clear, lost, decoys.found)


def stripes_of_parts(plan: Plan, parts: Sequence[StripePart]) -> Stripes:
    """The stripes of a sweep from those of all its records, in their order.

    Args:
        plan: Of the whole sweep; no frame is read.
        parts: Together all its profiles.
    """
    sweep = plan.sweep
    stripes = GrowingStripes(0, plan.lines)
    stripes.fields = {name: np.concatenate([part.fields[name] for part in parts]) for name in stripes.fields}
    searched = [part for part in parts if part.clear.size]
    found = Chance()
    if searched:
        clear, decoys = (np.concatenate([getattr(part, name) for part in searched]) for name in ("clear", "decoys"))
        found = judge(clear, decoys, per_profile=sum(part.found for part in parts) / len(sweep.record))
    plan.notes.extend([found.note] if found.note else [])
    stripes.keep_clear(found.least)
    return stripes.finish(sweep.record, sweep.laser)


def _learned(plan: Plan, noise: NoiseModel | None) -> dict[int, StripeEngine]:
    """The engines, with what they learn from each laser's first batch."""
    frames = _Ahead(plan)
    search = _Search(plan, plan.engines(noise, frames.first(plan.learned_from)), None)
    for batch in batches(plan.sweep, plan.size, frames.chunks()):
        search.learn(batch)
        if len(search.learned) == len(search.engines):
            break
    return search.engines


def rows_of(profiles: np.ndarray, each: int) -> np.ndarray:
    """Rows of the grid of so many profiles for each of some profiles of the sweep."""
    return (each * profiles[:, None] + np.arange(each)[None, :]).reshape(-1)


class _Ahead:
    """The chunks of a sweep, of which the first are looked at before they are searched."""

    def __init__(self, plan: Plan) -> None:
        self._coming, self._seen = plan.sweep.chunks(plan.size), list[FrameChunk]()

    def first(self, count: int) -> FrameChunk:
        """The first records, of which there are at least so many, in whatever chunks they lie."""
        while sum(len(chunk.on) for chunk in self._seen) < count:
            self._seen.append(next(self._coming))
        on = [chunk.on for chunk in self._seen]
        off = [chunk.off for chunk in self._seen if chunk.off is not None]
        joined = [frames[0] if len(frames) == 1 else np.concatenate(frames) for frames in (on, off) if frames]
        return FrameChunk(*(frames[:count] for frames in joined), *([None] if not off else []))

    def chunks(self) -> Iterator[FrameChunk]:
        """All of them, once."""
        while self._seen:
            yield self._seen.pop(0)
        yield from self._coming


class _Search:
    """Finds the stripes of batches of frames, in threads."""

    def __init__(
        self, plan: Plan, engines: dict[int, StripeEngine], decoys: DecoyWatch | None, *, learned: bool = False
    ) -> None:
        self.plan, self.engines = plan, engines
        self.decoys = decoys if decoys is not None else DecoyWatch(1, predicted=False)
        self.learned = set(engines) if learned else set[int]()
        self.each = next(iter(engines.values())).profiles_per_record
        """Profiles of a record."""

    def find(self, batch: Batch) -> ChunkStripes:
        return self.engines[batch.laser].extract(batch.on, batch.off, self.plan.size)

    def learn(self, batch: Batch) -> None:
        """Each laser's first batch says how wide the stripes are."""
        if batch.laser not in self.learned:
            self.learned.add(batch.laser)
            self.engines[batch.laser] = self.engines[batch.laser].learn(batch.on, batch.off, self.plan.size)
            self.plan.tell_noise(batch.laser, self.engines[batch.laser])

    def results(
        self, chunks: Iterator[FrameChunk], progress: Progress
    ) -> Iterator[tuple[Batch, ChunkStripes, np.ndarray]]:
        """Stripes and colours of all batches in order; `progress` is called with (records done, records in all)."""
        sweep = self.plan.sweep

        def compute(batch: Batch) -> tuple[Batch, ChunkStripes, np.ndarray]:
            found = self.find(batch)
            self.decoys.look(batch, found)
            off = batch.off if batch.off is None or len(sweep.exposures) == 1 else batch.off[:, -1]
            return batch, found, stripe_colours(found.stripes, off, self.plan.frames, self.plan.stripe_axis)

        def ready() -> Iterator[Batch]:
            for batch in batches(sweep, self.plan.size, chunks):
                self.learn(batch)
                yield batch

        compiled = next(iter(self.engines.values())).learns
        for batch, found, rgb in map_ahead(compute, ready(), workers(), compiled=compiled):
            yield batch, found, rgb
            if progress is not None:
                progress(int(sweep.record[batch.profiles[-1]]) + 1, len(sweep))
