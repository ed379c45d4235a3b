"""One recalibration and its errors, before and after, of a calibration of known quality from boards with noise."""

import resource
import time
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import jax
import numpy as np

from experiments import exact_rig
from experiments.exact_rig import BoardPoses, PosePlan, add_noise, draw_poses, ideal_boards
from experiments.plain import principal_axes
from experiments.report import rms
from jaxscan.calibration import (
    USUALLY_FREE,
    Calibration,
    CalibrationSettings,
    calibrate_observations,
    length_sigma,
    measure_lengths,
    typical_lengths,
)
from jaxscan.errors import JaxscanError
from jaxscan.geometry import Scanner, points
from jaxscan.observation import Observations
from jaxscan.recalibration import Given, Recalibration, RecalibrationSettings, SweepStripes, recalibrate
from jaxscan.simulation import SimulationConfig


Kind = Literal["paper-like", "good"]
PLANS: dict[Kind, PosePlan] = {
    # 23 views of which 4 are lit; one board at two angles 10 degrees apart.
    "paper-like": PosePlan(free_views=21, lit=2, placements=1, angles=2, span_deg=10.0),
    # 30 lit views, and 4 boards at 9 angles over +-12 degrees.
    "good": PosePlan(free_views=30, placements=4, angles=9, span_deg=24.0),
}
"""Plans of the boards' poses, which are drawn anew in every trial."""
STRIPE_POINTS = 150
"""Points of each stripe."""


def draw_truth(config: SimulationConfig, seed: int) -> SimulationConfig:
    """The rig with values drawn from the priors where a calibration knows nothing else."""
    return exact_rig.drawn(config, np.random.default_rng([seed, 81]))


def observations_of(config: SimulationConfig, kind: Kind, seed: int, stop_deg: float = 0.0) -> Observations:
    """Noisy corners and stripes of boards: 0.1 px and 0.15 px; of a table that stops anywhere within `stop_deg`."""
    poses = _poses(_nominal(config), seed, PLANS[kind])
    beside = np.deg2rad(stop_deg) * np.random.default_rng([seed, 89]).uniform(-0.5, 0.5, len(poses.angle))
    ideal = ideal_boards(config, poses._replace(angle=poses.angle + beside), points=STRIPE_POINTS)
    seen = add_noise(ideal, np.random.default_rng([seed, 82]))
    return exact_rig.observations(seen._replace(angle=poses.angle), config)


def calibration_of(config: SimulationConfig, kind: Kind, seed: int, stop_deg: float = 0.0) -> Calibration:
    """A calibration of the configuration's rig; `seed` draws poses and noise, stops are as of `observations_of`.

    A bow of the sheet is free where the true sheet has one: jaxscan's own calibration would find it.
    """
    bowed = any(any(laser.bow) for laser in config.laser)
    free = USUALLY_FREE if bowed else tuple(block for block in USUALLY_FREE if block != "bow")
    settings = CalibrationSettings(judge=False, free=free)
    return calibrate_observations(observations_of(config, kind, seed, stop_deg), settings=settings)


def _nominal(config: SimulationConfig) -> SimulationConfig:
    """The rig before `draw_truth` changed it, so that board poses do not depend on the values drawn."""
    table = config.turntable.model_copy(update={"gain": 1.0, "harmonics": (0.0, 0.0, 0.0, 0.0)})
    camera = config.camera.model_copy(update={"fy": config.camera.fx})
    return config.model_copy(update={"turntable": table, "camera": camera})


@lru_cache(maxsize=8)
def _poses(config: SimulationConfig, seed: int, plan: PosePlan) -> BoardPoses:
    return draw_poses(config, seed, plan)


POINTS = 4000
"""Points of each wall, from which its place is judged."""
CLOSURE_M = 2.5


class Task(NamedTuple):
    """All that goes into one recalibration, and the truth by which it is judged."""

    stored: Calibration
    sweeps: Sequence[SweepStripes]
    truth: Scanner
    """The rig as it was during the sweeps."""
    walls: np.ndarray
    """Number of the wall of each centre of the first sweep [profiles, lines]; negative elsewhere."""
    apart: tuple[tuple[int, int, float], ...] = ()
    """Pairs of opposite walls, and their distance [m]."""
    settings: RecalibrationSettings = RecalibrationSettings()
    given: Given = Given()
    known: Mapping[str, Any] = {}
    """Figures that the world itself gives, kept as they are."""
    more: Callable[[Recalibration], dict[str, Any]] | None = None
    """More figures of the result."""


def run(task: Task) -> tuple[dict[str, Any], Recalibration | None]:
    """Figures of one recalibration as JSON holds them, and the result; none where it raised an error of jaxscan."""
    started, before = time.perf_counter(), task.stored.scanner
    assert before is not None
    try:
        result = recalibrate(task.sweeps, task.stored, task.settings, task.given)
    except JaxscanError as problem:
        return {"problem": str(problem), "seconds": time.perf_counter() - started}, None
    seconds = time.perf_counter() - started
    figures = {
        "lengths": lengths(before, result.scanner, task.truth),
        "walls": walls(task, result.scanner),
        "closure_mm": [open_after_a_turn(scanner, task.truth) for scanner in (before, result.scanner)],
        "parameters": parameters(before, result.scanner, task.truth),
        **statements(result),
        **task.known,
        **(task.more(result) if task.more else {}),
        "seconds": seconds,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }
    return rounded(figures), result


