"""The stages that run on an accelerator, for `gpu_speed.py`: candidates, their fits, a path over the rows, points.

Each stage takes what the one before it gives. Gathering the candidates of each line belongs to the
fit and taking the chosen ones to the triangulation, so that the path is the choice and nothing else.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxscan.reconstruction.streaming.chunk import (
    Aim,
    ChunkKind,
    ChunkResult,
    _all_in_one,
    _from_located,
    points_of_centres,
)
from jaxscan.stripes.choosing.choose import choose
from jaxscan.stripes.chunk import locate_frames, locate_natively
from jaxscan.stripes.fitting.fits import Fits, fit_candidates
from jaxtyping import Bool, Float, Int8, UInt8

from jaxscan.geometry import Array, Scanner
from jaxscan.reconstruction import ReconstructSettings, Sweep
from jaxscan.reconstruction.plan import make_plan, make_searches
from jaxscan.reconstruction.points.colour import stripe_colours
from jaxscan.reconstruction.points.locate import Points, Rig
from jaxscan.reconstruction.points.triangulate import Limits
from jaxscan.stripes import FrameStripes, NoiseModel
from jaxscan.stripes.search.candidates import Located
from jaxscan.stripes.search.search import Search, learn_search


class Chunk(NamedTuple):
    """Pairs of frames, and the table's angles."""

    on: UInt8[Array, "pairs rows columns"]
    off: UInt8[Array, "pairs rows columns"]
    phi: Float[Array, " pairs"]


class Job(NamedTuple):
    """What every chunk needs beside its frames."""

    search: Search
    rig: Rig


class Found(NamedTuple):
    """Candidates, and the gains of the pairs."""

    located: Located
    gain: Float[Array, " pairs"]


class Chosen(NamedTuple):
    """Which candidate of every line is the stripe, -1 for none, and all of them."""

    number: Int8[Array, "pairs lines"]
    fits: Fits


class Finished(NamedTuple):
    """Points of the chosen candidates, and their colours."""

    stripes: FrameStripes
    points: Points
    rgb: UInt8[Array, "pairs lines 3"]


class Stage(NamedTuple):
    """A part of the way from frames to points."""

    name: str
    run: Callable[..., Any]
    """`run(job, chunk, given, kind)`: `given` is what the stage before returned."""
    is_path: bool = False
    """Whether it is the path over the rows, which is reported apart."""


def prepare(first: Chunk, scanner: Scanner, noise: NoiseModel) -> tuple[Job, ChunkKind]:
    """What a reconstruction of a sweep that starts with these pairs knows before its first chunk; on the host."""
    chunk = jax.tree.map(np.asarray, first)
    sweep = Sweep(chunk.on, chunk.off, chunk.phi.astype(np.float64))
    plan = make_plan(sweep, scanner, ReconstructSettings(chunk_records=len(chunk.on)))
    kind = plan.kind(0)
    job = Job(make_searches(plan, noise)[0], Rig.of(scanner, "rows"))
    learned = learn_search(job.search, natively(job, chunk, kind).stripes)
    return job._replace(search=learned), kind


def to_candidates(job: Job, chunk: Chunk, given: None, kind: ChunkKind) -> Found:
    """The highest maxima of every line, and the samples around them."""
    del given
    return Found(*locate_frames(chunk.on, chunk.off, job.search, **_look(kind)))


def to_fits(job: Job, chunk: Chunk, given: Found, kind: ChunkKind) -> Fits:
    """Every candidate fitted and judged: fields [pairs, lines, candidates]."""
    del chunk
    search = job.search
    fits = fit_candidates(
        given.located.lists,
        given.gain,
        search.read,
        search.gain,
        (search.log_width, search.width_information),
        samples=kind.image_size[0],
        pitch=1,
        response=kind.response,
        settings=kind.stripes,
    )
    slots = given.located.slots
    index = jnp.maximum(slots, 0)
    fits = jax.tree.map(lambda field: field.at[index].get(mode="promise_in_bounds"), fits)
    return fits._replace(valid=fits.valid & (slots >= 0))


def to_path(job: Job, chunk: Chunk, given: Fits, kind: ChunkKind) -> Chosen:
    """The best path over the rows."""
    del chunk
    fields = given.u, given.snr, given.amplitude, given.width, given.valid
    return Chosen(choose(*fields, job.search.near_side, kind.stripes), given)


def to_points(job: Job, chunk: Chunk, given: Chosen, kind: ChunkKind) -> Finished:
    """Triangulate and colour what was chosen."""
    valid: Bool[Array, "pairs lines"] = given.number >= 0

    def taken(field):
        one = jnp.take_along_axis(field, jnp.maximum(given.number, 0).astype(jnp.int32)[:, :, None], 2)[:, :, 0]
        return jnp.where(valid, one, jnp.zeros_like(one))

    fields = {name: taken(getattr(given.fits, name)) for name in FrameStripes._fields if name != "valid"}
    stripes = FrameStripes(**fields, valid=valid)
    points = points_of_centres(stripes.u, stripes.sigma, valid, _aim(job, chunk), stripe_axis=kind.line.stripe_axis)
    how: dict[str, Any] = {"pixel_format": kind.pixel_format, "response": kind.response}
    how["stripe_axis"] = kind.line.stripe_axis
    # The fit knows the grey level already.
    return Finished(stripes, points, stripe_colours(stripes, None, has_off=True, **how))


STAGES = (
    Stage("locate", to_candidates),
    Stage("fit", to_fits),
    Stage("path over the rows", to_path, is_path=True),
    Stage("triangulate and colour", to_points),
)


def all_of_it(job: Job, chunk: Chunk, kind: ChunkKind) -> ChunkResult:
    """All stages in one function, as a reconstruction on an accelerator has them."""
    return _all_in_one(chunk.on, chunk.off, job.search, _aim(job, chunk), kind)


def natively(job: Job, chunk: Chunk, kind: ChunkKind) -> ChunkResult:
    """The same on the CPU, whose search is native, as a reconstruction there has it; NumPy arrays."""
    with jax.default_device(jax.devices("cpu")[0]):
        job, chunk = jax.tree.map(np.asarray, (job, chunk))
        found = locate_natively(chunk.on, chunk.off, job.search, **_look(kind))
        return jax.tree.map(np.array, _from_located(*found, job.search, None, _aim(job, chunk), kind=kind))


def _aim(job: Job, chunk: Chunk) -> Aim:
    return Aim(job.rig, np.asarray(0, np.int32), chunk.phi, Limits.of(ReconstructSettings()))


def _look(kind: ChunkKind) -> dict[str, Any]:
    return {"pixel_format": kind.pixel_format, "line": kind.line, "settings": kind.stripes}
