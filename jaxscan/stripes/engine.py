"""The stripe engine: learn from the first frames, then stacks of frames of one laser to stripes.

All of it is one function that is compiled once for a stack of so many frames; fewer are filled up and cost nothing. On
a CPU it goes from frame to frame, so that everything of a frame stays in a core's cache, and callers hand stacks to
several threads; on an accelerator it takes several frames at a time.
"""

import functools
import itertools
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Bool, Float, Int, Int8, UInt8

from jaxscan.compiling import compile_wide
from jaxscan.geometry import Array, StripeAxis
from jaxscan.stripes.channels import doubted, doubts_of, other_channels
from jaxscan.stripes.choose import choose_stripes, chosen_of, on_image_lines
from jaxscan.stripes.estimators import ESTIMATORS, Estimator, estimator_of
from jaxscan.stripes.exposures import merge_exposures
from jaxscan.stripes.faint import Look, with_faint
from jaxscan.stripes.frames import (
    Colour,
    LaserLine,
    PixelFormat,
    applied_ratio,
    check_black,
    clear_level,
    lamp_ratio,
    laser_sites,
    learn_noise,
    with_colour,
)
from jaxscan.stripes.planes import Plane, plane_of
from jaxscan.stripes.search import (
    LEARNED_FRAMES,
    ExtractionSetup,
    LineGate,
    Search,
    correct_search,
    learn_search,
    noise_of,
    prepare_search,
    whole_lines,
)
from jaxscan.stripes.speckle import REASONS
from jaxscan.stripes.stripes import Choice, FrameStripes, NoiseModel


_LOOKS = (32, 80)
"""Lines and samples of a frame from which the brightness of a pair is compared."""
_AT_ONCE = 32
"""Frames that an accelerator takes at a time: of an H200, 8 took a seventh longer, and 64 were no faster."""
_ALIGNED, _BEFORE = 64, 16
"""Addresses from which on JAX takes memory without a copy on a CPU are multiples of the first; NumPy's own arrays begin
so many bytes behind one [bytes]."""


class ChunkStripes(NamedTuple):
    """Stripes of a chunk of records."""

    stripes: FrameStripes
    chosen: Int8[Array, "records lines"] | None
    """Which of several candidates of every line is the stripe, -1 for none; None where there is one candidate alone."""


