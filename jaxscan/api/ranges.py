"""The stripes of a large sweep in parts, each found by a process of its own, and put together exactly."""

import dataclasses
import itertools
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxscan.api.sweeps import Reconstruction, doubts_of, numbers_of, watch_of
from jaxscan.errors import CaptureError
from jaxscan.files.capture import Capture, code_digest
from jaxscan.geometry import Scanner
from jaxscan.reconstruction import (
    DEFAULTS,
    Progress,
    ReconstructSettings,
    Seen,
    StripePart,
    can_be_split,
    extract_part,
    extraction_key,
    join_parts,
    pair_notes,
    plan_sweep,
    reconstruct,
)


FORMAT = "jaxscan-stripe-part/1"
Part = Mapping[str, np.ndarray]
"""Plain arrays, as an `.npz` file holds them."""
_CLEAR, _DECOYS, _ABOUT, _STRIPE = "searched_clear", "searched_decoys", "about", "stripe_"


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
    about = {"key": _key(capture, settings), "records": [first, stop], "found": found.found}
    about |= {"notes": found.notes, "noise": found.noise}
    arrays = {_STRIPE + name: field for name, field in found.fields.items()} | watch.seen.arrays()
    text = np.frombuffer(json.dumps(about, allow_nan=False).encode(), np.uint8)
    return arrays | {_CLEAR: found.clear, _DECOYS: found.decoys, _ABOUT: text}


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
    told = sorted((_about(part, capture) for part in parts), key=lambda one: one[0]["records"])
    _check(told, capture, settings)
    found = join_parts(plan_sweep(capture, scanner, settings), [_part(about, part) for about, part in told])
    seen = _seen([part for _, part in told], len(capture))
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
        return {name: about[name] for name in ("key", "records", "found", "notes", "noise")}, part
    except (KeyError, TypeError, ValueError) as problem:
        raise CaptureError(f"{capture.path}: a part of its stripes is none ({FORMAT}).") from problem


def _check(told: Sequence[tuple[dict[str, Any], Part]], capture: Capture, settings: ReconstructSettings) -> None:
    if any(about["key"] != _key(capture, settings) for about, _ in told):
        raise CaptureError(
            f"{capture.path}: parts of stripes are of another sweep, other settings or another code; find them again."
        )
    ranges = [tuple(about["records"]) for about, _ in told]
    ends = [0, *(stop for _, stop in ranges)]
    if [first for first, _ in ranges] != ends[:-1] or ends[-1] != len(capture):
        listed = ", ".join(f"{first}-{stop}" for first, stop in ranges)
        raise CaptureError(f"{capture.path}: found stripes of records {listed}, expected 0-{len(capture)}, each once.")


def _part(about: dict[str, Any], part: Part) -> StripePart:
    fields = {name.removeprefix(_STRIPE): field for name, field in part.items() if name.startswith(_STRIPE)}
    return StripePart(
        fields, part[_CLEAR], part[_DECOYS], about["found"], notes=tuple(about["notes"]), noise=about["noise"]
    )


def _seen(parts: Sequence[Part], records: int) -> Seen:
    together = {name: np.concatenate([part[name] for part in parts]) for name in Seen.names()}
    found = Seen.taken_from(together, records)
    if found is None:
        raise CaptureError("parts of stripes hold no statistics of their frames; find them again.")
    return found
