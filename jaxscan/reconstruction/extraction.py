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
from jaxscan.reconstruction.points import coloured
from jaxscan.reconstruction.streaming import Batch, GrowingStripes, ReadOnce, batches
from jaxscan.stripes import ChunkStripes, Continuation, NoiseModel, StripeEngine, Stripes, padded, pick_by_steps


Progress = Callable[[int, int], None] | None


def stripes_of_plan(plan: Plan, *, noise: NoiseModel | None = None, progress: Progress = None) -> Stripes:
    """`extract_sweep` by a plan that is made."""
    sweep = plan.sweep
    profiles = len(sweep.record)
    found = extracted(plan, noise, progress, with_points=False)
    each = found.each
    stripes = GrowingStripes(each * profiles, plan.lines)
    chosen = np.full((profiles, plan.lines), -1, np.int8)
    for rows, result in found.chunks:
        stripes.store(rows, result.stripes, result.more.rgb)
        if result.chosen is not None:
            own = rows[::each] // each
            chosen[own] = result.chosen[: len(own)]
    if plan.settings.check_steps:
        stripes.fields = pick_by_steps(stripes.fields, chosen, sweep.laser, sweep.angles[sweep.record])
        each = 1
    stripes.keep_clear(found.chance(plan).least)
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
    found = extracted(part, noise, progress, with_points=False, learned=(_learned(plan, noise), decoys))
    stripes = GrowingStripes(len(part.sweep.record), part.lines)
    for rows, result in found.chunks:
        stripes.store(rows, result.stripes, result.more.rgb)
    clear, lost = decoys.compared(found.search, part.size)
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
    frames = ReadOnce(plan.sweep, plan.size)
    engines, learned = plan.engines(noise, frames.first(plan.learned_from)), set[int]()
    for batch in batches(plan.sweep, plan.size, frames.chunks()):
        if batch.laser not in learned:
            learned.add(batch.laser)
            engines[batch.laser] = engines[batch.laser].learn(
                batch.on, batch.off, coloured(plan.frames, records=plan.size)
            )
            plan.tell_noise(batch.laser, engines[batch.laser])
        if len(learned) == len(engines):
            break
    return engines


def rows_of(profiles: np.ndarray, each: int) -> np.ndarray:
    """Rows of the grid of so many profiles for each of some profiles of the sweep."""
    return (each * profiles[:, None] + np.arange(each)[None, :]).reshape(-1)


class Extraction(NamedTuple):
    """Stripes on their way."""

    each: int
    """Profiles of a record."""
    chunks: Iterator[tuple[np.ndarray, ChunkStripes]]
    """Stripes, colours and perhaps points, with the rows of the grid that they are."""
    decoys: DecoyWatch
    """To be asked after the last chunk."""
    search: Callable[[Batch], ChunkStripes]
    """Finds the stripes of a batch."""

    def chance(self, plan: Plan) -> Chance:
        """The decoys' verdict, whose note goes to those of the plan."""
        found = self.decoys.judge(self.search, plan.size)
        plan.notes.extend([found.note] if found.note else [])
        return found


def extracted(
    plan: Plan,
    noise: NoiseModel | None,
    progress: Progress,
    *,
    with_points: bool,
    learned: tuple[dict[int, StripeEngine], DecoyWatch] | None = None,
) -> Extraction:
    """Begin to find the stripes of all chunks.

    Args:
        plan: The sweep, or a part of one.
        noise: Noise of a frame; learned from the first records where not given.
        progress: Called with (records done, records in all).
        with_points: Whether chunks have points too.
        learned: Of a part: engines that have learned from the whole sweep, and the watch over its profiles.
    """
    sweep, size = plan.sweep, plan.size
    frames, angles = ReadOnce(sweep, size), sweep.angles.astype(np.float32)
    if learned is None:
        engines = plan.engines(noise, frames.first(plan.learned_from))
        decoys = DecoyWatch(len(sweep.record), predicted=plan.predicts)
    else:
        engines, decoys = learned
    each = next(iter(engines.values())).profiles_per_record

    def then(batch: Batch) -> Continuation:
        if not with_points:
            return coloured(plan.frames, records=size)
        phi = padded(angles[sweep.record[batch.profiles]], size)
        return coloured(plan.frames, plan.aim(int(batch.profiles[0])), phi, records=size)

    def search(batch: Batch) -> ChunkStripes:
        return engines[batch.laser].extract(batch.on, batch.off, then(batch))

    def search_alone(batch: Batch) -> ChunkStripes | None:
        engine = engines[batch.laser]
        return engine.extract(batch.on, batch.off) if engine.takes_any_number(batch.off) else None

    def compute(batch: Batch) -> tuple[np.ndarray, ChunkStripes]:
        found = search(batch)
        decoys.look(batch, found, search_alone)
        return batch.profiles, found

    def ready(waiting: Iterator[Batch]) -> Iterator[Batch]:
        """Each laser's first batch is computed twice: at first it says how wide the stripes are."""
        known = set(engines) if learned is not None else set[int]()
        for batch in waiting:
            if batch.laser not in known:
                known.add(batch.laser)
                engines[batch.laser] = engines[batch.laser].learn(batch.on, batch.off, then(batch))
                plan.tell_noise(batch.laser, engines[batch.laser])
            yield batch

    def chunks() -> Iterator[tuple[np.ndarray, ChunkStripes]]:
        compiled = next(iter(engines.values())).learns
        waiting = ready(batches(sweep, size, frames.chunks()))
        for profiles, result in map_ahead(compute, waiting, workers(), compiled=compiled):
            yield rows_of(profiles, each), result
            if progress is not None:
                progress(int(sweep.record[profiles[-1]]) + 1, len(sweep))

    return Extraction(each, chunks(), decoys, search)
