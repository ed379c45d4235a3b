"""Our reconstruction stage by stage on stacks in memory: time, memory traffic and bound of each stage.

Each stage of a chunk is timed alone in one thread; a whole reconstruction computes a chunk on
every core.
"""

import functools
from typing import Any, NamedTuple

import jax
import numpy as np
from measuring.speed_times import Times, take_turns
from worlds.speed_scene import ELECTRONS_PER_DN, HEIGHT, READ_DN, WIDTH, Frames, make_angles

from jaxscan.geometry import Scanner
from jaxscan.reconstruction import ReconstructSettings, Sweep, extract_sweep, reconstruct
from jaxscan.reconstruction.plan import NOISE_RECORDS, make_plan
from jaxscan.reconstruction.points.locate import Centres, points_alone
from jaxscan.stripes import NoiseModel, estimate_noise
from jaxscan.stripes.choosing.native import ChosenLines
from jaxscan.stripes.fitting.native import NativeFitter
from jaxscan.stripes.search.native import NativeLocator
from jaxscan.stripes.search.planes import host_planes


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
    """The resource that limits it."""


def stages(frames: Frames, scanner: Scanner, repeats: int) -> list[Stage]:
    """Time each stage alone, on the result of the stage before it."""
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
        "all three (one thread)": (2.0 * FRAME + 100.0 * HEIGHT, "the search"),
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
    engine = plan.engines(noise)[0]
    setup, search, estimator = engine.setup, engine.search, engine.estimator
    on, off = frames.on[:CHUNK], frames.off[:CHUNK]

    locator, fitter = NativeLocator(), NativeFitter()

    def locate():
        planes = host_planes(on, off, search, setup)
        return locator.locate(planes, search, pitch=setup.sites.pitch, saturation=setup.settings.saturation)

    def choose():
        chosen = ChosenLines(CHUNK, estimator.candidates, search, setup)
        chosen.put(0, fits)
        return chosen.stripes

    def every_step():
        return estimator.find_natively(host_planes(on, off, search, setup), search, setup).stripes

    ratio = np.asarray(host_planes(on, off, search, setup).lamp_ratio)
    located, found = locate(), every_step()
    fits = fitter.fit(located, ratio, search, setup)
    centres = Centres(found.u, found.sigma, found.valid)
    points = functools.partial(points_alone, stripe_axis=setup.line.stripe_axis)

    def single(function, *arguments):
        def run():
            with jax.enable_x64(False):
                return jax.block_until_ready(function(*arguments))

        return run

    runs = {
        "locate (native, one thread)": single(locate),
        "fit (one thread)": single(fitter.fit, located, ratio, search, setup),
        "path over the rows (one thread)": single(choose),
        "all three (one thread)": single(every_step),
        "triangulate (one thread)": single(points, plan.aim(0), centres, np.zeros(CHUNK, np.float32)),
    }
    return runs, sum(int(one.total) for one in located.lists) / CHUNK
