"""The stages of a chunk, each a function of its own: candidates, their fits, a path over the rows, points.

Each takes the result of the stage before it, so that results go through memory. As in `StripeEngine` a CPU takes one
frame after the other and an accelerator several at a time. Smoothing is no part of the chain: it has to see a sweep.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float, UInt8

from jaxscan.geometry import Array, Scanner
from jaxscan.reconstruction import FrameChunk, ReconstructSettings, Sweep, plan_sweep
from jaxscan.reconstruction.extraction import LEARNED_RECORDS, learn
from jaxscan.reconstruction.points import Aim, Centres, Points, locate_points
from jaxscan.reconstruction.sweep import Batch
from jaxscan.stripes import FrameStripes, NoiseModel, Smoothed, StripeEngine, smooth_profiles, stripes_of_frames
from jaxscan.stripes.choose import choose_stripes
from jaxscan.stripes.engine import sample_pair
from jaxscan.stripes.fit import fit_peaks
from jaxscan.stripes.frames import applied_ratio, lamp_ratio
from jaxscan.stripes.peaks import Peaks, find_peaks
from jaxscan.stripes.planes import Plane, plane_of


AT_ONCE = 8
"""Frames that an accelerator takes at a time, as in `StripeEngine`."""


class Chunk(NamedTuple):
    """Pairs of frames, and the table's angles."""

    on: UInt8[Array, "pairs rows columns"]
    off: UInt8[Array, "pairs rows columns"]
    phi: Float[Array, " pairs"]


class Job(NamedTuple):
    """Shared by all chunks."""

    engine: StripeEngine
    aim: Aim


class Found(NamedTuple):
    """Candidates, and the lamp ratios of the pairs."""

    peaks: Peaks
    lamp_ratio: Float[Array, " pairs"]


class Finished(NamedTuple):
    """Stripes and their points."""

    stripes: FrameStripes
    points: Points


def prepare(first: Chunk, scanner: Scanner, noise: NoiseModel) -> Job:
    """The engine and aim of a reconstruction of a sweep that starts with these pairs; computed on the CPU."""
    chunk = jax.tree.map(np.asarray, first)
    sweep = Sweep(chunk.on, chunk.off, chunk.phi.astype(np.float64))
    plan = plan_sweep(sweep, scanner, ReconstructSettings(chunk_records=len(chunk.on)))
    start, whole = FrameChunk(*(frames[:LEARNED_RECORDS] for frames in chunk[:2])), np.arange(len(chunk.on))
    with jax.default_device(jax.devices("cpu")[0]):
        learned = learn(plan, start, noise=noise).taught_by(Batch(whole, 0, chunk.on, chunk.off))
        return Job(learned.engines[0], Aim.of(scanner, plan.settings, plan.stripe_axis))


def to_peaks(job: Job, chunk: Chunk, given: None) -> Found:
    """The candidates of every line."""
    del given
    (setup, search), pitch = (job.engine.setup, job.engine.search), job.engine.setup.sites.pitch
    pair = sample_pair(setup.plane(chunk.on), setup.plane(chunk.off))
    ratio = applied_ratio(lamp_ratio(*pair, search.read_dn, search.electrons_per_dn)).astype(jnp.float32)

    def of_frame(on: Plane, off: Plane, ratio: Array) -> Peaks:
        return find_peaks(on, off, ratio, search.low, search.high, search.thresholds, pitch=pitch)

    return Found(_over_frames(job, chunk, of_frame, ratio), ratio)


def to_fits(job: Job, chunk: Chunk, given: Found) -> FrameStripes:
    """Every candidate fitted and judged: fields [pairs, candidates, lines]."""
    setup, search = job.engine.setup, job.engine.search
    pitch, linear = setup.sites.pitch, setup.frames.response == "linear"

    def of_frame(on: Plane, off: Plane, given: Found) -> FrameStripes:
        return fit_peaks(on, off, given.lamp_ratio, given.peaks, search, pitch=pitch, linear=linear)

    return _over_frames(job, chunk, of_frame, given)


def to_path(job: Job, chunk: Chunk, given: FrameStripes) -> FrameStripes:
    """The candidates on the best path over the rows."""
    del chunk
    setup, search = job.engine.setup, job.engine.search
    return choose_stripes(given, search, setup.settings.choice, setup.sites, setup.image_lines, several=False)[0]


def to_points(job: Job, chunk: Chunk, given: FrameStripes) -> Finished:
    """Triangulate the stripes."""
    axis = job.engine.setup.line.stripe_axis
    centres = Centres(given.u, given.sigma, given.valid)
    return Finished(given, locate_points(job.aim, centres, chunk.phi, stripe_axis=axis)[0])


def smooth(stripes: FrameStripes) -> Smoothed:
    """Smooth the centres along the stripe, as a reconstruction does before it triangulates; NumPy arrays."""
    return smooth_profiles(np.asarray(stripes.u), np.asarray(stripes.sigma), np.asarray(stripes.valid))


STAGES: dict[str, Callable[..., Any]] = {
    "locate": to_peaks,
    "fit": to_fits,
    "path over the rows": to_path,
    "triangulate": to_points,
}
"""In their order; called with the job, the chunk, and the result of the stage before."""


def all_of_it(job: Job, chunk: Chunk) -> Finished:
    """All stages in one function."""
    return to_points(job, chunk, stripes_of_frames(job.engine, chunk.on, chunk.off))


def _over_frames(job: Job, chunk: Chunk, function: Callable[..., Any], given: Any) -> Any:
    """`function(on, off, given)` of the planes of every pair, and of what the stage before gave for it."""
    setup, shape = job.engine.setup, chunk.on.shape[1:]
    on, off = chunk.on.reshape(-1), chunk.off.reshape(-1)

    def of_frame(item: tuple[Array, Any]) -> Any:
        start = item[0] * int(np.prod(shape))
        cut = lambda stack: plane_of(stack, start, shape, setup.frames.pixel_format, setup.line)
        return function(cut(on), cut(off), item[1])

    count = len(chunk.on)
    batch = None if jax.default_backend() == "cpu" else min(AT_ONCE, count)
    return lax.map(of_frame, (jnp.arange(count, dtype=jnp.int32), given), batch_size=batch)
