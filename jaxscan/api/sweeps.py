"""Captured sweeps to clouds, with the stripes kept beside the capture for the next time."""

from collections.abc import Hashable
from typing import NamedTuple

import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.files.capture import Capture, cache_path, cached_stripes, code_digest, frames_key, save_stripes
from jaxscan.geometry import Scanner
from jaxscan.reconstruction import (
    DEFAULTS,
    FrameWatch,
    PointCloud,
    Progress,
    ReconstructSettings,
    Seen,
    cloud_of_plan,
    extraction_key,
    kept_arrays,
    make_plan,
    pair_notes,
    stripes_of_plan,
    sweep_doubts,
    usable_stripes,
)
from jaxscan.stripes import NoiseModel


class Reconstruction(NamedTuple):
    """A cloud, and where its stripes are from."""

    cloud: PointCloud
    from_cache: bool = False
    """Whether the stripes had been kept before, and no frame was read."""
    kept: bool = False
    """Whether the stripes are kept now."""
    notes: tuple[str, ...] = ()
    """Faults that a user should know, and doubts whether all frames, angles and keys of the header are as they were
    taken; a sentence each."""
    noise: str = ""
    """Noise of a frame and speckle as they were learned, and the part that was not, in a line; empty where the noise
    was given."""


def reconstruct_capture(
    capture: Capture,
    scanner: Scanner,
    *,
    settings: ReconstructSettings = DEFAULTS,
    noise: NoiseModel | None = None,
    progress: Progress = None,
    cache: bool = True,
) -> Reconstruction:
    """Reconstruct a captured sweep, from the stripes of an earlier time where they are still good.

    Stripes are kept in `stripes.npz` beside the journal. They serve again if frames, settings and
    the code that finds stripes are the same, with this calibration or with another one that looks
    for stripes at the same places (`usable_stripes`).

    Args:
        capture: The sweep.
        scanner: The calibrated rig.
        settings: Range limits, and how stripes are found.
        noise: Noise of a frame; estimated from the start of the sweep where not given.
        progress: Called with (records done, records in all); from frames, of finding the stripes.
        cache: Whether stripes are looked for in the capture's folder and kept there. Without, and with
            `smooth` "off", they are not held in memory either.

    Returns:
        The cloud, and where its stripes are from. A folder that cannot be written gives a note.

    Raises:
        CaptureError: If the sweep has no records or no stripe, or a frame cannot be read.
        CalibrationError: If the scanner is not that of the sweep, or no point is in range.
    """
    upright, coloured = scanner.up in ("-v", "+v"), capture.pixel_format == "rgb8"
    watch = FrameWatch(len(capture), upright=upright, brackets=len(capture.exposures) > 1, colours=coloured)
    plan = make_plan(capture.watched(watch.look), scanner, settings)
    numbers, off_images = [record.i for record in capture.records], _off_images(capture)
    if not cache:
        cloud = cloud_of_plan(plan, noise=noise, progress=progress)
        doubts = sweep_doubts(plan, cloud, watch.seen, numbers, off_images)
        notes = (*plan.notes, *pair_notes(plan, capture.frames, numbers), *doubts)
        return Reconstruction(cloud, notes=notes, noise=plan.noise)
    key = {"frames": frames_key(capture), "code": code_digest(), **extraction_key(settings, noise)}
    path = cache_path(capture)
    arrays = cached_stripes(path, key)
    seen = None if arrays is None else Seen.taken_from(arrays, len(capture))
    stripes = None if arrays is None or seen is None else usable_stripes(arrays, plan)
    if stripes is not None and seen is not None:
        cloud = cloud_of_plan(plan, stripes=stripes, progress=progress)
        doubts = sweep_doubts(plan, cloud, seen, numbers, off_images)
        return Reconstruction(cloud, from_cache=True, kept=True, notes=(*plan.notes, *doubts), noise=plan.noise)
    stripes = stripes_of_plan(plan, noise=noise, progress=progress)
    cloud = cloud_of_plan(plan, stripes=stripes)
    doubts = sweep_doubts(plan, cloud, watch.seen, numbers, off_images)
    notes = (*plan.notes, *pair_notes(plan, capture.frames, numbers), *doubts)
    try:
        save_stripes(path, kept_arrays(stripes, plan) | watch.seen.arrays(), key)
    except CaptureError as problem:
        notes = (*notes, f"the stripes are not kept for next time: {problem}")
        return Reconstruction(cloud, notes=notes, noise=plan.noise)
    return Reconstruction(cloud, kept=True, notes=notes, noise=plan.noise)


def _off_images(capture: Capture) -> np.ndarray:
    """A number for each record's laser-off image, int [records]: records that name the same image have the same."""
    known: dict[Hashable, int] = {}
    return np.array([known.setdefault(record.off, len(known)) for record in capture.records], int)
