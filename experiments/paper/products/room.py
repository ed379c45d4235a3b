"""The room of the configuration in one sweep: stripes by our extractor and by the plain ones, of the same frames.

In the kind world the table takes all 3600 steps, as in the paper. In the unkind one it takes every tenth: a frame there
takes three times as long to render, and all experiments together have an hour. A quick sweep has 90 steps.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

import jaxscan
from experiments.paper.methods import horus_stripes, plain_stripes
from experiments.paper.products.draws import our_calibrations
from experiments.paper.rendering.sweeps import RenderedSweep
from experiments.paper.stage import Stage
from experiments.paper.worlds import windowed, windowed_scanner
from jaxscan.simulation import sweep_angles


NEAR_M, FAR_M = 1.2, 4.0
"""Depths between which the room and its furniture lie, as a user knows [m]."""
MARGIN = 40 / 2048
"""Columns read on either side of the stripe's, as a share of the image's width."""
PLAIN = plain_stripes.EXTRACTORS | {"horus": horus_stripes.scan, "horus_tuned": horus_stripes.tuned}
STRIDE = {"kind": 1, "unkind": 10}
"""Every n-th of the plan's steps is taken."""
_QUICK_STEPS = 90


class PlainStripes(NamedTuple):
    """Stripes by a plain extractor."""

    u: np.ndarray
    """Column in the whole image [records, rows]; px."""
    valid: np.ndarray
    """bool [records, rows]."""


class Room(NamedTuple):
    """The stripes of a sweep of the room; all columns are those of the whole image."""

    stripes: jaxscan.Stripes
    """By our extractor, within the gate of our first calibration; with colours."""
    plain: dict[str, PlainStripes]
    """By the names of `PLAIN`."""
    angles: np.ndarray
    """As commanded [records]; rad."""
    window: tuple[int, int]
    """Columns that were read: first, and one past the last."""


def room(stage: Stage) -> Room:
    """The sweep, rendered once in each world and kept."""
    path = stage.product("room.npz")
    if not _is_complete(path):
        found = _sweep(stage)
        arrays = {f"ours_{name}": np.asarray(field) for name, field in vars(found.stripes).items() if field is not None}
        for name, plain in found.plain.items():
            arrays |= {f"{name}_u": plain.u, f"{name}_valid": plain.valid}
        partial = path.with_suffix(".part.npz")
        np.savez(partial, angles=found.angles, window=found.window, **arrays)
        partial.rename(path)
    with np.load(path) as kept:
        ours = {name.removeprefix("ours_"): kept[name] for name in kept.files if name.startswith("ours_")}
        plain = {name: PlainStripes(kept[f"{name}_u"], kept[f"{name}_valid"]) for name in PLAIN}
        first, stop = kept["window"].tolist()
        return Room(jaxscan.Stripes(**ours), plain, kept["angles"], (first, stop))


def _is_complete(path: Path) -> bool:
    if not path.exists():
        return False
    with np.load(path) as kept:
        return all(f"{name}_u" in kept.files for name in PLAIN)


def room_sweep(stage: Stage, angles: np.ndarray) -> RenderedSweep:
    """The sweep of the whole camera for `jaxscan.reconstruct`, which reads no frame if the stripes have colours."""
    return RenderedSweep(stage.config, angles, seed=stage.config.seed)


def stripe_window(scanner: jaxscan.Scanner, near_m: float, far_m: float, margin_px: float) -> tuple[int, int]:
    """Columns of the image in which the stripe lies for depths from `near_m` to `far_m`: first, and one past the last.

    Args:
        scanner: A calibration, of which camera and sheet are used; the bow of the sheet is left to the margin.
        near_m: Smallest depth [m].
        far_m: Largest depth [m].
        margin_px: Added on either side [px].
    """
    camera, sheet = scanner.camera, scanner.laser(0)
    (nx, ny, nz), distance = np.asarray(sheet.normal), float(sheet.distance)
    rows = np.linspace(0, camera.height - 1, 33)
    slope = (rows - float(camera.cy)) / float(camera.fy)
    z, slope = (part.ravel() for part in np.meshgrid([near_m, far_m], slope))
    points = np.column_stack([(distance - nz * z - ny * slope * z) / nx, slope * z, z])
    u = np.asarray(camera.project(points))[:, 0]
    first, stop = int(np.floor(u.min() - margin_px)), int(np.ceil(u.max() + margin_px)) + 1
    return max(first, 0), min(stop, camera.width)


def _sweep(stage: Stage) -> Room:
    config = stage.config
    scanner = jaxscan.load_scanner(our_calibrations(stage, 1)[0])
    every = config.plan.steps // _QUICK_STEPS if stage.quick else STRIDE[stage.world]
    angles = sweep_angles(config, every=every)
    first, stop = stripe_window(scanner, NEAR_M, FAR_M, MARGIN * config.camera.width)
    shape = len(angles), config.camera.height
    plain = {name: PlainStripes(np.zeros(shape, np.float32), np.zeros(shape, bool)) for name in PLAIN}

    def watch(start: int, on: np.ndarray, off: np.ndarray) -> None:
        # The first frames come twice: the noise is learned from them.
        part = slice(start, start + len(on))
        for name, extract in PLAIN.items():
            u, valid = extract(on, off)
            plain[name].u[part] = np.where(valid, u + first, 0)
            plain[name].valid[part] = valid

    told = 0

    def tell(done: int, total: int) -> None:
        nonlocal told
        if done * 5 // total > told:
            told = done * 5 // total
            stage.say(f"sweep of the room: {done} of {total} records")

    sweep = RenderedSweep(windowed(config, first, stop), angles, seed=config.seed, watch=watch)
    settings = jaxscan.ReconstructSettings(min_range_m=NEAR_M - 0.1, max_range_m=FAR_M + 0.3)
    part = windowed_scanner(scanner, first, stop)
    found = jaxscan.extract(sweep, part, settings=settings, progress=tell).stripes
    fields = vars(found) | {"u": np.where(found.valid, found.u + first, 0).astype(np.float32)}
    return Room(jaxscan.Stripes(**fields), plain, angles, (first, stop))
