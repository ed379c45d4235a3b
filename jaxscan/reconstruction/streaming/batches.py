"""A sweep in batches of frames that one compiled function takes."""

import math
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import jax
import numpy as np

from jaxscan.geometry import Array
from jaxscan.reconstruction.ahead import workers
from jaxscan.reconstruction.settings import ReconstructSettings
from jaxscan.reconstruction.sweep import FrameChunk, SweepSource


_RECORDS = 32
"""Records of a chunk: the path over the lines is one long loop for all of them."""
_BYTES = 100e6
"""Frames of a chunk at most."""


class Batch(NamedTuple):
    """Frames of one laser."""

    profiles: np.ndarray
    """Which profiles of the sweep, int [n]."""
    laser: int
    on: Array
    off: Array | None


def chunk_records(sweep: SweepSource, settings: ReconstructSettings) -> int:
    """Records that are computed at a time."""
    devices = len(jax.local_devices())
    if settings.chunk_records is not None:
        return -(-min(settings.chunk_records, len(sweep)) // devices) * devices
    width, height = sweep.image_size
    pair = 2 * width * height * (3 if sweep.pixel_format == "rgb8" else 1) * len(sweep.exposures)
    # A short sweep still has something to do for every core, and for every device.
    share = -(-len(sweep) // max(workers(), 1))
    # Powers of two, so that short sweeps of all lengths share a few compiled functions.
    size = 1 << max(0, math.ceil(math.log2(min(_RECORDS, max(1, _BYTES / pair), share))))
    return -(-size // devices) * devices


def batches(sweep: SweepSource, size: int, chunks: Iterable[FrameChunk] | None = None) -> Iterator[Batch]:
    """The sweep in batches of at most `size` frames each."""
    record, laser = sweep.record, sweep.laser
    lasers = np.unique(laser)
    start = 0
    for chunk in sweep.chunks(size) if chunks is None else chunks:
        count = len(chunk.on)
        here = (record >= start) & (record < start + count)
        for index in lasers:
            profiles = np.flatnonzero(here & (laser == index))
            for first in range(0, len(profiles), size):
                some = profiles[first : first + size]
                rows = record[some] - start
                off = None if chunk.off is None else _frames(chunk.off, rows)
                yield Batch(some, int(index), _frames(chunk.on, rows), off)
        start += count


def _frames(frames: Array, rows: np.ndarray) -> Array:
    if len(rows) == len(frames) and bool(np.all(np.diff(rows) == 1)):
        return frames
    return np.asarray(frames)[rows]
