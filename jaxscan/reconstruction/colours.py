"""The colour of a laser, learned from a sweep."""

import dataclasses
from collections.abc import Iterator

import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.reconstruction.sweep import FrameChunk, SweepSource
from jaxscan.stripes import LaserLine, with_colour


NOISE_RECORDS = 8
"""Records at the start of the sweep from which noise and colours are taken where they are not given."""


def with_learned_colour(sweep: SweepSource, laser: int) -> LaserLine:
    """A laser whose colour is "auto", with its colour learned from the first records that show it alone.

    Raises:
        CaptureError: If it cannot be learned.
    """
    line, problem = sweep.lasers[laser], "it is never lit alone."
    if sweep.pixel_format == "mono8":
        return dataclasses.replace(line, colour="red")
    for on, off in _pairs_of(sweep, laser):
        try:
            return with_colour(line, on, off, sweep.pixel_format)
        except ValueError as error:
            problem = str(error)
    raise CaptureError(f'The colour of the laser "{line.name}" is "auto" and cannot be learned: {problem}')


def _pairs_of(sweep: SweepSource, laser: int) -> Iterator[FrameChunk]:
    """Pairs, of all exposures, of the records in which one laser alone is lit."""
    lit = np.bincount(sweep.record, minlength=len(sweep))
    own = np.zeros(len(sweep), bool)
    own[sweep.record[sweep.laser == laser]] = True
    own &= lit == 1
    start = 0
    for on, off in sweep.chunks(min(NOISE_RECORDS, len(sweep))):
        rows = np.flatnonzero(own[start : start + len(on)])
        start += len(on)
        if len(rows):
            on, off = np.asarray(on)[rows], None if off is None else np.asarray(off)[rows]
            if len(sweep.exposures) > 1:
                on, off = on.reshape(-1, *on.shape[2:]), None if off is None else off.reshape(-1, *off.shape[2:])
            yield FrameChunk(on, off)
