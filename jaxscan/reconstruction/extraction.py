"""The stripes of a sweep, found chunk by chunk: of all its records, or while they are taken.

What is learned is learned from the first records; after that the stripes of a frame depend on nothing but the frame. So
they are the same whenever and wherever they are found, and in whatever chunk.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.errors import CaptureError
from jaxscan.geometry import Array, Scanner
from jaxscan.reconstruction.ahead import Progress, map_ahead, workers
from jaxscan.reconstruction.along import SmoothedSweep
from jaxscan.reconstruction.colours import stripe_colours
from jaxscan.reconstruction.false_stripes import Decoys, DecoyWatch, judge_sweep
from jaxscan.reconstruction.plan import Plan, plan_sweep
from jaxscan.reconstruction.settings import DEFAULTS, ReconstructSettings
from jaxscan.reconstruction.sweep import Batch, FrameChunk, SweepSource, batches, colour_exposure, place, rows_of
from jaxscan.reconstruction.without_off import GIVEN, Dark, darks, with_off
from jaxscan.stripes import (
    KEPT_FIELDS,
    BlackLevelError,
    ChunkStripes,
    ExtractionSetup,
    LaserLine,
    LearnedNoise,
    LineGate,
    NoiseModel,
    StripeEngine,
    Stripes,
    chosen_of,
    clear_level,
    learn_noise,
    pick_by_steps,
    prepare_engines,
    speckle_words,
    whole_lines,
    with_colour,
)


LEARNED_RECORDS = 8
"""Records at the start of a sweep from which noise and colours are learned where they are not given."""
_APART = 4
"""Lines from a centre to those on both sides with which it should be straight: the errors of the next ones are alike in
mosaics and compressed frames."""
_STRAIGHT_PX, _SAME_PX = 1.0, 2.0
"""Bend up to which three centres are a continuous surface, and distance up to which two are of one stripe [px]."""
_BETTER = 1.2
"""Straight pieces over their variance, in those with the usual laser-off frames, from which others are taken [1]."""
_MOST_SAID = 10.0
_SAID = {
    "given": "the given laser-off picture",
    "predicted": "what all channels predict",
    "alone": "what each channel predicts by itself",
    "even": "one colour",
}


class Extraction(NamedTuple):
    """The stripes of a sweep, and what was learned of its frames."""

    stripes: Stripes
    """A profile per laser in a record, with colours; NumPy arrays, float32. `record` and `laser` are those of the
    sweep."""
    notes: tuple[str, ...] = ()
    """Doubts about noise and stripes, a sentence each."""
    noise: str = ""
    """Noise of a frame and speckle as they were learned, in a line; empty where the noise was given."""
    smoothed: SmoothedSweep | None = None
    """The centres smoothed along the stripes, where that is done already."""


def extract(
    sweep: SweepSource,
    scanner: Scanner,
    *,
    settings: ReconstructSettings = DEFAULTS,
    noise: NoiseModel | None = None,
    progress: Progress = None,
) -> Extraction:
    """Find the stripes of a whole sweep; `reconstruct` takes them instead of frames.

    Args:
        sweep: Frames and angles, on the disk or in memory.
        scanner: The calibrated rig; it only says where on a line stripes can lie.
        settings: Range limits, and how stripes are found.
        noise: Noise of a frame; estimated from the start of the sweep where not given.
        progress: Called with (records done, records in all).

    Returns:
        The stripes, and what was learned of the frames.

    Raises:
        CaptureError: If the sweep has no records or cannot be read, or its stripes are not told from chance.
        CalibrationError: If the scanner is not that of the sweep.
    """
    plan = plan_sweep(sweep, scanner, settings)
    ahead, coming = _ahead(plan)
    learned = _learn_straightest(plan, _first(ahead), noise)
    frames = with_off(plan, learned.dark) if learned.chosen else _replayed(ahead, coming)
    watch = DecoyWatch(plan, predicted=learned.dark.source != "given")
    sweep, each, settings = plan.sweep, learned.profiles_per_record, plan.settings
    fields = empty_stripes(each * len(sweep.record), plan.lines)
    chosen = np.full((len(sweep.record), plan.lines), -1, np.int8)

    def taught() -> Iterator[tuple[Learned, Batch]]:
        nonlocal learned
        for batch in batches(sweep, plan.size, frames):
            learned = learned.taught_by(batch)
            yield learned, batch

    def compute(item: tuple[Learned, Batch]) -> tuple[Batch, ChunkStripes, np.ndarray, Decoys]:
        known, batch = item
        found = known.find(batch)
        return batch, found, known.colours(batch, found), watch.look(batch, known.find)

    decoys: list[Decoys] = []
    for batch, found, rgb, turned in map_ahead(compute, taught(), workers(), compiled=learned.compiles):
        rows = place(rows_of(batch.profiles, each))
        for name, field in fields.items():
            field[rows] = rgb if name == "rgb" else np.asarray(getattr(found.stripes, name))
        decoys.append(turned)
        if found.chosen is not None:
            chosen[batch.profiles] = found.chosen
        if progress is not None:
            progress(int(sweep.record[batch.profiles[-1]]) + 1, len(sweep))
    if settings.check_steps:
        fields = pick_by_steps(fields, chosen, sweep.laser, sweep.angles[sweep.record])
    every, notes = Decoys.joined(decoys), learned.notes
    if len(every.profile) and len(fields["u"]) == len(sweep.record):
        chance, accepted = judge_sweep(plan, fields, every)
        notes = (*notes, *([chance.note] if chance.note else []))
        if chance.least > 0.0:
            for field in fields.values():
                field[~accepted] = 0
    profile = np.arange(len(fields["u"])) // (len(fields["u"]) // len(sweep.record))
    stripes = Stripes(**fields, record=sweep.record[profile], laser=sweep.laser[profile])
    return Extraction(stripes, notes, learned.noise)


@dataclass(frozen=True, eq=False)
class Learned:
    """What the first records of a sweep tell, by which the stripes of any of its frames are found."""

    plan: Plan
    lasers: tuple[LaserLine, ...]
    """The lasers, with their colours."""
    engines: dict[int, StripeEngine]
    """The engine of each laser of the sweep."""
    dark: Dark
    """Where the laser-off frames come from."""
    chosen: bool = False
    """Whether these engines differ from the usual ones."""
    taught: frozenset[int] = frozenset()
    """Lasers whose width and speckle are known."""
    of_frame: LearnedNoise | None = None
    """Noise of a frame, where it was not given."""
    notes: tuple[str, ...] = ()
    noise: str = ""
    """See `Extraction`."""

    @property
    def compiles(self) -> bool:
        """Whether learning runs, and so compiles, the function that finds stripes."""
        return next(iter(self.engines.values())).learns

    @property
    def profiles_per_record(self) -> int:
        return next(iter(self.engines.values())).profiles_per_record

    def taught_by(self, batch: Batch) -> "Learned":
        """What is known after a batch: its laser's width and speckle too, if this is the first batch of that laser."""
        laser = batch.laser
        if laser in self.taught:
            return self
        engine = self.engines[laser].learn(batch.on, batch.off, self.plan.size)
        noise, known = self.noise, self.of_frame
        if known is not None:
            reason = engine.speckle_reason
            words = speckle_words(engine.noise.speckle, reason) if noise else known.words(engine.noise, reason)
            name = f'laser "{self.lasers[laser].name}": ' if len(self.engines) > 1 else ""
            noise = "; ".join(part for part in (noise, name + words) if part)
        return dataclasses.replace(
            self, engines=self.engines | {laser: engine}, taught=self.taught | {laser}, noise=noise
        )

    def find(self, batch: Batch) -> ChunkStripes:
        """The stripes of a batch of frames."""
        return self.engines[batch.laser].extract(batch.on, batch.off, self.plan.size)

    def find_shared(self, batch: Batch) -> ChunkStripes:
        """The same by all cores together."""
        return self.engines[batch.laser].extract_shared(batch.on, batch.off, self.plan.size)

    def colours(self, batch: Batch, found: ChunkStripes) -> np.ndarray:
        """The colours of the stripes of a batch."""
        off, sweep = batch.off, self.plan.sweep
        off = off if off is None or len(sweep.exposures) == 1 else off[:, colour_exposure(sweep)]
        return stripe_colours(found.stripes, off, self.plan.frames, self.plan.stripe_axis)


