"""Captured sweeps to clouds, with the stripes kept beside the capture for the next time."""

import dataclasses
import functools
import hashlib
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.files.capture import Capture, cache_path, cached_stripes, frames_key, save_stripes
from jaxscan.geometry import Scanner
from jaxscan.reconstruction import PointCloud, ReconstructSettings, reconstruct
from jaxscan.reconstruction.plan import Plan, make_plan, search_gates, with_colours
from jaxscan.reconstruction.reconstruct import Progress, extract_sweep
from jaxscan.reconstruction.settings import DEFAULTS
from jaxscan.stripes import NoiseModel, Stripes
from jaxscan.stripes.pairs import judge_pairs


_JUDGED_PAIRS = 8
"""Pairs of a sweep that are looked at."""
_LEAK = 0.05
"""Part of the stripe in the laser-off image from which a user should know [1]."""
_UNREST = 2.0
"""What differs beside the laser from which a user should know, in the noise [1]."""


class Reconstruction(NamedTuple):
    """A cloud, and where its stripes are from."""

    cloud: PointCloud
    from_cache: bool = False
    """Whether the stripes had been kept before, and no frame was read."""
    kept: bool = False
    """Whether the stripes are kept now."""
    notes: tuple[str, ...] = ()
    """What a user should know, a sentence each."""


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
    the code that finds stripes are the same, with this calibration or with another one: the search
    reaches `GATE_MARGIN_PX` beyond the range limits, and as long as the limits as the new
    calibration sees them lie within what was searched, nothing can have been missed.

    Args:
        capture: The sweep.
        scanner: The calibrated rig.
        settings: Range limits, and how stripes are found.
        noise: Noise of a frame; estimated from the start of the sweep where not given.
        progress: Called with (records done, records in all); from frames, of finding the stripes.
        cache: Whether stripes are looked for in the capture's folder and kept there. Without, they
            are not held in memory either.

    Returns:
        The cloud, and where its stripes are from. A folder that cannot be written gives a note.

    Raises:
        CaptureError: If the sweep has no records or no stripe, or a frame cannot be read.
        CalibrationError: If the scanner is not that of the sweep, or no point is in range.
    """
    plan = make_plan(capture, scanner, settings)
    if not cache:
        cloud = reconstruct(capture, scanner, settings=settings, noise=noise, progress=progress)
        return Reconstruction(cloud, notes=pair_notes(capture, plan))
    path, key = cache_path(capture), _key(capture, settings, noise)
    stripes = _usable(cached_stripes(path, key), plan)
    if stripes is not None:
        cloud = reconstruct(capture, scanner, stripes=stripes, settings=settings, progress=progress)
        return Reconstruction(cloud, from_cache=True, kept=True)
    stripes = extract_sweep(capture, scanner, settings=settings, noise=noise, progress=progress)
    cloud = reconstruct(capture, scanner, stripes=stripes, settings=settings)
    notes = pair_notes(capture, plan)
    try:
        save_stripes(path, {**_arrays(stripes), **_searched(plan)}, key)
    except CaptureError as problem:
        return Reconstruction(cloud, notes=(*notes, f"the stripes are not kept for next time: {problem}"))
    return Reconstruction(cloud, kept=True, notes=notes)


def pair_notes(capture: Capture, plan: Plan) -> tuple[str, ...]:
    """What is wrong with the pairs of a sweep, from some of them all over it; a sentence each."""
    lit = np.bincount(capture.record, minlength=len(capture))
    alone = [i for i in range(len(capture)) if lit[i] == 1]
    chosen = [alone[i] for i in np.unique(np.linspace(0, len(alone) - 1, _JUDGED_PAIRS).astype(int))] if alone else []
    if not chosen or len(capture.exposures) > 1 or not all(capture.records[i].off for i in chosen):
        return ()
    notes, lasers = [], with_colours(plan).lasers
    laser = np.array([capture.laser[capture.record == i][0] for i in chosen])
    for index in np.unique(laser):
        own = [i for i, one in zip(chosen, laser, strict=True) if one == index]
        on, off = (np.stack(frames) for frames in zip(*(capture.frames(i) for i in own), strict=True))
        line = lasers[index]
        found = judge_pairs(on, off, pixel_format=capture.pixel_format, response=capture.response, line=line)
        leaking = float(np.median(found.leak))
        if leaking > _LEAK and leaking > 4.0 * float(np.median(found.leak_sigma)):
            notes.append(
                f'the laser "{line.name}" is in the laser-off images too ({100 * leaking:.0f} % of the stripe): wait '
                f"longer after switching it off"
            )
        moving = [capture.records[i].i for i, unrest in zip(own, found.unrest, strict=True) if unrest > _UNREST]
        if moving:
            notes.append(
                f"something moved, or a lamp changed, between the two images of record "
                f"{', '.join(map(str, moving))} ({len(own)} were looked at)"
            )
    return tuple(notes)


def _key(capture: Capture, settings: ReconstructSettings, noise: NoiseModel | None) -> dict[str, Any]:
    """All that the stripes depend on, but for the calibration."""
    return {
        "frames": frames_key(capture),
        "code": _code_digest(),
        "stripes": dataclasses.asdict(settings.stripes),
        "noise": None if noise is None else dataclasses.asdict(noise),
        # Another range might choose other stripes from what was searched.
        "range_m": [str(settings.min_range_m), str(settings.max_range_m)],
        "gate": settings.gate,
        "check_steps": settings.check_steps,
    }


@functools.lru_cache(maxsize=1)
def _code_digest() -> str:
    """Digest of the code that finds stripes, so that better code never takes the stripes of worse."""
    root = Path(str(resources.files("jaxscan")))
    files = sorted(file for room in ("stripes", "reconstruction") for file in (root / room).rglob("*.py"))
    digest = hashlib.sha256()
    for file in files:
        digest.update(str(file.relative_to(root)).encode() + b"\0" + file.read_bytes())
    return "sha256:" + digest.hexdigest()


def _arrays(stripes: Stripes) -> dict[str, np.ndarray]:
    return {name: np.asarray(field) for name, field in vars(stripes).items() if field is not None}


def _searched(plan: Plan, *, margin_px: float | None = None) -> dict[str, np.ndarray]:
    """Of each laser the part of every line that is searched, and which side is near."""
    searched = {}
    for laser, gate in search_gates(plan, margin_px=margin_px).items():
        searched[f"searched_{laser}"] = np.stack([gate.low, gate.high])
        searched[f"near_side_{laser}"] = np.array(gate.near_side)
    return searched


def _usable(arrays: dict[str, np.ndarray] | None, plan: Plan) -> Stripes | None:
    """Stripes from what was kept, if they are all that this calibration could find."""
    if arrays is None:
        return None
    gated = plan.settings.gate or len(np.unique(plan.sweep.record)) < len(plan.sweep.record)
    for name, wanted in _searched(plan, margin_px=0.0).items():
        searched = arrays.pop(name, None)
        if searched is None or searched.shape != wanted.shape:
            return None
        if name.startswith("near_side"):
            if np.any(searched != wanted):
                return None
        elif gated:
            empty = wanted[0] >= wanted[1]
            if not np.all(empty | ((searched[0] <= wanted[0]) & (wanted[1] <= searched[1]))):
                return None
    try:
        return Stripes(**arrays)
    except TypeError:
        # Fields of another version's stripes.
        return None
