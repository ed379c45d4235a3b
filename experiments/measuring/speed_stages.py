"""Our reconstruction stage by stage on stacks in memory: time, memory traffic and bound of each stage.

Each stage of a chunk is called in one thread; a whole reconstruction computes a chunk on every core.
"""

import functools
from typing import Any, NamedTuple

import jax
import numpy as np
from measuring.chunk_stages import STAGES, Chunk, prepare, smooth
from measuring.speed_times import Times, take_turns
from worlds.speed_scene import ELECTRONS_PER_DN, HEIGHT, READ_DN, WIDTH, Frames, make_angles

from jaxscan.geometry import Scanner
from jaxscan.reconstruction import ReconstructSettings, Sweep, extract, reconstruct
from jaxscan.reconstruction.extraction import LEARNED_RECORDS
from jaxscan.stripes import NoiseModel, estimate_noise
from jaxscan.stripes.peaks import CANDIDATES, WINDOW


FRAME = WIDTH * HEIGHT
"""Bytes of a frame."""
CHUNK = 32
PEAK, STRIPE = 17, 34
"""Bytes of a candidate, and of a fitted one."""


class Stage(NamedTuple):
    """A stage of the reconstruction."""

    name: str
    times: Times
    """Of one pair [s]."""
    pair_bytes: float
    """Bytes of a pair that it reads and writes in memory."""
    bound: str
    """The resource that limits it."""


def stages(frames: Frames, scanner: Scanner, repeats: int) -> list[Stage]:
    """Time each stage alone, on the result of the stage before it."""
    pairs = len(frames.on)
    sweep = Sweep(frames.on, frames.off, make_angles(pairs))
    noise = NoiseModel(READ_DN, ELECTRONS_PER_DN)
    found = extract(sweep, scanner, noise=noise).stripes
    first = slice(0, LEARNED_RECORDS)
    runs: dict[str, Any] = {"noise, once": lambda: estimate_noise(frames.on[first], frames.off[first])}
    parts, candidates = chunk_stages(frames, scanner, noise)
    runs |= parts
    runs |= {
        "points, whole sweep": lambda: reconstruct(
            sweep, scanner, stripes=found, settings=ReconstructSettings(normals=False)
        ),
        "points and normals, whole sweep": lambda: reconstruct(sweep, scanner, stripes=found),
    }
    windows, slots = 2.0 * WINDOW * candidates, CANDIDATES * HEIGHT
    touched = {
        "noise, once": (2.0 * FRAME * LEARNED_RECORDS / pairs, "a fixed time per sweep, here by its pairs"),
        "locate (one thread)": (2.0 * FRAME + PEAK * slots, "elementwise arithmetic over the frame"),
        "fit (one thread)": (windows + (PEAK + STRIPE) * slots, "exponentials and sums of the fit"),
        "path over the rows (one thread)": (
            STRIPE * (slots + HEIGHT),
            "one small step after the other, a loop over the rows",
        ),
        "all three (one thread)": (2.0 * FRAME + windows + STRIPE * HEIGHT, "the search and the fit"),
        "smooth (one thread)": (21.0 * HEIGHT, "sums of moments in double precision"),
        "triangulate (one thread)": (40.0 * HEIGHT, "Newton's steps of the lens"),
        "points, whole sweep": (100.0 * HEIGHT, "the smoothing"),
        "points and normals, whole sweep": (160.0 * HEIGHT, "the smoothing"),
    }
    times = take_turns(runs, repeats)
    each = {name: CHUNK if name in parts else pairs for name in runs}
    return [Stage(name, Times(*(t / each[name] for t in times[name])), *touched[name]) for name in runs]


def chunk_stages(frames: Frames, scanner: Scanner, noise: NoiseModel) -> tuple[dict[str, Any], float]:
    """The stages of one chunk, as functions; and the candidates of a pair."""
    chunk = Chunk(frames.on[:CHUNK], frames.off[:CHUNK], make_angles(CHUNK).astype(np.float32))
    job = prepare(chunk, scanner, noise)

    def single(function, *arguments):
        def run():
            with jax.enable_x64(False):
                return jax.block_until_ready(function(*arguments))

        return run

    runs, results, given = {}, {}, None
    resident = jax.device_put((job, chunk))
    for name, stage in STAGES.items():
        runs[name] = single(jax.jit(stage), *resident, given)
        given = results[name] = runs[name]()
    runs["all three"] = single(functools.partial(job.engine.extract, chunk.on, chunk.off))
    runs["smooth"] = single(smooth, jax.tree.map(np.asarray, results["path over the rows"]))
    candidates = float(np.count_nonzero(results["locate"].peaks.exists)) / CHUNK
    order = ("locate", "fit", "path over the rows", "all three", "smooth", "triangulate")
    return {f"{name} (one thread)": runs[name] for name in order}, candidates
