"""Stripes of a captured sweep, from the cache beside it where they are still good."""

from collections.abc import Hashable
from typing import NamedTuple

import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.files.capture import Capture, cache_path, cached_stripes, code_digest, frames_key, save_stripes
from jaxscan.geometry import Scanner
from jaxscan.reconstruction import (
    FrameWatch,
    Plan,
    Progress,
    ReconstructSettings,
    Seen,
    extraction_key,
    kept_arrays,
    make_plan,
    pair_notes,
    stripes_of_plan,
    usable_stripes,
)
from jaxscan.stripes import NoiseModel, Stripes


class Watched(NamedTuple):
    """A sweep that is planned and not read, and the watch over its frames."""

    plan: Plan
    watch: FrameWatch
    numbers: list[int]
    """Of the records in the journal."""
    off_images: np.ndarray
    """A number for each record's laser-off image, int [records]: records that name the same image have the same."""


class FoundStripes(NamedTuple):
    """The stripes of a sweep, and where they are from."""

    stripes: Stripes
    seen: Seen
    """Of the frames, by which doubts on them are raised."""
    from_cache: bool
    """Whether they had been kept before, and no frame was read."""
    kept: bool
    """Whether they are kept now."""
    notes: tuple[str, ...]
    """On pairs of frames, and on a folder that cannot be written; a sentence each."""


def plan_watched(capture: Capture, scanner: Scanner, settings: ReconstructSettings) -> Watched:
    """Plan a sweep whose frames are watched while they are read.

    Raises:
        CaptureError: If the sweep has no records, or contradicts itself.
        CalibrationError: If the scanner is not that of the sweep.
    """
    upright, coloured = scanner.up in ("-v", "+v"), capture.pixel_format == "rgb8"
    watch = FrameWatch(len(capture), upright=upright, brackets=len(capture.exposures) > 1, colours=coloured)
    plan = make_plan(capture.watched(watch.look), scanner, settings)
    known: dict[Hashable, int] = {}
    off_images = np.array([known.setdefault(record.off, len(known)) for record in capture.records], int)
    return Watched(plan, watch, [record.i for record in capture.records], off_images)


def find_stripes(
    capture: Capture, watched: Watched, *, noise: NoiseModel | None = None, progress: Progress = None
) -> FoundStripes:
    """The stripes of a sweep: those kept beside it if they are still good, else found now and kept.

    Stripes are kept in `stripes.npz` beside the journal. They serve again if frames, settings and
    the code that finds stripes are the same, with this calibration or with another one that looks
    for stripes at the same places (`usable_stripes`).

    Args:
        capture: The sweep.
        watched: Its plan.
        noise: Noise of a frame; estimated from the start of the sweep where not given.
        progress: Called with (records done, records in all) while frames are read.

    Raises:
        CaptureError: If a frame cannot be read.
    """
    plan, seen_now = watched.plan, watched.watch
    key = {"frames": frames_key(capture), "code": code_digest(), **extraction_key(plan.settings, noise)}
    path = cache_path(capture)
    arrays = cached_stripes(path, key)
    seen = None if arrays is None else Seen.taken_from(arrays, len(capture))
    stripes = None if arrays is None or seen is None else usable_stripes(arrays, plan)
    if stripes is not None and seen is not None:
        return FoundStripes(stripes, seen, from_cache=True, kept=True, notes=())
    stripes = stripes_of_plan(plan, noise=noise, progress=progress)
    notes = tuple(pair_notes(plan, capture.frames, watched.numbers))
    try:
        save_stripes(path, kept_arrays(stripes, plan) | seen_now.seen.arrays(), key)
    except CaptureError as problem:
        notes = (*notes, f"the stripes are not kept for next time: {problem}")
        return FoundStripes(stripes, seen_now.seen, from_cache=False, kept=False, notes=notes)
    return FoundStripes(stripes, seen_now.seen, from_cache=False, kept=True, notes=notes)
