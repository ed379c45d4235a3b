"""The kinds of trials: worlds, stored calibrations and sweeps, each from a seed; stations too."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

import jaxscan
from experiments.recalibration import world
from experiments.recalibration.trial import Kind, Task, calibration_of, draw_truth, fitted, wall_points
from experiments.recalibration.world import (
    UNKIND,
    Sweeping,
    TrueSweep,
    curved,
    features_of,
    moved,
    room_from_rig,
    stepped,
)
from experiments.report import ROOT
from jaxscan.calibration import Calibration
from jaxscan.geometry import Scanner
from jaxscan.recalibration import Given, Recalibration, RecalibrationSettings, recalibrate
from jaxscan.simulation import Motion, SimulationConfig, true_scanner


APART_M = 2.0
STEPS = 180
TILT_DEG = 0.3
"""Standard deviation of the lean of a tripod about each of two axes."""


def two_stations(seed: int) -> Task:
    """Both places are drawn about the middle of the room of `jaxscan demo`; the second may be turned by any angle."""
    config = draw_truth(jaxscan.load_simulation(ROOT / "jaxscan" / "data" / "demo.toml"), seed)
    assert config.room is not None
    random = np.random.default_rng([seed, 88])
    middle, way = np.array(config.room.size_m[:2]) / 2, random.uniform(0, 2 * np.pi)
    middle = middle + random.uniform(-0.2, 0.2, 2)
    half = APART_M / 2 * np.array([np.cos(way), np.sin(way)])
    rigs, sweeps, truths, places = [], [], [], []
    for station, sign in enumerate((-1, 1)):
        where = (*(middle + sign * half), float(1.2 + random.uniform(-0.02, 0.02) * station))
        rigs.append(moved(config, tuple(float(x) for x in where), float(random.uniform(0, 360))))
        tilt = tuple(TILT_DEG * random.standard_normal(2)) if station else (0.0, 0.0)
        how = Sweeping(steps=STEPS, station=station, tilt_deg=tilt)
        stripes, truth = world.true_sweep(rigs[-1], 2 * seed + station, how)
        sweeps.append(stripes)
        truths.append(truth)
        places.append(room_from_rig(rigs[-1], tilt))
    walls = [np.where(truth.surface < 6, truth.surface, -1) for truth in truths]
    size = config.room.size_m
    task = Task(
        calibration_of(config, "good", seed),
        sweeps,
        true_scanner(config),
        walls[0],
        tuple((2 * axis, 2 * axis + 1, size[axis]) for axis in range(3)),
        settings=RecalibrationSettings(stations=True),
    )
    return task._replace(more=lambda result: {"station": judged(result, task, walls[1], truths, places)})


def judged(
    result: Recalibration, task: Task, walls: np.ndarray, truths: list[TrueSweep], places: list[Motion]
) -> dict[str, Any]:
    """Errors of the second station's pose, and the distance of walls as both stations see them.

    The frame of a station hangs on the scanner's axis, which has an error of its own. So each station's points are
    laid on the truth first; a pose between them is then right if it carries the one onto the other.
    """
    scanner, pose = result.scanner, np.asarray(result.adjusted.stations[1])
    tasks = [task, task._replace(sweeps=[task.sweeps[1]], walls=walls)]
    laid = [_lay(scanner, one, truth) for one, truth in zip(tasks, truths, strict=True)]
    between, true = places[0].inverse() @ places[1], np.eye(4)
    true[:3, :3], true[:3, 3] = between.rotation, between.translation
    error = np.linalg.inv(true) @ laid[0] @ pose @ np.linalg.inv(laid[1])
    covariance = np.asarray(result.adjusted.station_covariance[1])
    shift, turn = 1e3 * np.linalg.norm(error[:3, 3]), 1e3 * _angle(error)
    sigma = [1e3 * float(np.sqrt(np.trace(covariance[part, part]))) for part in (slice(0, 3), slice(3, 6))]
    return {
        "place_mm": shift,
        "place_mm_sigmas": shift / sigma[0],
        "turn_mrad": turn,
        "turn_mrad_sigmas": turn / sigma[1],
        "walls_mm": _walls(scanner, tasks, pose),
    }


def _lay(scanner: Scanner, task: Task, truth: TrueSweep) -> np.ndarray:
    """The motion that lays a station's points on the true ones in its true frame [4, 4]."""
    sweep = task.sweeps[0]
    seen = np.concatenate([wall_points(scanner, task, wall) for wall in range(6)])
    exact = sweep._replace(centre=np.where(truth.surface >= 0, truth.centre, sweep.centre))
    true = np.concatenate([wall_points(task.truth, task._replace(sweeps=[exact]), wall) for wall in range(6)])
    near = np.linalg.norm(seen - true, axis=1) < 0.05
    seen, true = seen[near], true[near]
    middle, goal = seen.mean(0), true.mean(0)
    left, _, right = np.linalg.svd((true - goal).T @ (seen - middle))
    out = np.eye(4)
    out[:3, :3] = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
    out[:3, 3] = goal - out[:3, :3] @ middle
    return out


