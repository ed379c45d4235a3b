"""The stripe engine: learn from the first frames, then frames of one laser to stripes, natively or by XLA."""

import functools
from collections.abc import Sequence

import equinox as eqx
import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import UInt8

from jaxscan.geometry import Array
from jaxscan.stripes.channels import doubted, doubts_of, other_channels
from jaxscan.stripes.choosing import choose_stripes, chosen_of
from jaxscan.stripes.continuation import (
    NOTHING_MORE,
    ChunkStripes,
    Continuation,
    continue_stripes,
    merge_channels,
    padded,
)
from jaxscan.stripes.estimators import Estimator, estimator_of
from jaxscan.stripes.frames import LaserLine, check_black, learn_noise, with_colour
from jaxscan.stripes.search import (
    LEARNED_FRAMES,
    REASONS,
    LineGate,
    Planes,
    Search,
    correct_search,
    host_planes,
    learn_search,
    noise_of,
    prepare_search,
    read_planes,
    whole_lines,
)
from jaxscan.stripes.setup import ExtractionSetup
from jaxscan.stripes.stripes import FrameStripes, NoiseModel


class StripeEngine(eqx.Module):
    """Finds the stripes of one laser in frames of one kind; make it by `prepare_engines`."""

    setup: ExtractionSetup = eqx.field(static=True)
    search: Search
    channels: tuple["StripeEngine", ...] = ()
    """Engines of the other channels, where the laser's own is often clipped."""
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

    def learn(self, on: Array, off: Array | None, then: Continuation = NOTHING_MORE) -> "StripeEngine":
        """The engine that knows width and speckle of the stripes in the first frames, where the settings ask for it.

        Arguments as of `extract`, so that nothing else is compiled.
        """
        if self.channels:
            engines = [one.learn(on, off) for one in (self.own_channel(), *self.channels)]
            found = [one.extract(on, off) for one in engines]
            doubts = doubts_of([chosen_of(one.stripes, one.chosen) for one in found], self.setup.sites.line_step)
            return StripeEngine(self.setup, engines[0].search, tuple(engines[1:]), self.responses, doubts)
        if not self.learns:
            return self
        on, off = on[:LEARNED_FRAMES], None if off is None else off[:LEARNED_FRAMES]
        then = NOTHING_MORE if self.takes_any_number(off) else then
        plain = self.extract(on, off, then)
        first = chosen_of(plain.stripes, plain.chosen)
        search = learn_search(self.search, first, self.setup)
        if search.speckle > self.search.speckle:
            again = StripeEngine(self.setup, search).extract(on, off, then)
            search = correct_search(search, first, chosen_of(again.stripes, again.chosen), self.setup)
        return StripeEngine(self.setup, search)

    def extract(self, on: Array, off: Array | None, then: Continuation = NOTHING_MORE) -> ChunkStripes:
        """Stripes of a chunk of records, a profile for each; with all candidates one for each of them.

        On a CPU an estimator may search natively; elsewhere, and on several devices, all is one
        function of XLA's, the frames shared out among the devices. Single precision throughout, so that
        the result does not depend on the caller's setting.

        Args:
            on: Laser-on frames, uint8 [records, rows, columns] (rgb8: and 3), with a second axis over
                exposures where there are several.
            off: Laser-off frames of the same shape, or None.
            then: Work that is compiled together with it.

        Returns:
            NumPy arrays in memory of their own.
        """
        native, count = self._is_native(off), len(on)
        if then.records and (self.channels or not native):
            on, off = padded(on, then.records), None if off is None else padded(off, then.records)
        if self.channels:
            return _cut(self._of_channels(on, off, then), count, then.records)
        if len(self.setup.exposures) > 1:
            on, off = on.reshape(-1, *on.shape[2:]), None if off is None else off.reshape(-1, *off.shape[2:])
        with jax.enable_x64(False):
            if native and off is not None:
                planes = host_planes(on, off, self.search, self.setup)
                found = compute_natively(self, planes, off, then)
            else:
                found = self._compute(on, off, then)
            return _cut(jax.tree.map(np.asarray, found), count, then.records)

    def takes_any_number(self, off: Array | None) -> bool:
        """Whether nothing is compiled for the number of frames."""
        return self._is_native(off) and not self.channels and len(self.setup.exposures) == 1

    def _is_native(self, off: Array | None) -> bool:
        """Whether stripes are found natively: on a CPU alone, in pairs, by an estimator that can."""
        alone = jax.default_backend() == "cpu" and len(jax.local_devices()) == 1
        return alone and off is not None and self.estimator.find_natively is not None

    def _of_channels(self, on: Array, off: Array | None, then: Continuation) -> ChunkStripes:
        """Of every line the channel in which its stripe is known best."""
        found = [one.extract(on, off) for one in (self.own_channel(), *self.channels)]
        doubts = self.doubts or (0.0,) * len(found)
        parts = [(doubted(one.stripes, found[0].stripes, d), one.chosen) for one, d in zip(found, doubts, strict=True)]
        with jax.enable_x64(False):
            off = off if then.needs_frames else None
            return jax.tree.map(np.asarray, _merge_channels(parts, off, then, self.setup, (1.0, *self.responses)))

    def _compute(self, on: Array, off: Array | None, then: Continuation) -> ChunkStripes:
        devices = jax.local_devices()
        if len(devices) > 1:
            mesh = Mesh(np.array(devices), ("frames",))
            split = NamedSharding(mesh, PartitionSpec("frames"))
            on, off = jax.device_put(on, split), None if off is None else jax.device_put(off, split)
            return _on_devices(mesh, self, on, off, then)
        return _at_once(self, on, off, then)


