"""jaxscan beside the method of the best-known desk scanner, Horus, re-implemented, on the same images.

Both take the same boards (our protocol) and the same sweep of the room. Horus' method comes in three versions:

- `horus`: as the program is shipped.
- `tuned`: as a person could adapt it to a room, with a lower threshold, and with stripe points corrected for the lens
  as in a descendant of the program.
- `whole`: as `tuned`, with centres rounded to whole pixels, as another desk scanner rounds them.

True stripe centres are from the independent equations of `experiments.recalibration.world`, for some records and rows;
everything else is from images.
"""

from typing import NamedTuple

import numpy as np

import jaxscan
from experiments.exact_rig import IdealRig
from experiments.paper.figure_9 import (
    FARTHEST_M,
    NOT_MEASURED,
    PROFILES,
    UPRIGHT,
    Size,
    box_of,
    our_cloud,
    points_of,
    records_of,
    size_of,
    thinned,
    true_size,
)
from experiments.paper.methods import Horus, horus_cloud, horus_points, load_horus
from experiments.paper.products import PlainStripes, Room, horus_path, our_calibrations, room
from experiments.paper.stage import Metric, Stage
from experiments.recalibration.trial import fitted
from experiments.recalibration.world import Sweeping, TrueSweep, true_sweep
from experiments.report import rms
from jaxscan.geometry import lit_points
from jaxscan.reconstruction.along import smooth_sweep
from jaxscan.simulation import true_scanner


WAYS = {
    "ours": "jaxscan",
    "horus": "Horus' method as shipped",
    "tuned": "Horus' method, tuned",
    "whole": "Horus' method, tuned, whole pixels",
}
"""Methods, and their names in tables."""
UNITS = {
    "rows": ("%", "lit rows with a point"),
    "stripe": ("px", "rms error of stripe centres"),
    "strays": ("%", "stripe centres that err by 3 px or more"),
    "depth_1.3m": ("mm", "rms depth error at 1.3 m"),
    "depth_2.5m": ("mm", "rms depth error at 2.5 m"),
    "axis_direction": ("deg", "mean error of the axis' direction"),
    "axis_place": ("mm", "mean error of the axis' position"),
    "measured": ("%", "calibrations with which the room can be measured"),
    "width": ("mm", "mean absolute error of the room's width"),
    "length": ("mm", "mean absolute error of the room's length"),
    "flatness": ("mm", "rms flatness of parts of walls that all methods see"),
}
"""Figures of each method: unit and name."""
_FINDER = {"horus": "horus", "tuned": "horus_tuned", "whole": "horus_tuned"}
DEPTHS_M = (1.3, 2.5)
RECORDS = 120
"""So many records have true stripes."""
ROW_STEP = 4
STRAY_PX = 3.0
"""A centre that is farther from the truth is a stray; strays are counted and do not enter the rms error."""
PATCH_M = 0.4
"""Flatness is judged within this distance of the middle of a wall's part that is seen."""


class Seen(NamedTuple):
    """The centres of one method, and its cloud, at the records and rows of the truth."""

    u: np.ndarray
    """Column [records, rows]; px."""
    valid: np.ndarray
    xyz: np.ndarray
    """[records, rows, 3], m; origin on the method's own axis, z up; NaN where there is no point."""


class Rig(NamedTuple):
    """One calibration of each kind, of the same images."""

    ours: jaxscan.Scanner
    theirs: Horus


