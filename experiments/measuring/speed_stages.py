"""Ours stage by stage on stacks in memory: what each stage takes, what it touches, and what bounds it.

The stages of a chunk are timed in one thread each on its own; a whole reconstruction computes a
chunk on every core.
"""

import functools
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxscan.reconstruction.streaming.chunk import Aim, points_of_centres
from jaxscan.stripes.choosing.choose import choose
from jaxscan.stripes.chunk import locate_natively, stripes_of_located
from jaxscan.stripes.fitting.fits import Fits, fit_candidates
from measuring.speed_times import Times, take_turns
from worlds.speed_scene import ELECTRONS_PER_DN, HEIGHT, READ_DN, WIDTH, Frames, make_angles

from jaxscan.geometry import Scanner
from jaxscan.reconstruction import ReconstructSettings, Sweep, extract_sweep, reconstruct
from jaxscan.reconstruction.plan import NOISE_RECORDS, make_plan, make_searches
from jaxscan.reconstruction.points.locate import Rig
from jaxscan.reconstruction.points.triangulate import Limits
from jaxscan.stripes import NoiseModel, estimate_noise


FRAME = WIDTH * HEIGHT
"""Bytes of a frame."""
CHUNK = 32


class Stage(NamedTuple):
    """A stage of the reconstruction."""

    name: str
    times: Times
    """Of one pair [s]."""
    pair_bytes: float
    """Bytes of a pair that it reads and writes in memory."""
    bound: str
    """What holds it back."""


def stages(frames: Frames, scanner: Scanner, repeats: int) -> list[Stage]:
    """Every stage by itself, on what the stage before it gives."""
    pairs = len(frames.on)
    sweep = Sweep(frames.on, frames.off, make_angles(pairs))
    noise = NoiseModel(READ_DN, ELECTRONS_PER_DN)
    found = extract_sweep(sweep, scanner, noise=noise)
    first = slice(0, NOISE_RECORDS)
    runs: dict[str, Any] = {"noise, once": lambda: estimate_noise(frames.on[first], frames.off[first])}
    with jax.enable_x64(False):
        parts, candidates = chunk_stages(frames, sweep, scanner, noise)
    runs |= parts
    runs |= {
        "points, whole sweep": lambda: reconstruct(
            sweep, scanner, stripes=found, settings=ReconstructSettings(normals=False)
        ),
        "points and normals, whole sweep": lambda: reconstruct(sweep, scanner, stripes=found),
    }
    # Two windows of float32, of 16 samples for nearly all candidates.
    windows = candidates * 2 * 16 * 4
    touched = {
        "noise, once": (2.0 * FRAME * NOISE_RECORDS / pairs, "a fixed time per sweep, here by its pairs"),
        "locate (native, one thread)": (2.0 * FRAME + windows, "integer arithmetic and branches per candidate"),
        "fit (one thread)": (windows + 40 * candidates, "exponentials and sums of the fit"),
        "path over the rows (one thread)": (3 * 16.0 * HEIGHT, "one small step after the other, a loop over the rows"),
        "fit, path and choice (one thread)": (windows + 100.0 * HEIGHT, "the fit"),
        "triangulate (one thread)": (40.0 * HEIGHT, "Newton's steps of the lens"),
        "points, whole sweep": (80.0 * HEIGHT, "Newton's steps of the lens"),
        "points and normals, whole sweep": (140.0 * HEIGHT, "arithmetic of the slopes"),
    }
    times = take_turns(runs, repeats)
    each = {name: CHUNK if name in parts else pairs for name in runs}
    return [Stage(name, Times(*(t / each[name] for t in times[name])), *touched[name]) for name in runs]


def chunk_stages(frames: Frames, sweep: Sweep, scanner: Scanner, noise: NoiseModel) -> tuple[dict[str, Any], float]:
    """The stages of one chunk, as functions; and the candidates of a pair."""
    plan = make_plan(sweep, scanner, ReconstructSettings(chunk_records=CHUNK))
    kind, search = plan.kind(0), make_searches(plan, noise)[0]
    settings = kind.stripes
    how = {"pixel_format": kind.pixel_format, "response": kind.response, "line": kind.line, "settings": settings}
    on, off = frames.on[:CHUNK], frames.off[:CHUNK]
    look = {"pixel_format": kind.pixel_format, "line": kind.line, "settings": settings}
    located, gain = jax.tree.map(np.copy, locate_natively(on, off, search, **look))
    fit = jax.jit(functools.partial(fit_candidates, samples=WIDTH, pitch=1, response="linear", settings=settings))
    prior = search.log_width, search.width_information
    fits = fit(located.lists, gain, search.read, search.gain, prior)

    @jax.jit
    def path(fits: Fits, slots: np.ndarray):
        index = jax.numpy.maximum(slots, 0)
        u, snr, amplitude, width, valid = (
            getattr(fits, name)[index] for name in ("u", "snr", "amplitude", "width", "valid")
        )
        return choose(u, snr, amplitude, width, valid & (slots >= 0), search.near_side, settings)

    stripes = jax.jit(functools.partial(stripes_of_located, image_size=(WIDTH, HEIGHT), **how))
    found = stripes(located, gain, search)
    aim = Aim(
        Rig.of(scanner, "rows"), np.asarray(0, np.int32), np.zeros(CHUNK, np.float32), Limits.of(ReconstructSettings())
    )
    points = jax.jit(functools.partial(points_of_centres, stripe_axis=kind.line.stripe_axis))

    def single(function, *arguments):
        def run():
            with jax.enable_x64(False):
                return jax.block_until_ready(function(*arguments))

        return run

    runs = {
        "locate (native, one thread)": single(functools.partial(locate_natively, **look), on, off, search),
        "fit (one thread)": single(fit, located.lists, gain, search.read, search.gain, prior),
        "path over the rows (one thread)": single(path, fits, located.slots),
        "fit, path and choice (one thread)": single(stripes, located, gain, search),
        "triangulate (one thread)": single(points, found.u, found.sigma, found.valid, aim),
    }
    return runs, sum(int(one.total) for one in located.lists) / CHUNK