def lengths(before: Scanner, after: Scanner, truth: Scanner) -> list[dict[str, Any]]:
    """Errors and stated sigmas of the lengths by which a rig is judged [mm]."""
    every = typical_lengths(truth, 0)
    true = measure_lengths(truth, every)
    columns = {
        "before": 1e3 * (measure_lengths(before, every) - true),
        "after": 1e3 * (measure_lengths(after, every) - true),
        "sigma_before": 1e3 * length_sigma(before, every),
        "sigma_after": 1e3 * length_sigma(after, every),
    }
    return [
        {"name": length.name, "metres": float(true[k]), **{name: float(values[k]) for name, values in columns.items()}}
        for k, length in enumerate(every)
    ]


def walls(task: Task, after: Scanner) -> dict[str, Any]:
    """Errors of the distances of opposite walls before and after [mm]."""
    planes = []
    for scanner in (task.stored.scanner, after):
        points = {wall: wall_points(scanner, task, wall) for wall in range(6)}
        planes.append({wall: fitted(found) for wall, found in points.items() if len(found) > 50})
    apart = []
    for first, second, metres in task.apart:
        if all({first, second} <= found.keys() for found in planes):
            before, now = (1e3 * (distance(found[first], found[second]) - metres) for found in planes)
            apart.append({"walls": [first, second], "before": before, "after": now})
    return {"apart": apart}


def wall_points(scanner: Scanner, task: Task, wall: int) -> np.ndarray:
    """Points of one wall in the scanner's frame [n, 3]."""
    sweep = task.sweeps[0]
    profile, line = np.nonzero((task.walls == wall) & sweep.valid)
    some = np.unique(np.linspace(0, len(profile) - 1, min(POINTS, len(profile))).astype(int)) if len(profile) else []
    profile, line = profile[some], line[some]
    across, along = sweep.centre[profile, line], line.astype(float)
    q = np.stack([across, along] if sweep.stripe_axis == "rows" else [along, across], -1)
    angle = sweep.angle[sweep.record[profile]]
    return np.asarray(points(scanner.rig, q, sweep.laser[profile], angle))


def fitted(points: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Centre and normal of a plane through points, and their root mean square from it [m]; strays left out."""
    for _ in range(4):
        centre, (_, _, normal) = principal_axes(points)
        off = (points - centre) @ normal
        size = rms(off)
        points = points[np.abs(off) < 4 * max(size, 1e-6)]
    return centre, normal, size


def distance(first: tuple[np.ndarray, np.ndarray, float], second: tuple[np.ndarray, np.ndarray, float]) -> float:
    """Distance of two nearly parallel planes along their mean normal, between their centres [m]."""
    mean = first[1] + np.sign(first[1] @ second[1]) * second[1]
    return float(abs((second[0] - first[0]) @ mean) / np.linalg.norm(mean))


def open_after_a_turn(scanner: Scanner, truth: Scanner) -> float:
    """By how much a point at 2.5 m is misplaced after one turn more than the truth says [mm]."""
    with jax.enable_x64(True):
        error = float(scanner.turntable.gain) - float(truth.turntable.gain)
    return 1e3 * CLOSURE_M * 2 * np.pi * error


def parameters(before: Scanner, after: Scanner, truth: Scanner) -> dict[str, list[float]]:
    """Errors and stated sigmas of sheet and axis in minimal coordinates: before, sigma, after, sigma.

    The other parameters do not drift. Errors are along the estimate's own tangent vectors.
    """
    out: dict[str, list[float]] = {}
    for scanner in (before, after):
        names = scanner.parameter_names()
        sigma = dict(zip(names, np.sqrt(np.maximum(np.diag(np.asarray(scanner.covariance)), 0.0)), strict=True))
        errors: dict[str, float] = {}
        for index, name in enumerate(scanner.laser_names):
            own, true = scanner.lasers, truth.lasers
            tilt = -np.asarray(own.basis[index]) @ np.asarray(true.normal[index])
            errors |= {f"laser.{name}.n{k + 1}": float(tilt[k]) for k in range(2)}
            errors[f"laser.{name}.d"] = float(own.distance[index] - true.distance[index])
        table, axis = scanner.turntable, truth.turntable
        tilt, shift = -table.basis @ axis.direction, table.basis @ (table.point - axis.point)
        errors |= {f"axis.d{k + 1}": float(tilt[k]) for k in range(2)}
        errors |= {f"axis.p{k + 1}": float(shift[k]) for k in range(2)}
        for name, error in errors.items():
            out.setdefault(name, []).extend([error, float(sigma[name])])
    return out


def statements(result: Recalibration) -> dict[str, Any]:
    """What a recalibration says of drift and table."""
    drift, table = result.drift, result.table
    return {
        "updated": result.updated,
        "refused": result.refused,
        "drift": {"p": drift.p, "part": drift.part},
        "table": {"jumps": [list(jump) for jump in table.jumps], "sentences": list(table.sentences)},
    }


def rounded(value: Any) -> Any:
    """The same with six significant digits."""
    if isinstance(value, dict):
        return {str(key): rounded(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(part) for part in value]
    if isinstance(value, float | np.floating):
        return float(f"{float(value):.6g}")
    return value.item() if isinstance(value, np.generic) else value
