"""Captured sweeps to stripes and clouds: stripes are kept beside the capture."""

from collections.abc import Hashable
from typing import NamedTuple

import numpy as np

from jaxscan.api.stages import Stage, Stages, megapixels
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
    SmoothedSweep,
    cloud_points,
    extract,
    extraction_key,
    kept_arrays,
    pair_notes,
    plan_sweep,
    reconstruct,
    refuse_other_motion,
    smooth_stripes,
    sweep_doubts,
    usable_stripes,
)
from jaxscan.stripes import NoiseModel, Stripes


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


class FoundStripes(NamedTuple):
    """The stripes of a captured sweep, and where they are from."""

    stripes: Stripes
    seen: Seen
    """Statistics of the frames, by which doubts about them are raised."""
    from_cache: bool
    """Whether they had been kept before, and no frame was read."""
    kept: bool
    """Whether they are kept now."""
    notes: tuple[str, ...]
    """Notes on stripes and pairs of frames, and on a folder that cannot be written; a sentence each."""
    noise: str
    """See `Reconstruction`."""
    smoothed: SmoothedSweep | None
    """The centres smoothed along the stripes; None where the settings do not smooth, or there is no stripe."""


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

    Stripes are kept beside the journal and serve again, as `find_stripes` says.

    Args:
        capture: The sweep.
        scanner: The calibrated rig.
        settings: Range limits, and how stripes are found.
        noise: Noise of a frame; estimated from the start of the sweep where not given.
        progress: Called with (work done, work in all).
        cache: Whether stripes are looked for in the capture's folder and kept there.

    Returns:
        The cloud, and where its stripes are from. A folder that cannot be written gives a note.

    Raises:
        CaptureError: If the sweep has no records or no stripe, a frame cannot be read, or the images turn otherwise
            than the angles say.
        CalibrationError: If the scanner is not that of the sweep, or no point is in range.
    """
    pixels = megapixels(*capture.image_size, len(capture))
    # Measured with a sweep of 180 pairs of 640 x 512 px on one processor.
    stages = Stages(progress, (Stage(3.1, 0.035 * pixels), Stage(4.2, 1e-3 * pixels)))
    found = find_stripes(capture, scanner, settings, noise=noise, progress=stages.part(0), cache=cache)
    stages.done(0)
    cloud = reconstruct(
        capture, scanner, stripes=found.stripes, smoothed=found.smoothed, settings=settings, progress=stages.part(1)
    )
    stages.done(1)
    notes = (*found.notes, *doubts_of(capture, scanner, cloud, found.seen))
    return Reconstruction(cloud, found.from_cache, found.kept, notes, found.noise)


def find_stripes(
    capture: Capture,
    scanner: Scanner,
    settings: ReconstructSettings,
    *,
    noise: NoiseModel | None = None,
    progress: Progress = None,
    cache: bool = True,
) -> FoundStripes:
    """The stripes of a sweep: those kept beside it if they are still good, else found now and kept.

    Stripes are kept in `stripes.npz` beside the journal. They serve again if frames, settings and
    the code that finds stripes are the same, with this calibration or with another one that looks
    for stripes at the same places (`usable_stripes`).

    Args:
        capture: The sweep.
        scanner: The calibrated rig.
        settings: Range limits, and how stripes are found.
        noise: Noise of a frame; estimated from the start of the sweep where not given.
        progress: Called with (records done, records in all) while frames are read.
        cache: Whether stripes are looked for in the capture's folder and kept there.

    Raises:
        CaptureError: If the sweep has no records or contradicts itself, or a frame cannot be read.
        CalibrationError: If the scanner is not that of the sweep.
    """
    plan = plan_sweep(capture, scanner, settings)
    path, key = cache_path(capture), dict[str, object]()
    if cache:
        key = {"frames": frames_key(capture), "code": code_digest(), **extraction_key(settings, noise)}
        arrays = cached_stripes(path, key)
        seen = None if arrays is None else Seen.taken_from(arrays, len(capture))
        known = None if arrays is None or seen is None else usable_stripes(arrays, plan)
        if known is not None and seen is not None:
            smoothed = known.smoothed or _smoothed(capture, known.stripes, settings)
            return FoundStripes(known.stripes, seen, True, True, known.notes, known.noise, smoothed)
    watch = watch_of(capture, scanner)
    found = extract(capture.watched(watch.look), scanner, settings=settings, noise=noise, progress=progress)
    found = found._replace(smoothed=_smoothed(capture, found.stripes, settings))
    notes, kept = (*found.notes, *pair_notes(capture, found.stripes, capture.frames, numbers_of(capture))), False
    if cache:
        try:
            save_stripes(path, kept_arrays(found, plan) | watch.seen.arrays(), key)
            kept = True
        except CaptureError as problem:
            notes = (*notes, f"the stripes are not kept for next time: {problem}")
    return FoundStripes(found.stripes, watch.seen, False, kept, notes, found.noise, found.smoothed)


def _smoothed(capture: Capture, stripes: Stripes, settings: ReconstructSettings) -> SmoothedSweep | None:
    one_each = np.shape(stripes.u)[0] == len(capture.record)
    return smooth_stripes(capture, stripes) if settings.smooths and one_each and np.any(stripes.valid) else None


def doubts_of(capture: Capture, scanner: Scanner, cloud: PointCloud, seen: Seen) -> tuple[str, ...]:
    """Doubts on the frames, the angles and the header of a sweep whose cloud is known, a sentence each.

    Raises:
        CaptureError: If the images turn otherwise than the angles say.
    """
    refuse_other_motion(capture, scanner, cloud_points(cloud, scanner), capture.off_frame, str(capture.path))
    known: dict[Hashable, int] = {}
    # Records that name the same image have the same number.
    off_images = np.array([known.setdefault(record.off, len(known)) for record in capture.records], int)
    return sweep_doubts(capture, scanner, cloud, seen, numbers_of(capture), off_images)


def watch_of(capture: Capture, scanner: Scanner) -> FrameWatch:
    """The watch over the frames of a sweep while they are read."""
    upright, coloured = scanner.up in ("-v", "+v"), capture.pixel_format == "rgb8"
    return FrameWatch(len(capture), upright=upright, brackets=len(capture.exposures) > 1, colours=coloured)


def numbers_of(capture: Capture) -> list[int]:
    """The numbers of the records in the journal."""
    return [record.i for record in capture.records]