class StripeEngine(eqx.Module):
    """Finds the stripes of one laser in frames of one kind; make it by `prepare_engines`."""

    setup: ExtractionSetup = eqx.field(static=True)
    search: Search
    channels: tuple["StripeEngine", ...] = ()
    """Engines of the other channels, where the laser's own is often clipped; or of the other levels of frames of more
    than 8 bits."""
    responses: tuple[float, ...] = eqx.field(static=True, default=())
    """Light of the laser in each of them, in that of its own channel [1]."""
    doubts: tuple[float, ...] = ()
    """Variances that the centres of all channels, the own first, have beyond their own [px^2]."""

    def own_channel(self) -> "StripeEngine":
        """The engine of the laser's own channel alone: the others are not predicted well enough to be searched."""
        return StripeEngine(self.setup, self.search)

    @property
    def estimator(self) -> Estimator:
        return estimator_of(self.setup.settings)

    @property
    def learns(self) -> bool:
        """Whether something is to be learned from the first frames' stripes."""
        settings = self.setup.settings
        asked = settings.learn_width or (settings.speckle is None and not self.search.speckle)
        return self.estimator.learns and asked

    @property
    def speckle_reason(self) -> str:
        """Why the contrast of speckle is as it is."""
        if self.setup.settings.speckle is not None:
            return f"set to {self.setup.settings.speckle:g}"
        return REASONS[int(self.search.speckle_reason)] if self.estimator.learns else "the estimator does not tell it"

    @property
    def noise(self) -> NoiseModel:
        """Noise of a frame, with the learned speckle."""
        return noise_of(self.search)

    @property
    def profiles_per_record(self) -> int:
        return self.estimator.candidates if self.setup.several else 1

    def learn(
        self,
        on: Array,
        off: Array | None,
        records: int = 0,
        telling: Callable[[FrameStripes], Bool[np.ndarray, "frames lines"]] | None = None,
    ) -> "StripeEngine":
        """The engine that knows width and speckle of the stripes in the first frames, where the settings ask for it.

        Arguments as of `extract`, so that nothing else is compiled.

        Args:
            on: As of `extract`.
            off: As of `extract`.
            records: As of `extract`.
            telling: Which of the stripes tell it; all where not given. The contrast is then that of the light, and not
                corrected to the scatter of these fits.
        """
        if self.channels:
            engines = [one.learn(on, off, records, telling) for one in (self.own_channel(), *self.channels)]
            if self.setup.level is not None:
                # All levels are of the same light.
                return StripeEngine(self.setup, engines[0].search, tuple(engines[1:]), self.responses)
            found = [one.extract_shared(on, off, records) for one in engines]
            doubts = doubts_of([chosen_of(one.stripes, one.chosen) for one in found], self.setup.sites.line_step)
            return StripeEngine(self.setup, engines[0].search, tuple(engines[1:]), self.responses, doubts)
        if not self.learns:
            return self
        records = max(records, len(on))
        on, off = on[:LEARNED_FRAMES], None if off is None else off[:LEARNED_FRAMES]
        plain = self.extract_shared(on, off, records)
        first = chosen_of(plain.stripes, plain.chosen)
        first = first if telling is None else first._replace(valid=np.asarray(first.valid) & telling(first))
        search = learn_search(self.search, first, self.setup)
        if telling is None and search.speckle > self.search.speckle:
            again = StripeEngine(self.setup, search).extract_shared(on, off, records)
            search = correct_search(search, first, chosen_of(again.stripes, again.chosen), self.setup)
        return StripeEngine(self.setup, search)

    def extract(self, on: Array, off: Array | None, records: int = 0) -> ChunkStripes:
        """Stripes of a chunk of records, a profile for each; with all candidates one for each of them.

        Single precision throughout, so that the result does not depend on the caller's setting.

        Args:
            on: Laser-on frames, uint8 [records, rows, columns] (rgb8: and 3), with a second axis over exposures where
                there are several.
            off: Laser-off frames of the same shape, or None.
            records: Records that the function is compiled for, at least as many as there are.

        Returns:
            NumPy arrays in memory of their own.
        """
        if self.channels:
            return self._of_channels(on, off, records)
        if (level := self.setup.level) is not None:
            of_level = StripeEngine(self.setup._replace(level=None), self.search)
            return of_level.extract(on[:, level], None if off is None else off[:, level], records)
        count, exposures = len(on), len(self.setup.exposures)
        room = max(records, count)
        kind = _Kind.of(self.setup, on.shape[1 + (exposures > 1) :])
        pair = [None if frames is None else _bytes_around(frames, room) for frames in (on, off)]
        if count > 1 and pair[0] is None and _bytes_around(on[1:], room) is not None:
            # The first frame of a large array alone has to be copied.
            parts = [self.extract(on[k], None if off is None else off[k], room) for k in (np.s_[:1], np.s_[1:])]
            return jax.tree.map(lambda *fields: np.concatenate(fields), *parts)
        stacks = [
            None if frames is None else found or _copied(frames, room)
            for frames, found in zip((on, off), pair, strict=True)
        ]
        with jax.enable_x64(False):
            found = _extracted(*stacks, np.int32(count * exposures), self.search, kind, room * exposures)
            found = jax.tree.map(np.asarray, found)
        return jax.tree.map(lambda field: field[: len(field) // room * count], found)

    def extract_shared(self, on: Array, off: Array | None, records: int = 0) -> ChunkStripes:
        """Like `extract`, but divides the records among a CPU's cores, for a caller that has no other work for them."""
        cores = min(os.cpu_count() or 1, len(on)) if jax.default_backend() == "cpu" else 1
        ends = np.linspace(0, len(on), cores + 1).astype(int).tolist()
        parts = [np.s_[a:b] for a, b in itertools.pairwise(ends)]
        room = max(records, len(on))
        with ThreadPoolExecutor(cores) as pool:
            found = pool.map(lambda k: self.extract(on[k], None if off is None else off[k], room), parts)
            return jax.tree.map(lambda *fields: np.concatenate(fields), *found)

    def lamp_ratios(
        self, on: UInt8[Array, "frames lines samples"], off: UInt8[Array, "frames lines samples"]
    ) -> Float[np.ndarray, " frames"]:
        """Factors by which the light of the laser-off planes is multiplied before it is subtracted [1]."""
        with jax.enable_x64(False):
            found = lamp_ratio(*sample_pair(on, off), self.search.read_dn, self.search.electrons_per_dn)
            return np.asarray(applied_ratio(found), np.float32)

    def _of_channels(self, on: Array, off: Array | None, records: int) -> ChunkStripes:
        """Stripes that take every line from the channel in which it is known best."""
        found = [one.extract(on, off, records) for one in (self.own_channel(), *self.channels)]
        doubts = self.doubts or (0.0,) * len(found)
        parts = [(doubted(one.stripes, found[0].stripes, d), one.chosen) for one, d in zip(found, doubts, strict=True)]
        each = self.profiles_per_record

        def together(fields: Sequence[Array], each: int) -> np.ndarray:
            # [channels][records * each, lines] to [records * channels * each, lines].
            lines = fields[0].shape[1]
            return np.stack([np.asarray(field).reshape(-1, each, lines) for field in fields], 1).reshape(-1, lines)

        stripes = jax.tree.map(lambda *fields: together(fields, each), *(one for one, _ in parts))
        numbers = [number for _, number in parts if number is not None]
        chosen = together(numbers, 1) if numbers else None
        # Channels are chosen like exposures; amplitudes are as the first one sees them.
        with jax.enable_x64(False):
            merged = merge_exposures(stripes, chosen, (1.0, *self.responses), each)
            return ChunkStripes(*jax.tree.map(np.asarray, merged))


class _Kind(NamedTuple):
    """All that the function is compiled for beside sizes: no name, no number of the settings."""

    shape: tuple[int, ...]
    """Shape of a frame."""
    pixel_format: PixelFormat
    colour: Colour
    stripe_axis: StripeAxis
    linear: bool
    estimator: str
    choice: Choice
    exposures: tuple[float, ...]
    several: bool
    faint: bool

    @classmethod
    def of(cls, setup: ExtractionSetup, shape: tuple[int, ...]) -> "_Kind":
        frames, line = setup.frames, setup.line
        # For a mono camera the colour means nothing.
        colour: Any = "red" if frames.pixel_format == "mono8" else line.colour
        settings = setup.settings
        return cls(
            tuple(int(size) for size in shape),
            frames.pixel_format,
            colour,
            line.stripe_axis,
            frames.response == "linear",
            settings.estimator,
            settings.choice,
            setup.exposures,
            setup.several,
            setup.faint and ESTIMATORS[settings.estimator].faint and settings.choice == "path",
        )

    @property
    def line(self) -> LaserLine:
        return LaserLine(colour=self.colour, stripe_axis=self.stripe_axis)


class _Stack(NamedTuple):
    """Bytes that hold a chunk of frames."""

    bytes: UInt8[Array, " bytes"]
    start: Int[Array, ""]
    """Where the first frame begins."""


def _bytes_around(frames: Array, records: int) -> _Stack | None:
    """A piece of the array that frames are cut out of, which JAX takes without a copy; None where there is none."""
    if not isinstance(frames, np.ndarray):
        return None
    owner = frames
    while isinstance(owner.base, np.ndarray) and owner.base.dtype == np.uint8:
        owner = owner.base
    if not (frames.flags.c_contiguous and owner.flags.c_contiguous):
        return None
    size = records * (frames.nbytes // len(frames)) + _BEFORE
    at = frames.ctypes.data - owner.ctypes.data
    # From the last aligned address before the frames on; earlier, where the array ends too soon.
    first = min(at, owner.nbytes - size)
    first -= (owner.ctypes.data + first) % _ALIGNED
    if first < 0 or first + size < at + frames.nbytes:
        return None
    return _Stack(owner.reshape(-1)[first : first + size], np.asarray(at - first, np.int32))


def _copied(frames: Array, records: int) -> _Stack:
    """The bytes of frames in memory of their own, with room for so many records."""
    if not isinstance(frames, np.ndarray):
        size = (records - len(frames)) * int(np.prod(frames.shape[1:])) + _BEFORE
        return _Stack(jnp.pad(jnp.asarray(frames).reshape(-1), (0, size)), np.asarray(0, np.int32))
    size = records * (frames.nbytes // len(frames)) + _BEFORE
    # Memory that is not touched costs nothing.
    memory = np.zeros(size + _ALIGNED, np.uint8)
    first = -memory.ctypes.data % _ALIGNED
    memory[first : first + frames.nbytes] = frames.reshape(-1)
    return _Stack(memory[first : first + size], np.asarray(0, np.int32))


def _of_stack(on: _Stack, off: _Stack | None, count: Array, search: Search, kind: _Kind, frames: int) -> ChunkStripes:
    """Stripes of the first `count` frames of a stack; frames of a record's exposures follow each other."""
    estimator, size = ESTIMATORS[kind.estimator], int(np.prod(kind.shape))
    sites = laser_sites(kind.pixel_format, kind.line)

    def planes(k: Array) -> tuple[Plane, Plane | None, Array]:
        cut = lambda stack: plane_of(stack.bytes, stack.start + k * size, kind.shape, kind.pixel_format, kind.line)
        lit, dark = cut(on), None if off is None else cut(off)
        return lit, dark, jnp.float32(1.0) if dark is None else _ratio(lit.samples, dark.samples, search)

    every = functools.partial(_of_frames, count=count, frames=frames)
    offsets = np.asarray(sites.offsets, np.float32)

    def measured_by(look: Callable[[Array], Look | None] = lambda k: None) -> FrameStripes:
        found = every(lambda k: estimator.measure(*planes(k), search, sites, kind.linear, look(k)))
        shifted = found.u + offsets[np.arange(found.u.shape[2]) % len(offsets)][None, None]
        return found._replace(u=jnp.where(found.valid, shifted, 0.0))

    if kind.faint:
        shapes = jax.eval_shape(measured_by)
        nothing = jax.tree.map(lambda field: jnp.zeros(field.shape, field.dtype), shapes)
        none = jnp.full((frames, nothing.u.shape[2]), -1, jnp.int8)

        def look(again: Array, known: tuple[FrameStripes, Array]) -> tuple[FrameStripes, Array]:
            found = measured_by(lambda k: Look(again > 0, known[1][k] < 0))
            first = lambda: (found, choose_stripes(found, search, kind.choice))
            return lax.cond(again > 0, lambda: with_faint(*known, found), first)

        measured, number = lax.fori_loop(0, 2, look, (nothing, none))
    else:
        measured = measured_by()
        number = choose_stripes(measured, search, kind.choice)
    lines = kind.shape[0] if kind.stripe_axis == "rows" else kind.shape[1]
    stripes, chosen = on_image_lines(measured, number, sites, lines, several=kind.several)
    if len(kind.exposures) > 1:
        each = estimator.candidates if kind.several else 1
        stripes, chosen = merge_exposures(stripes, chosen, kind.exposures, each)
    return ChunkStripes(stripes, chosen)


def _of_frames(of_frame: Callable[[Array], FrameStripes], *, count: Array, frames: int) -> FrameStripes:
    """What the first `count` of so many frames give, by their number; zeros for the others."""
    if jax.default_backend() != "cpu":
        return lax.map(of_frame, jnp.arange(frames, dtype=jnp.int32), batch_size=min(_AT_ONCE, frames))
    shapes = jax.eval_shape(of_frame, jnp.int32(0))
    nothing = jax.tree.map(lambda field: jnp.zeros((frames, *field.shape), field.dtype), shapes)

    def put(k, found):
        return jax.tree.map(lambda all, one: lax.dynamic_update_index_in_dim(all, one, k, 0), found, of_frame(k))

    return lax.fori_loop(0, jnp.clip(count, 0, frames), put, nothing)


_extracted = compile_wide(_of_stack, static=("kind", "frames"), sooner=True)


def _ratio(on: UInt8[Array, "lines samples"], off: UInt8[Array, "lines samples"], search: Search) -> Array:
    """Factor by which the light of a frame's laser-off image is multiplied [1]."""
    pair = lamp_ratio(*sample_pair(on[None], off[None]), search.read_dn, search.electrons_per_dn)
    return applied_ratio(pair).astype(jnp.float32)[0]


def sample_pair(on: Array, off: Array) -> tuple[Array, Array]:
    """A lattice of pixels of every frame's plane, uint8 [frames, n], for `lamp_ratio`."""
    steps = [max(1, size // looks) for size, looks in zip(on.shape[1:], _LOOKS, strict=True)]
    first, second = (frames[:, :: steps[0], :: steps[1]] for frames in (on, off))
    return first.reshape(len(on), -1), second.reshape(len(on), -1)


def prepare_engines(
    on: Array,
    off: Array | None,
    setups: Sequence[ExtractionSetup],
    *,
    noise: NoiseModel | None = None,
    gates: Sequence[LineGate] | None = None,
) -> list[StripeEngine]:
    """An engine for each laser, from the first frames.

    Args:
        on: Laser-on frames of the first records, as of `StripeEngine.extract`.
        off: Laser-off frames of the same shape, or None.
        setups: Of each laser; a colour "auto" is learned from the frames.
        noise: Noise of a frame; where not given it is learned (`learn_noise`), in the colour of the first laser and in
            the shortest exposure, in which least is clipped.
        gates: The part of every line that can hold the stripe of each laser; the whole line where not given.

    Raises:
        ValueError: If the colour cannot be learned, the black level is above the picture, or the settings ask for a
            choice that the estimator or the gate do not allow.
    """
    gates = gates or [whole_lines(setup) for setup in setups]
    if setups[0].level is not None:
        return [_engine_of_levels(on, off, setup, noise, gate) for setup, gate in zip(setups, gates, strict=True)]
    if len(setups[0].exposures) > 1:
        on, off = on[:, 0], None if off is None else off[:, 0]
    engines = []
    for setup, gate in zip(setups, gates, strict=True):
        estimator_of(setup.settings)
        line = with_colour(setup.line, on, off, setup.frames.pixel_format)
        if noise is None:
            noise = learn_noise(on, off, frames=setup.frames, line=line).noise
        check_black(noise, on, frames=setup.frames, line=line)
        setup = setup._replace(line=line)
        found = other_channels(on, off, setup, gate)
        others = [setup._replace(line=channel.line) for channel in found]
        own, *rest = (
            StripeEngine(one, prepare_search(one, noise, gate, has_off=off is not None)) for one in (setup, *others)
        )
        engines.append(StripeEngine(own.setup, own.search, tuple(rest), tuple(channel.response for channel in found)))
    return engines


def _engine_of_levels(
    on: Array, off: Array | None, setup: ExtractionSetup, noise: NoiseModel | None, gate: LineGate
) -> StripeEngine:
    """An engine for each level of frames of more than 8 bits, the first for all of their range."""
    estimator_of(setup.settings)
    pairs = [(on[:, k], None if off is None else off[:, k]) for k in range(len(setup.exposures))]
    line = with_colour(setup.line, *pairs[0], setup.frames.pixel_format)
    relative = tuple(exposure / setup.exposures[0] for exposure in setup.exposures)
    if noise is None:
        noises = _noise_of_levels(pairs, relative, setup, line, clear_level(np.asarray(on if off is None else off)))
    else:
        noises = [noise.in_finer_steps(finer) for finer in relative]
    engines: list[StripeEngine] = []
    for level, (one, (lit, _)) in enumerate(zip(noises, pairs, strict=True)):
        check_black(one, lit, frames=setup.frames, line=line)
        own = setup._replace(line=line, exposures=(1.0,), level=level)
        engines.append(StripeEngine(own, prepare_search(own, one, gate, has_off=off is not None)))
    return StripeEngine(engines[0].setup, engines[0].search, tuple(engines[1:]), relative[1:])


def _noise_of_levels(
    pairs: Sequence[tuple[Array, Array | None]],
    relative: Sequence[float],
    setup: ExtractionSetup,
    line: LaserLine,
    clear: int,
) -> list[NoiseModel]:
    """The noise of each level; `clear` is the last level that is not clipped.

    An exposure has the camera's noise at each of its levels; these have that of the same electrons in other steps. So
    each learns its own; one that is too dark or clipped to show it takes that of the nearest other one.
    """
    learned = [learn_noise(*pair, frames=setup.frames, line=line) for pair in pairs]
    told = [k for k, one in enumerate(learned) if one.gain_told] or [clear]
    # If two are equally near, the finer one is taken: rounding hides less of its noise.
    nearest = [min((abs(other - k), -other, other) for other in told)[2] for k in range(len(pairs))]
    return [learned[of].noise.in_finer_steps(relative[k] / relative[of]) for k, of in enumerate(nearest)]


def stripes_of_frames(engine: StripeEngine, on: UInt8[Array, "frames ..."], off: Array | None) -> FrameStripes:
    """Stripe centres of a chunk of frames: pure, of static shapes, to be traced in a larger jit.

    Args:
        on: Laser-on frames, uint8 [frames, rows, columns] (rgb8: and 3).
        off: Laser-off frames of the same shape, or None.
    """
    kind = _Kind.of(engine.setup, on.shape[1:])
    stack = lambda frames: _Stack(frames.reshape(-1), jnp.int32(0))
    return _of_stack(
        stack(on), None if off is None else stack(off), jnp.int32(len(on)), engine.search, kind, len(on)
    ).stripes
