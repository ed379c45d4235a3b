"""Ours stage by stage on stacks in memory: what each stage takes, what it touches, and what bounds it."""

from typing import NamedTuple

import numpy as np
from speed_scene import HEIGHT, WIDTH, Frames, make_angles
from speed_times import Times, take_turns

from jaxscan.geometry import Scanner
from jaxscan.reconstruction import ReconstructSettings, Sweep, reconstruct
from jaxscan.stripes import extract_stripes


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
    found = extract_stripes(frames.on, frames.off)
    bare = ReconstructSettings(normals=False)
    runs = {
        "stripes": lambda: np.asarray(extract_stripes(frames.on, frames.off).u),
        "points": lambda: reconstruct(sweep, scanner, stripes=found, settings=bare),
        "points and normals": lambda: reconstruct(sweep, scanner, stripes=found),
    }
    touched = {
        "stripes": (2.0 * FRAME + 26 * HEIGHT, "arithmetic of the fit"),
        "points": ((13 + 4 * 64 + 40) * HEIGHT, "a cache line of the frame per pixel of the colour"),
        "points and normals": ((13 + 4 * 64 + 40 + 17 + 12) * HEIGHT, "arithmetic of the slopes"),
    }
    times = take_turns(runs, repeats)
    return [Stage(name, Times(*(t / pairs for t in times[name])), *touched[name]) for name in runs]