def run(stage: Stage) -> list[Metric]:
    """Stripes, planes, axes and rooms of all methods against the truth."""
    paths, seen = our_calibrations(stage), room(stage)
    rigs = [Rig(jaxscan.load_scanner(path), load_horus(horus_path(stage, k))) for k, path in enumerate(paths)]
    stage.say("peers: true stripes")
    truth, step = _truth(stage, len(seen.angles))
    found = {name: _seen(stage, seen, rigs[0], name, step) for name in WAYS}
    stage.say("peers: rooms")
    figures, patches = {}, _patches(found, truth)
    for name in WAYS:
        sizes = [_size(stage, seen, rig, name) for rig in rigs]
        errors = np.mean(np.abs([size.errors(true_size(stage)) for size in sizes]), axis=0)
        measured = float(np.mean([np.isfinite(size.errors(true_size(stage))).all() for size in sizes]))
        figures[name] = {
            **_rows(found[name], truth),
            "flatness": _flatness(found[name], patches),
            "measured": 100 * measured,
            "width": float(errors[0]),
            "length": float(errors[1]),
            **{f"depth_{depth:g}m": _depth_error(stage, rigs, name, depth) for depth in DEPTHS_M},
            **(_axis_errors(stage, rigs, name) if name in ("ours", "horus") else {}),
        }

    every = [(name, what, value) for name, values in figures.items() for what, value in values.items()]
    # A room that could not be measured has no dimensions; `measured` says so.
    return [_metric(name, what, value) for name, what, value in every if np.isfinite(value)]


def _truth(stage: Stage, records: int) -> tuple[TrueSweep, int]:
    """True stripes of every n-th record of the sweep, and n."""
    count = RECORDS if records % RECORDS == 0 else records
    _, truth = true_sweep(stage.config, 0, Sweeping(steps=count, line_stride=ROW_STEP))
    some = np.s_[:, ::ROW_STEP]
    return TrueSweep(truth.surface[some], truth.point[some], truth.centre[some], truth.angle), records // count


def _seen(stage: Stage, seen: Room, rig: Rig, name: str, step: int) -> Seen:
    """Centres and points of every n-th record by one method; n is `step`."""
    if name != "ours":
        plain = seen.plain[_FINDER[name]]
        some = np.s_[::step, ::ROW_STEP]
        return Seen(_columns(plain, name)[some], plain.valid[some], _their_points(seen, rig, name, step)[:, ::ROW_STEP])
    few = Room(records_of(seen.stripes, step), {}, seen.angles[::step], seen.window)
    cloud, along = our_cloud(stage, few, rig.ours), smooth_sweep(few.stripes)
    valid = np.asarray(few.stripes.valid) & (along.sigma > 0)
    xyz = np.where(np.asarray(cloud.valid)[..., None], np.asarray(cloud.xyz), np.nan)
    return Seen(*(field[:, ::ROW_STEP] for field in (along.u, valid, xyz)))


def _columns(plain: PlainStripes, name: str) -> np.ndarray:
    return np.rint(plain.u) if name == "whole" else plain.u


def _their_points(seen: Room, rig: Rig, name: str, step: int) -> np.ndarray:
    """Points of every n-th record [records, rows, 3], m, with the origin on the axis and z up; n is `step`."""
    plain, theirs = seen.plain[_FINDER[name]], rig.theirs
    u, valid = _columns(plain, name)[::step], plain.valid[::step]
    xyz = horus_cloud(theirs, u, valid, seen.angles[::step], lens=name != "horus")
    # The axis' point at the height of the camera.
    foot = theirs.point - (theirs.point @ theirs.direction) * theirs.direction
    xyz = (xyz - foot) @ UPRIGHT.T
    far = np.linalg.norm(xyz, axis=-1, keepdims=True)
    return np.where(far < FARTHEST_M, xyz, np.nan)