def _walls(scanner: Scanner, tasks: list[Task], pose: np.ndarray) -> float:
    """How far apart both stations place the same wall, the largest of all walls [mm]."""
    apart = []
    for wall in range(6):
        first, second = (wall_points(scanner, task, wall) for task in tasks)
        if len(first) > 300 and len(second) > 300:
            centre, normal, _ = fitted(first)
            middle = pose[:3, :3] @ fitted(second)[0] + pose[:3, 3]
            apart.append(abs((middle - centre) @ normal))
    return 1e3 * float(max(apart))


def _angle(motion: np.ndarray) -> float:
    cross = motion[:3, :3] - motion[:3, :3].T
    return float(np.linalg.norm([cross[2, 1], cross[0, 2], cross[1, 0]]) / 2)


PAPER, UNKIND_SWEEP = Sweeping(steps=360, line_stride=4), Sweeping(steps=120, noise=UNKIND)
"""A tenth of the records of `configs/paper.toml` and every fourth row; all of `configs/unkind.toml`."""
ROUGH = replace(PAPER, rough_m=5e-4, rough_length_m=0.05)


def load(name: str) -> SimulationConfig:
    """A rig and its room."""
    return jaxscan.load_simulation(ROOT / "configs" / f"{name}.toml")


def task_of(config: SimulationConfig, stored: Calibration, seed: int, how: Sweeping) -> Task:
    """A sweep of the rig as it is, against a stored calibration."""
    assert config.room is not None
    stripes, truth = world.true_sweep(config, seed, how)
    apart = ((0, 1, config.room.size_m[0]), (2, 3, config.room.size_m[1]))
    return Task(stored, [stripes], true_scanner(config), np.where(truth.surface < 6, truth.surface, -1), apart)


def plain(seed: int, name: str, kind: Kind, how: Sweeping) -> Task:
    """Nothing has moved since the calibration."""
    config = draw_truth(load(name), seed)
    return task_of(config, calibration_of(config, kind, seed), seed, how)


def stopping(seed: int, kind: Kind) -> Task:
    """The table stops anywhere within a microstep of 28 800 a turn, before the boards and in the room."""
    config, width = draw_truth(load("paper"), seed), 360.0 / 28_800
    how = replace(PAPER, wander_deg=width / np.sqrt(12.0))
    return task_of(config, calibration_of(config, kind, seed, width), seed, how)


def with_features(seed: int, kind: Kind) -> Task:
    """Features are followed in the laser-off images too, round the whole turn."""
    config = draw_truth(load("paper"), seed)
    task = task_of(config, calibration_of(config, kind, seed), seed, PAPER)
    _, truth = world.true_sweep(config, seed, PAPER)
    return task._replace(given=Given(tracks=features_of(config, truth, seed)))