def _learn_straightest(plan: Plan, usual: FrameChunk, noise: NoiseModel | None) -> Learned:
    """What is learned with the laser-off frames that make lines straightest: the usual ones, unless others do by far.

    Args:
        usual: The first records with the laser-off frames that the sweep usually has.
        noise: As of `learn`.
    """
    first, *others = darks(plan.sweep, usual)
    taken = best = learn(plan, usual, noise=noise, dark=first)
    if not others:
        return best
    lines, gained = _Lines.of(best, usual), 1.0
    if first.source == "predicted":
        # Noise is that of the same frames.
        noise = next(iter(best.engines.values())).noise
    for dark in others:
        chunk = _first(_ahead(plan, dark)[0])
        other = learn(plan, chunk, noise=noise, dark=dark)
        found = _Lines.of(other, chunk)
        gain = found.over(lines)
        if gain > _BETTER:
            taken, lines, gained = other, found, gained * gain
    if taken is best:
        return best
    told = (
        f"the laser-off images are {_SAID[taken.dark.source]}: on continuous surfaces this gives "
        f"{min(gained, _MOST_SAID):.1f} times the information that {_SAID[first.source]} gives"
    )
    known = taken.of_frame or best.of_frame
    return dataclasses.replace(taken, chosen=True, of_frame=known, notes=(*(taken.notes or best.notes), told))