def _cut(found: ChunkStripes, count: int, records: int) -> ChunkStripes:
    """Of results of so many records those of the first ones."""
    if records <= count:
        return found
    return jax.tree.map(lambda field: field[: len(field) // records * count], found)


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
    if len(setups[0].exposures) > 1:
        on, off = on[:, 0], None if off is None else off[:, 0]
    engines = []
    for setup, gate in zip(setups, gates or [whole_lines(setup) for setup in setups], strict=True):
        estimator_of(setup.settings)
        line = with_colour(setup.line, on, off, setup.frames.pixel_format)
        if noise is None:
            noise = learn_noise(on, off, frames=setup.frames, line=line).noise
        check_black(noise, on, frames=setup.frames, line=line)
        # Lasers that look alike share their compiled functions: no name, and no colour for a mono camera.
        colour = "red" if setup.frames.pixel_format == "mono8" else line.colour
        setup = setup._replace(line=LaserLine(colour=colour, stripe_axis=line.stripe_axis))
        found = other_channels(on, off, setup, gate)
        others = [setup._replace(line=channel.line) for channel in found]
        own, *rest = (
            StripeEngine(one, prepare_search(one, noise, gate, has_off=off is not None)) for one in (setup, *others)
        )
        engines.append(StripeEngine(own.setup, own.search, tuple(rest), tuple(channel.response for channel in found)))
    return engines


def stripes_of_frames(engine: StripeEngine, on: UInt8[Array, "frames ..."], off: Array | None) -> FrameStripes:
    """Stripe centres of a chunk of frames: pure, of static shapes, to be traced in a larger jit.

    Args:
        engine: Setup and search.
        on: Laser-on frames, uint8 [frames, rows, columns] (rgb8: and 3).
        off: Laser-off frames of the same shape, or None.
    """
    return compute_at_once(engine, on, off, NOTHING_MORE).stripes


def compute_at_once(engine: StripeEngine, on: Array, off: Array | None, then: Continuation) -> ChunkStripes:
    """All of it by XLA; pure and traceable. Frames of a record's exposures follow each other."""
    planes = read_planes(on, off, engine.search, engine.setup)
    located = engine.estimator.locate(planes, engine.search, engine.setup)
    return _finish(engine, (located, planes.lamp_ratio), off if then.needs_frames else None, then)


def compute_natively(engine: StripeEngine, planes: Planes, off: Array | None, then: Continuation) -> ChunkStripes:
    """The stripes natively, exposures and the continuation by XLA."""
    find, setup = engine.estimator.find_natively, engine.setup
    if find is None:
        raise ValueError(f"The estimator {setup.settings.estimator!r} has no native code.")
    stripes, chosen = find(planes, engine.search, setup)
    if then is NOTHING_MORE and len(setup.exposures) == 1:
        return ChunkStripes(stripes, chosen, None)
    each = len(stripes.u) // max(len(planes.on), 1)
    records = then.records or len(planes.on) // len(setup.exposures)
    frames = records * len(setup.exposures)
    stripes = FrameStripes(*(padded(field, frames * each) for field in stripes))
    chosen = None if chosen is None else padded(chosen, frames)
    off = padded(off, frames) if then.needs_frames and off is not None else None
    return _from_stripes(stripes, chosen, off, then, setup)


def _finish(engine: StripeEngine, located: tuple, off: Array | None, then: Continuation) -> ChunkStripes:
    """Measure, choose, merge exposures, continue."""
    setup, search = engine.setup, engine.search
    measured = engine.estimator.measure(located[0], located[1], search, setup)
    return continue_stripes(*choose_stripes(measured, search, setup), off, then, setup)


_at_once = jax.jit(compute_at_once)
_from_stripes = jax.jit(continue_stripes, static_argnums=4)
_merge_channels = jax.jit(merge_channels, static_argnums=(3, 4))


@functools.partial(jax.jit, static_argnums=0)
def _on_devices(mesh: Mesh, engine: StripeEngine, on: Array, off: Array | None, then: Continuation) -> ChunkStripes:
    """All local devices take the same number of frames each; no frame needs another one."""
    frames, everywhere = PartitionSpec("frames"), PartitionSpec()
    specs = (
        everywhere,
        frames,
        frames,
        Continuation(then.function, everywhere, frames, then.needs_frames, then.records),
    )
    call = jax.shard_map(compute_at_once, mesh=mesh, in_specs=specs, out_specs=frames, check_vma=False)
    return call(engine, on, off, then)