def closed(seed: int, turn_deg: float) -> Task:
    """A sweep that overlaps itself, or one of a table whose turn is known to be a turn."""
    how = replace(PAPER, steps=round(turn_deg), turn_deg=turn_deg)
    if turn_deg > 360:
        return plain(seed, "paper", "paper-like", how)
    config = draw_truth(load("paper"), seed)
    table = config.turntable.model_copy(update={"gain": 1.0})
    closed_table = config.model_copy(update={"turntable": table})
    task = task_of(closed_table, calibration_of(closed_table, "paper-like", seed), seed, how)
    return task._replace(settings=RecalibrationSettings(closed=True))


def drifted(seed: int, part: str, twice: bool) -> Task:
    """A part has moved since the calibration.

    `twice`: since a first recalibration with a sweep, which knows the axis to 0.02 mm; boards alone know it to 0.2 mm.
    """
    config = draw_truth(load("paper"), seed)
    stored = calibration_of(config, "good", seed)
    if twice:
        first = task_of(config, stored, 1000 + seed, PAPER)
        result = recalibrate(first.sweeps, stored)
        stored = replace(stored, scanner=result.scanner, covariance=np.asarray(result.scanner.covariance))
    if part == "laser":
        config = world.turn_laser(config, 0.05, seed)
    elif part == "axis":
        config = world.shift_axis(config, 2e-4, seed)
    return task_of(config, stored, seed, PAPER)


def wrong_table(seed: int, lost_deg: float) -> Task:
    """A step lost in the middle third of the sweep."""
    how = PAPER
    record = int(np.random.default_rng([seed, 87]).integers(how.steps // 3, 2 * how.steps // 3))
    task = plain(seed, "paper", "good", replace(how, lost=(record, -lost_deg)))
    return task._replace(known={"lost": [record, -lost_deg]})


def not_flat(seed: int, shape: str) -> Task:
    """One wall is curved by 10 mm or has a step of 10 mm."""
    config = draw_truth(load("paper"), seed)
    assert config.room is not None
    room = config.room.model_copy(update={"furniture": False})
    extras = curved(room, 0.010) if shape == "curved" else stepped(room, 0.010)
    how = replace(PAPER, furniture=False, extras=extras)
    return task_of(config, calibration_of(config, "paper-like", seed), seed, how)


KINDS: dict[str, Callable[[int], Task]] = {
    "paper-like": partial(plain, name="paper", kind="paper-like", how=PAPER),
    "good": partial(plain, name="paper", kind="good", how=PAPER),
    "paper-like, features": partial(with_features, kind="paper-like"),
    "good, features": partial(with_features, kind="good"),
    "paper-like, rough walls": partial(plain, name="paper", kind="paper-like", how=ROUGH),
    "good, rough walls": partial(plain, name="paper", kind="good", how=ROUGH),
    "unkind, paper-like": partial(plain, name="unkind", kind="paper-like", how=UNKIND_SWEEP),
    "unkind, good": partial(plain, name="unkind", kind="good", how=UNKIND_SWEEP),
    "paper-like, stops": partial(stopping, kind="paper-like"),
    "good, stops": partial(stopping, kind="good"),
    "laser turned": partial(drifted, part="laser", twice=False),
    "axis shifted": partial(drifted, part="axis", twice=False),
    "laser turned since a recalibration": partial(drifted, part="laser", twice=True),
    "axis shifted since a recalibration": partial(drifted, part="axis", twice=True),
    "nothing moved since a recalibration": partial(drifted, part="nothing", twice=True),
    "a step of 1.8 degrees lost": partial(wrong_table, lost_deg=1.8),
    "a step of 0.2 degrees lost": partial(wrong_table, lost_deg=0.2),
    "overlap of 30 degrees": partial(closed, turn_deg=390.0),
    "a turn known to be closed": partial(closed, turn_deg=360.0),
    "two stations": two_stations,
    "a curved wall": partial(not_flat, shape="curved"),
    "a stepped wall": partial(not_flat, shape="stepped"),
}
"""Every kind makes one task from a seed."""
