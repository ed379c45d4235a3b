"""Ours stage by stage on stacks in memory: what each stage takes, what it touches, and what bounds it."""

from typing import NamedTuple

import numpy as np
from speed_scene import ELECTRONS_PER_DN, HEIGHT, READ_DN, WIDTH, Frames, make_angles
from speed_times import Times, take_turns

from jaxscan.geometry import Scanner
from jaxscan.reconstruction import ReconstructSettings, Sweep, reconstruct
from jaxscan.reconstruction.reconstruct import NOISE_RECORDS
from jaxscan.stripes import NoiseModel, extract_stripes
from jaxscan.stripes.noise import estimate_noise


FRAME = WIDTH * HEIGHT
"""Bytes of a frame."""


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
    found = extract_stripes(frames.on, frames.off, noise=noise)
    first = slice(0, NOISE_RECORDS)
    bare = ReconstructSettings(normals=False)
    runs = {
        "noise, once": lambda: estimate_noise(frames.on[first], frames.off[first]),
        "stripes": lambda: np.asarray(extract_stripes(frames.on, frames.off, noise=noise).u),
        "points": lambda: reconstruct(sweep, scanner, stripes=found, settings=bare),
        "points and normals": lambda: reconstruct(sweep, scanner, stripes=found),
    }
    touched = {
        "noise, once": (2.0 * FRAME * NOISE_RECORDS / pairs, "sorting; a fixed time per sweep, here by its pairs"),
        "stripes": (2.0 * FRAME + 26 * HEIGHT, "arithmetic of the fit"),
        "points": ((13 + 4 * 64 + 40) * HEIGHT, "a cache line of the frame per pixel of the colour"),
        "points and normals": ((13 + 4 * 64 + 40 + 17 + 12) * HEIGHT, "arithmetic of the slopes"),
    }
    times = take_turns(runs, repeats)
    return [Stage(name, Times(*(t / pairs for t in times[name])), *touched[name]) for name in runs]
