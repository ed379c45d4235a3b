"""The kinds of trials: worlds, stored calibrations and sweeps, each from a seed."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

import jaxscan
from experiments.recalibration import world
from experiments.recalibration.calibrations import Kind, calibration_of, draw_truth
from experiments.recalibration.features import features_of
from experiments.recalibration.stations import two_stations
from experiments.recalibration.surfaces import curved, stepped
from experiments.recalibration.trial import Task
from experiments.recalibration.world import UNKIND, Sweeping
from jaxscan.calibration import Calibration
from jaxscan.recalibration import Given, RecalibrationSettings, recalibrate
from jaxscan.simulation import SimulationConfig, true_scanner


CONFIGS = Path(__file__).resolve().parents[2] / "configs"
SWEEPS = {
    "paper": Sweeping(steps=360, line_stride=4),
    "unkind": Sweeping(steps=120),
}
"""A tenth of the records of `configs/paper.toml` and every fourth row; all of `configs/unkind.toml`."""


def load(name: str) -> SimulationConfig:
    """A rig and its room."""
    return jaxscan.load_simulation(CONFIGS / f"{name}.toml")


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
    how = replace(SWEEPS["paper"], wander_deg=width / np.sqrt(12.0))
    return task_of(config, calibration_of(config, kind, seed, width), seed, how)


def with_features(seed: int, kind: Kind) -> Task:
    """Features are followed in the laser-off images too, round the whole turn."""
    config = draw_truth(load("paper"), seed)
    task = task_of(config, calibration_of(config, kind, seed), seed, SWEEPS["paper"])
    _, truth = world.true_sweep(config, seed, SWEEPS["paper"])
    return task._replace(given=Given(tracks=features_of(config, truth, seed)))


def closed(seed: int, turn_deg: float) -> Task:
    """A sweep that overlaps itself, or one of a table whose turn is known to be a turn."""
    how = replace(SWEEPS["paper"], steps=round(turn_deg), turn_deg=turn_deg)
    if turn_deg > 360:
        return plain(seed, "paper", "paper-like", how)
    config = draw_truth(load("paper"), seed)
    table = config.turntable.model_copy(update={"gain": 1.0})
    task = plain_of(config.model_copy(update={"turntable": table}), "paper-like", seed, how)
    return task._replace(settings=RecalibrationSettings(closed=True))


def plain_of(config: SimulationConfig, kind: Kind, seed: int, how: Sweeping) -> Task:
    """As `plain`, of a given rig."""
    return task_of(config, calibration_of(config, kind, seed), seed, how)


def drifted(seed: int, part: str, twice: bool) -> Task:
    """A part has moved since the calibration.

    `twice`: since a first recalibration with a sweep, which knows the axis to 0.02 mm; boards alone know it to 0.2 mm.
    """
    config = draw_truth(load("paper"), seed)
    stored = calibration_of(config, "good", seed)
    if twice:
        first = task_of(config, stored, 1000 + seed, SWEEPS["paper"])
        result = recalibrate(first.sweeps, stored)
        stored = replace(stored, scanner=result.scanner, covariance=np.asarray(result.scanner.covariance))
    if part == "laser":
        config = world.turn_laser(config, 0.05, seed)
    elif part == "axis":
        config = world.shift_axis(config, 2e-4, seed)
    return task_of(config, stored, seed, SWEEPS["paper"])


def wrong_table(seed: int, factor: float, lost_deg: float) -> Task:
    """A journal that counts other steps than the table takes, or a step lost in the middle third of the sweep."""
    how = replace(SWEEPS["paper"], factor=factor)
    if not lost_deg:
        return plain(seed, "paper", "good", how)
    record = int(np.random.default_rng([seed, 87]).integers(how.steps // 3, 2 * how.steps // 3))
    task = plain(seed, "paper", "good", replace(how, lost=(record, -lost_deg)))
    return task._replace(known={"lost": [record, -lost_deg]})


def not_flat(seed: int, shape: str) -> Task:
    """One wall is curved by 10 mm or has a step of 10 mm."""
    config = draw_truth(load("paper"), seed)
    assert config.room is not None
    room = config.room.model_copy(update={"furniture": False})
    extras = curved(room, 0.010) if shape == "curved" else stepped(room, 0.010)
    return plain_of(config, "paper-like", seed, replace(SWEEPS["paper"], furniture=False, extras=extras))


PAPER, UNKIND_SWEEP = SWEEPS["paper"], replace(SWEEPS["unkind"], noise=UNKIND)
ROUGH = replace(PAPER, rough_m=5e-4, rough_length_m=0.05)
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
    "3200 steps for 6400": partial(wrong_table, factor=0.5, lost_deg=0.0),
    "6400 steps for 3200": partial(wrong_table, factor=2.0, lost_deg=0.0),
    "a step of 1.8 degrees lost": partial(wrong_table, factor=1.0, lost_deg=1.8),
    "a step of 0.2 degrees lost": partial(wrong_table, factor=1.0, lost_deg=0.2),
    "overlap of 30 degrees": partial(closed, turn_deg=390.0),
    "a turn known to be closed": partial(closed, turn_deg=360.0),
    "two stations": two_stations,
    "a curved wall": partial(not_flat, shape="curved"),
    "a stepped wall": partial(not_flat, shape="stepped"),
}
"""Every kind makes one task from a seed."""