def _size(stage: Stage, seen: Room, rig: Rig, name: str) -> Size:
    """The room by one calibration; NaN where no walls are found."""
    if name == "ours":
        return size_of(box_of(our_cloud(stage, thinned(seen), rig.ours), rig.ours))
    step = max(1, len(seen.angles) // PROFILES)
    xyz = _their_points(seen, rig, name, step)[:, ::ROW_STEP]
    if not np.isfinite(xyz).any():
        return NOT_MEASURED
    return size_of(box_of(points_of(xyz, seen.angles[::step])))


def _rows(seen: Seen, truth: TrueSweep) -> dict[str, float]:
    """Share of lit rows with a centre [%], rms error of the centres [px], and share of strays [%]."""
    lit = truth.surface >= 0
    there = lit & seen.valid
    error = (seen.u - truth.centre)[there]
    near = np.abs(error) < STRAY_PX
    return {
        "rows": 100 * float(there.sum() / lit.sum()),
        "stripe": rms(error[near]),
        "strays": 100 * float(np.mean(~near)) if len(near) else np.nan,
    }


def _patches(found: dict[str, Seen], truth: TrueSweep) -> list[np.ndarray]:
    """Parts of walls [records, rows] that all methods saw: no method is judged by near walls alone."""
    out = []
    for wall in range(4):
        on_wall = truth.surface == wall
        if not on_wall.any():
            continue
        middle = np.median(truth.point[on_wall], axis=0)
        patch = on_wall & (np.linalg.norm(truth.point - middle, axis=-1) < PATCH_M)
        for seen in found.values():
            patch &= np.isfinite(seen.xyz).all(-1)
        out += [patch] if patch.sum() >= 30 else []
    return out


def _flatness(seen: Seen, patches: list[np.ndarray]) -> float:
    """Root mean square distance of points from the planes of their patches [mm]."""
    return 1e3 * rms([fitted(seen.xyz[patch])[2] for patch in patches])


def _depth_error(stage: Stage, rigs: list[Rig], name: str, depth: float) -> float:
    """Root mean square error of the depth of points on the sheet, over the height of the image [mm]."""
    true = IdealRig(stage.config)
    camera, laser = stage.config.camera, stage.config.laser[0]
    y = depth * (np.linspace(0.05, 0.95, 33) * camera.height - camera.centre()[1]) / camera.fy
    (nx, ny, nz), d = laser.plane()
    x = (d - ny * y - nz * depth) / nx
    for _ in range(4):
        # The sheet may be bowed.
        x = x - true.beside(np.column_stack([x, y, np.full_like(y, depth)]), laser) / nx
    uv = true.project(np.column_stack([x, y, np.full_like(y, depth)]))
    errors = []
    for rig in rigs:
        if name == "ours":
            z = np.array([_on_our_sheet(rig.ours, q) for q in uv])
        else:
            uv = np.column_stack([np.rint(uv[:, 0]), uv[:, 1]]) if name == "whole" else uv
            z = horus_points(rig.theirs, uv, lens=name != "horus")[:, 2]
        errors.append(z - depth)
    return 1e3 * rms(errors)


def _on_our_sheet(scanner: jaxscan.Scanner, q: np.ndarray) -> float:
    return float(lit_points(scanner.rig, q, 0)[0][2])


def _axis_errors(stage: Stage, rigs: list[Rig], name: str) -> dict[str, float]:
    """Mean errors of the axis: its direction [deg], and its place at the height of the camera [mm]."""
    true = true_scanner(stage.config).turntable
    along, place = np.asarray(true.direction), np.asarray(true.point)
    turned, moved = [], []
    for rig in rigs:
        table = rig.ours.turntable if name == "ours" else rig.theirs
        direction, point = np.asarray(table.direction), np.asarray(table.point)
        cosine = direction @ along
        turned.append(np.rad2deg(np.arcsin(np.linalg.norm(np.cross(direction, along)))))
        moved.append(np.linalg.norm(point - direction * ((point - place) @ along) / cosine - place))
    return {"axis_direction": float(np.mean(turned)), "axis_place": 1e3 * float(np.mean(moved))}


def _metric(name: str, what: str, value: float) -> Metric:
    unit, label = UNITS[what]
    # Three standard errors of a figure of three calibrations, and the noise of another seed.
    tolerance = (
        0.02 * abs(value) + 0.5
        if what in ("rows", "strays", "measured")
        else (0.1 if what == "stripe" else 1.5) * value
    )
    direction = "none" if name != "ours" else "more" if what in ("rows", "measured") else "less"
    return Metric(f"{name}_{what}", value, unit, direction, tolerance, label=f"{WAYS[name]}: {label}")
