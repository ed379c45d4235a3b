"""Two sweeps of the demo's room from places 2 m apart."""

import importlib.resources
from typing import Any

import numpy as np

import jaxscan
from experiments.recalibration import world
from experiments.recalibration.calibrations import calibration_of, draw_truth
from experiments.recalibration.crossings import room_from_rig
from experiments.recalibration.trial import Task, fitted, wall_points
from experiments.recalibration.world import Sweeping, TrueSweep, moved
from jaxscan.geometry import Scanner
from jaxscan.recalibration import Recalibration, RecalibrationSettings
from jaxscan.simulation import Motion, SimulationConfig, true_scanner


APART_M = 2.0
STEPS = 180
TILT_DEG = 0.3
"""By about which a tripod leans, a standard deviation about each of two axes."""


def demo() -> SimulationConfig:
    """The rig and the room of `jaxscan demo`."""
    with importlib.resources.as_file(importlib.resources.files("jaxscan.data") / "demo.toml") as path:
        return jaxscan.load_simulation(path)


def two_stations(seed: int) -> Task:
    """Both places are drawn about the middle of the room; the second may be turned by any angle."""
    config = draw_truth(demo(), seed)
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
    true = _matrix(places[0].inverse() @ places[1])
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
    """The largest distance of a wall as the second station sees it from where the first does [mm]."""
    apart = []
    for wall in range(6):
        first, second = (wall_points(scanner, task, wall) for task in tasks)
        if len(first) > 300 and len(second) > 300:
            centre, normal, _ = fitted(first)
            middle = pose[:3, :3] @ fitted(second)[0] + pose[:3, 3]
            apart.append(abs((middle - centre) @ normal))
    return 1e3 * float(max(apart))


def _matrix(motion: Motion) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = motion.rotation, motion.translation
    return out


def _angle(motion: np.ndarray) -> float:
    cross = motion[:3, :3] - motion[:3, :3].T
    return float(np.linalg.norm([cross[2, 1], cross[0, 2], cross[1, 0]]) / 2)
