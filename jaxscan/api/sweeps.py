"""Captured sweeps to stripes and clouds: stripes are kept beside the capture, or found in parts."""

import dataclasses
import itertools
import json
from collections.abc import Hashable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxscan.api.stages import Stage, Stages, megapixels
from jaxscan.errors import CaptureError
from jaxscan.files.capture import Capture, cache_path, cached_stripes, code_digest, frames_key, save_stripes
from jaxscan.geometry import Scanner
from jaxscan.reconstruction import (
    DEFAULTS,
    Decoys,
    FrameWatch,
    PointCloud,
    Progress,
    ReconstructSettings,
    Seen,
    SmoothedSweep,
    StripePart,
    can_be_split,
    cloud_points,
    extract,
    extract_part,
    extraction_key,
    join_parts,
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
    """Of the frames, by which doubts on them are raised."""
    from_cache: bool
    """Whether they had been kept before, and no frame was read."""
    kept: bool
    """Whether they are kept now."""
    notes: tuple[str, ...]
    """On stripes and pairs of frames, and on a folder that cannot be written; a sentence each."""
    noise: str
    """As of `Reconstruction`."""
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
    # Of a sweep of 180 pairs of 640 x 512 px on one processor.
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


FORMAT = "jaxscan-stripe-part/1"
Part = Mapping[str, np.ndarray]
"""Plain arrays, as an `.npz` file holds them."""
_DECOY, _ABOUT, _STRIPE = "decoy_", "about", "stripe_"


def ranges_of(capture: Capture, records: int) -> tuple[tuple[int, int], ...]:
    """Pieces of about so many records, as (first, stop): positions in `capture.records`."""
    count = max(1, round(len(capture) / records))
    ends = np.linspace(0, len(capture), count + 1).astype(int).tolist()
    return tuple(itertools.pairwise(ends))


def stripes_of_range(
    capture: Capture,
    scanner: Scanner,
    records: tuple[int, int],
    *,
    settings: ReconstructSettings = DEFAULTS,
    progress: Progress = None,
) -> dict[str, np.ndarray]:
    """The stripes of some neighbouring records of a sweep.

    Only their frames are read, and those at the start of the sweep, from which is learned.

    Args:
        capture: The whole sweep.
        scanner: The calibrated rig.
        records: First and stop, as `ranges_of` has them.
        settings: As for `reconstruct_capture`.
        progress: Called with (records done, records of the piece).

    Raises:
        CaptureError: If a frame cannot be read, or the sweep cannot be split exactly: it has no laser-off frames, or a
            laser is first lit after the start, or settings compare steps or keep several stripes of a line.
        CalibrationError: If the scanner is not that of the sweep.
    """
    first, stop = records
    plan = plan_sweep(capture, scanner, settings)
    if not can_be_split(plan):
        raise CaptureError(f"{capture.path}: its stripes cannot be found in parts; reconstruct it in one.")
    part = dataclasses.replace(capture, records=capture.records[first:stop])
    watch, before = watch_of(part, scanner), int(np.searchsorted(capture.record, first))
    found = extract_part(plan, part.watched(watch.look), before, progress=progress)
    about = {"key": _key(capture, settings), "records": [first, stop], "notes": found.notes, "noise": found.noise}
    arrays = {_STRIPE + name: field for name, field in found.fields.items()} | watch.seen.arrays()
    arrays |= {_DECOY + name: field for name, field in found.decoys._asdict().items()}
    text = np.frombuffer(json.dumps(about, allow_nan=False).encode(), np.uint8)
    return arrays | {_ABOUT: text}


def cloud_of_ranges(
    capture: Capture, scanner: Scanner, parts: Sequence[Part], *, settings: ReconstructSettings = DEFAULTS
) -> Reconstruction:
    """The cloud of a sweep whose stripes were found in parts: to the last bit that of `reconstruct_capture`.

    Reads only the few frames by which pairs are judged.

    Args:
        capture: The whole sweep.
        scanner: The calibrated rig.
        parts: As `stripes_of_range` gave them, in any order.
        settings: Those of the parts.

    Raises:
        CaptureError: If parts are missing, overlap, or are of another sweep, other settings or another code; or if the
            sweep has no stripe.
        CalibrationError: If no point is in range.
    """
    described = sorted((_about(part, capture) for part in parts), key=lambda one: one[0]["records"])
    _check(described, capture, settings)
    found = join_parts(plan_sweep(capture, scanner, settings), [_part(about, part) for about, part in described])
    seen = _seen([part for _, part in described], len(capture))
    pairs = pair_notes(capture, found.stripes, capture.frames, numbers_of(capture))
    cloud = reconstruct(capture, scanner, stripes=found.stripes, settings=settings)
    notes = (*found.notes, *pairs, *doubts_of(capture, scanner, cloud, seen))
    return Reconstruction(cloud, notes=notes, noise=found.noise)


def _key(capture: Capture, settings: ReconstructSettings) -> dict[str, Any]:
    key = {
        "capture": capture.digest(),
        "numbers": numbers_of(capture),
        "code": code_digest(),
        **extraction_key(settings, None),
    }
    return dict(json.loads(json.dumps(key)))


def _about(part: Part, capture: Capture) -> tuple[dict[str, Any], Part]:
    try:
        about = json.loads(part[_ABOUT].tobytes())
        return {name: about[name] for name in ("key", "records", "notes", "noise")}, part
    except (KeyError, TypeError, ValueError) as problem:
        raise CaptureError(f"{capture.path}: a part of its stripes is none ({FORMAT}).") from problem


def _check(described: Sequence[tuple[dict[str, Any], Part]], capture: Capture, settings: ReconstructSettings) -> None:
    if any(about["key"] != _key(capture, settings) for about, _ in described):
        raise CaptureError(
            f"{capture.path}: parts of stripes are of another sweep, other settings or another code; find them again."
        )
    ranges = [tuple(about["records"]) for about, _ in described]
    ends = [0, *(stop for _, stop in ranges)]
    if [first for first, _ in ranges] != ends[:-1] or ends[-1] != len(capture):
        listed = ", ".join(f"{first}-{stop}" for first, stop in ranges)
        raise CaptureError(f"{capture.path}: found stripes of records {listed}, expected 0-{len(capture)}, each once.")


def _part(about: dict[str, Any], part: Part) -> StripePart:
    fields = {name.removeprefix(_STRIPE): field for name, field in part.items() if name.startswith(_STRIPE)}
    decoys = Decoys(*(part[_DECOY + name] for name in Decoys._fields))
    return StripePart(fields, decoys, notes=tuple(about["notes"]), noise=about["noise"])


def _seen(parts: Sequence[Part], records: int) -> Seen:
    together = {name: np.concatenate([part[name] for part in parts]) for name in Seen.names()}
    found = Seen.taken_from(together, records)
    if found is None:
        raise CaptureError("parts of stripes hold no statistics of their frames; find them again.")
    return found
