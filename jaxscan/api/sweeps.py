"""Captured sweeps to clouds, with the stripes kept beside the capture for the next time."""

from typing import NamedTuple

from jaxscan.api.stripes import find_stripes, plan_watched
from jaxscan.files.capture import Capture
from jaxscan.geometry import Scanner
from jaxscan.reconstruction import (
    DEFAULTS,
    PointCloud,
    Progress,
    ReconstructSettings,
    cloud_of_plan,
    cloud_points,
    pair_notes,
    refuse_other_motion,
    sweep_doubts,
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

    Stripes are kept beside the journal and serve again, as `find_stripes` says.

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
        CaptureError: If the sweep has no records or no stripe, a frame cannot be read, or the images turn otherwise
            than the angles say.
        CalibrationError: If the scanner is not that of the sweep, or no point is in range.
    """
    watched = plan_watched(capture, scanner, settings)
    plan = watched.plan
    if not cache:
        cloud = cloud_of_plan(plan, noise=noise, progress=progress)
        refuse_other_motion(plan, cloud_points(plan, cloud), capture.off_frame, str(capture.path))
        doubts = sweep_doubts(plan, cloud, watched.watch.seen, watched.numbers, watched.off_images)
        notes = (*plan.notes, *pair_notes(plan, capture.frames, watched.numbers), *doubts)
        return Reconstruction(cloud, notes=notes, noise=plan.noise)
    found = find_stripes(capture, watched, noise=noise, progress=progress)
    cloud = cloud_of_plan(plan, stripes=found.stripes, progress=progress if found.from_cache else None)
    refuse_other_motion(plan, cloud_points(plan, cloud), capture.off_frame, str(capture.path))
    doubts = sweep_doubts(plan, cloud, found.seen, watched.numbers, watched.off_images)
    notes = (*plan.notes, *found.notes, *doubts)
    return Reconstruction(cloud, from_cache=found.from_cache, kept=found.kept, notes=notes, noise=plan.noise)