class _Lines(NamedTuple):
    """The stripes of the first frames [profiles, lines], one of each line."""

    u: Float[np.ndarray, "profiles lines"]
    valid: Bool[np.ndarray, "profiles lines"]
    step: int
    """Distance of lines that carry the laser's colour."""

    @classmethod
    def of(cls, learned: Learned, first: FrameChunk) -> "_Lines":
        found = []
        for batch in batches(learned.plan.sweep, learned.plan.size, [first]):
            learned = learned.taught_by(batch)
            chunk = learned.find_shared(batch)
            stripes = chosen_of(chunk.stripes, chunk.chosen)
            found.append((np.asarray(stripes.u), np.asarray(stripes.valid)))
        u, valid = (np.concatenate(parts) for parts in zip(*found, strict=True))
        return cls(u, valid, learned.engines[batch.laser].setup.sites.line_step)

    def bends(self) -> tuple[np.ndarray, np.ndarray]:
        """Distances of centres from the middle of those some lines away [px], and where all three are."""
        apart = -(-_APART // self.step) * self.step
        parts = np.s_[:, : -2 * apart], np.s_[:, apart:-apart], np.s_[:, 2 * apart :]
        before, here, after = (self.u[part] for part in parts)
        return here - 0.5 * (before + after), np.logical_and.reduce([self.valid[part] for part in parts])

    def over(self, other: "_Lines") -> float:
        """Straight pieces over their variance, in those of other stripes [1]: bends are compared on the same lines."""
        same = self.valid & other.valid & (np.abs(self.u - other.u) < _SAME_PX)
        (own, whole), (others, there) = self.bends(), other.bends()
        straight = [int(np.count_nonzero(k & (np.abs(b) < _STRAIGHT_PX))) for b, k in ((own, whole), (others, there))]
        shared = self._replace(valid=same).bends()[1]
        # Whatever edges do.
        scatter = [float(np.quantile(np.abs(b[shared]), 0.683)) if shared.any() else 1.0 for b in (own, others)]
        return straight[0] / max(straight[1], 1) * (max(scatter[1], 1e-3) / max(scatter[0], 1e-3)) ** 2


def learn(plan: Plan, first: FrameChunk, *, noise: NoiseModel | None = None, dark: Dark = GIVEN) -> Learned:
    """Learn noise and colours, and where stripes are looked for.

    Args:
        first: Its first `LEARNED_RECORDS`: a fixed number, so that the result does not depend on the size of chunks.
        noise: Noise of a frame; learned where not given.
        dark: Where its laser-off frames come from.

    Raises:
        CaptureError: If a colour cannot be learned, the black level is above the picture, or stripes of two
            lasers in one record could be mistaken for each other.
    """
    sweep, settings, gates = plan.sweep, plan.settings, plan.gates
    lasers, of_frame = learned_lasers(sweep), None
    if noise is None:
        # In the colour of the first laser and the shortest exposure, or of levels the finest that is not clipped.
        room = np.asarray(first.on if first.off is None else first.off)
        one = slice(None) if len(sweep.exposures) == 1 else np.s_[:, clear_level(room) if sweep.bits > 8 else 0]
        on, off = first.on[one], None if first.off is None else first.off[one]
        line, compressed = lasers[int(sweep.laser.min())], sweep.compression is not None
        of_frame = learn_noise(on, off, frames=plan.frames, line=line, compressed=compressed)
        # Each level of frames of more than 8 bits has its own.
        noise = of_frame.noise if sweep.bits == 8 else None
    if plan.lit_together:
        _check_apart(list(gates.values()))
    setups = [
        ExtractionSetup(
            sweep.image_size,
            plan.frames,
            lasers[laser],
            settings.stripes,
            tuple(sweep.exposures),
            0 if sweep.bits > 8 else None,
            all_candidates=settings.check_steps,
        )
        for laser in gates
    ]
    searched = [
        gate if settings.gate or plan.lit_together else whole_lines(setup, gate.near_side)
        for setup, gate in zip(setups, gates.values(), strict=True)
    ]
    try:
        engines = prepare_engines(first.on, first.off, setups, noise=noise, gates=searched)
    except BlackLevelError as problem:
        raise CaptureError(str(problem)) from problem
    if dark.source == "predicted" and sweep.bits == 8:
        # The other channels are subtracted from the laser's, and have no laser-off frames of their own.
        engines = [engine.own_channel() for engine in engines]
    notes = () if of_frame is None else of_frame.doubts
    return Learned(plan, lasers, dict(zip(gates, engines, strict=True)), dark, of_frame=of_frame, notes=notes)


def learned_lasers(sweep: SweepSource) -> tuple[LaserLine, ...]:
    """The lasers of a sweep, an "auto" colour learned from the first records that show the laser alone.

    Raises:
        CaptureError: If a colour cannot be learned.
    """
    lasers = list(sweep.lasers)
    for laser in np.unique(sweep.laser):
        if lasers[laser].colour == "auto":
            lasers[laser] = _with_learned_colour(sweep, int(laser))
    return tuple(lasers)


def _with_learned_colour(sweep: SweepSource, laser: int) -> LaserLine:
    line, problem = sweep.lasers[laser], "it is never lit alone."
    if sweep.pixel_format == "mono8":
        return dataclasses.replace(line, colour="red")
    alone = np.bincount(sweep.record, minlength=len(sweep)) == 1
    for batch in batches(sweep, LEARNED_RECORDS, sweep.chunks(min(LEARNED_RECORDS, len(sweep)))):
        rows = np.flatnonzero(alone[sweep.record[batch.profiles]])
        if batch.laser != laser or not len(rows):
            continue
        on, off = np.asarray(batch.on)[rows], None if batch.off is None else np.asarray(batch.off)[rows]
        if len(sweep.exposures) > 1:
            on, off = on.reshape(-1, *on.shape[2:]), None if off is None else off.reshape(-1, *off.shape[2:])
        try:
            return with_colour(line, on, off, sweep.pixel_format)
        except ValueError as error:
            problem = str(error)
    raise CaptureError(f'The colour of the laser "{line.name}" is "auto" and cannot be learned: {problem}')


def empty_stripes(profiles: int, lines: int) -> dict[str, np.ndarray]:
    """The fields of `Stripes` of a grid, to be filled."""
    types = {"saturated": np.uint8, "valid": np.bool_}
    fields: dict[str, np.ndarray] = {
        name: np.zeros((profiles, lines), types.get(name, np.float32)) for name in KEPT_FIELDS
    }
    return fields | {"rgb": np.zeros((profiles, lines, 3), np.uint8)}


def _ahead(plan: Plan, dark: Dark | None = None) -> tuple[list[FrameChunk], Iterator[FrameChunk]]:
    """Chunks that hold the first `LEARNED_RECORDS`, and those that follow."""
    # Each laser's width and speckle are learned from as many.
    coming = with_off(plan, dark, first=LEARNED_RECORDS * len(np.unique(plan.sweep.laser)))
    ahead = [next(coming)]
    while sum(len(chunk.on) for chunk in ahead) < min(LEARNED_RECORDS, len(plan.sweep)):
        ahead.append(next(coming))
    return ahead, coming


def _first(chunks: Sequence[FrameChunk]) -> FrameChunk:
    """The first `LEARNED_RECORDS`, in whatever chunks they lie."""
    on, off = _joined([chunk.on for chunk in chunks]), [chunk.off for chunk in chunks if chunk.off is not None]
    return FrameChunk(on[:LEARNED_RECORDS], _joined(off)[:LEARNED_RECORDS] if off else None)


def _joined(arrays: Sequence[Array]) -> Array:
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)


def _replayed(ahead: list[FrameChunk], coming: Iterator[FrameChunk]) -> Iterator[FrameChunk]:
    """Chunks that were looked at, which are not kept longer than needed, and those that follow."""
    while ahead:
        yield ahead.pop(0)
    yield from coming


def _check_apart(gates: Sequence[LineGate]) -> None:
    """Lasers that are lit together are told apart only by where they can be seen."""
    for i, one in enumerate(gates):
        for other in gates[i + 1 :]:
            shared = np.minimum(one.high, other.high) - np.maximum(one.low, other.low)
            if np.any(shared > 0):
                raise CaptureError(
                    f"Two lasers that are lit in one record can be seen at the same places (up to {shared.max()} px of "
                    f"a line); narrow min_range_m and max_range_m, or capture a record for each laser."
                )
