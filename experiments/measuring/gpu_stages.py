"""The stages on an accelerator, for `gpu_speed.py`: candidates, their fits, a path over the rows, points.

Each stage takes the result of the stage before it. Gathering the candidates of each line is timed
with the fit, and taking the chosen ones with the triangulation, so that the path is the choice alone.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int8, UInt8

from jaxscan.geometry import Array, Scanner
from jaxscan.reconstruction import ReconstructSettings, Sweep
from jaxscan.reconstruction.plan import make_plan
from jaxscan.reconstruction.points.colour import stripe_colours
from jaxscan.reconstruction.points.coloured import Coloured, coloured
from jaxscan.reconstruction.points.locate import Aim, Centres, Points, locate_points
from jaxscan.stripes import ChunkStripes, FrameStripes, NoiseModel, StripeEngine
from jaxscan.stripes.choosing.rules import choose
from jaxscan.stripes.engine import compute_at_once, compute_natively
from jaxscan.stripes.fitting.fit_blocks import fit_candidates
from jaxscan.stripes.search.candidates import Located
from jaxscan.stripes.search.locate import locate
from jaxscan.stripes.search.planes import host_planes, read_planes


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

    located: Located
    lamp_ratio: Float[Array, " pairs"]


class Chosen(NamedTuple):
    """Number of the candidate that is the stripe, -1 for none, and the fits of all candidates."""

    number: Int8[Array, "pairs lines"]
    fits: FrameStripes


class Finished(NamedTuple):
    """Points of the chosen candidates, and their colours."""

    stripes: FrameStripes
    points: Points
    rgb: UInt8[Array, "pairs lines 3"]


class Stage(NamedTuple):
    """A stage of a reconstruction."""

    name: str
    run: Callable[..., Any]
    """`run(job, chunk, given)`: `given` is the result of the stage before."""
    is_path: bool = False
    """Whether it is the path over the rows, which is reported separately."""


def prepare(first: Chunk, scanner: Scanner, noise: NoiseModel) -> Job:
    """The engine and aim of a reconstruction of a sweep that starts with these pairs; on the host."""
    chunk = jax.tree.map(np.asarray, first)
    sweep = Sweep(chunk.on, chunk.off, chunk.phi.astype(np.float64))
    plan = make_plan(sweep, scanner, ReconstructSettings(chunk_records=len(chunk.on)))
    job = Job(plan.engines(noise)[0], plan.aim(0))
    with jax.default_device(jax.devices("cpu")[0]):
        return job._replace(engine=job.engine.learn(chunk.on, chunk.off, coloured(plan.frames)))


def to_candidates(job: Job, chunk: Chunk, given: None) -> Found:
    """The highest maxima of every line, and the samples around them."""
    del given
    setup, search = job.engine.setup, job.engine.search
    planes = read_planes(chunk.on, chunk.off, search, setup)
    found = locate(planes, search, pitch=setup.sites.pitch, saturation=setup.settings.saturation)
    return Found(found, planes.lamp_ratio)


def to_fits(job: Job, chunk: Chunk, given: Found) -> FrameStripes:
    """Every candidate fitted and judged: fields [pairs, lines, candidates]."""
    del chunk
    fits = fit_candidates(given.located.lists, given.lamp_ratio, job.engine.search, job.engine.setup)
    slots = given.located.slots
    index = jnp.maximum(slots, 0)
    fits = jax.tree.map(lambda field: field.at[index].get(mode="promise_in_bounds"), fits)
    return fits._replace(valid=fits.valid & (slots >= 0))


def to_path(job: Job, chunk: Chunk, given: FrameStripes) -> Chosen:
    """The best path over the rows."""
    del chunk
    return Chosen(choose(given, job.engine.search.near_side, job.engine.setup.settings), given)


def to_points(job: Job, chunk: Chunk, given: Chosen) -> Finished:
    """Triangulate and colour the chosen candidates."""
    valid: Bool[Array, "pairs lines"] = given.number >= 0

    def taken(field):
        one = jnp.take_along_axis(field, jnp.maximum(given.number, 0).astype(jnp.int32)[:, :, None], 2)[:, :, 0]
        return jnp.where(valid, one, jnp.zeros_like(one))

    stripes, setup = jax.tree.map(taken, given.fits)._replace(valid=valid), job.engine.setup
    axis = setup.line.stripe_axis
    points = locate_points(job.aim, Centres(stripes.u, stripes.sigma, valid), chunk.phi, stripe_axis=axis)
    # The fit knows the grey level already.
    return Finished(stripes, points, stripe_colours(stripes, None, frames=setup.frames, stripe_axis=axis))


STAGES = (
    Stage("locate", to_candidates),
    Stage("fit", to_fits),
    Stage("path over the rows", to_path, is_path=True),
    Stage("triangulate and colour", to_points),
)


def all_of_it(job: Job, chunk: Chunk) -> Finished:
    """All stages in one function, as in a reconstruction on an accelerator."""
    then = coloured(job.engine.setup.frames, job.aim, chunk.phi)
    return _finished(compute_at_once(job.engine, chunk.on, chunk.off, then))


def natively(job: Job, chunk: Chunk) -> Finished:
    """The same on the CPU with the native search, as in a reconstruction there; NumPy arrays."""
    with jax.default_device(jax.devices("cpu")[0]):
        job, chunk = jax.tree.map(np.asarray, (job, chunk))
        then = coloured(job.engine.setup.frames, job.aim, chunk.phi)
        planes = host_planes(chunk.on, chunk.off, job.engine.search, job.engine.setup)
        return _finished(compute_natively(job.engine, planes, None, then))


def _finished(found: ChunkStripes) -> Finished:
    more: Coloured = found.more
    return Finished(found.stripes, cast(Points, more.points), more.rgb)
