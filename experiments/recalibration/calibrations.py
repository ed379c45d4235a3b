"""Calibrations of known quality for a known rig, from exact boards with noise."""

from functools import lru_cache
from typing import Literal

import numpy as np

from experiments.worlds import calibration_trials as trials
from experiments.worlds.ideal_boards import BoardPoses, PosePlan, add_noise, draw_poses, ideal_boards
from jaxscan.calibration import PRIORS, USUALLY_FREE, Calibration, CalibrationSettings, calibrate_observations
from jaxscan.observation import Observations
from jaxscan.simulation import SimulationConfig


Kind = Literal["paper-like", "good"]
PLANS: dict[Kind, PosePlan] = {
    # 23 views of which 4 are lit; one board at two angles 10 degrees apart.
    "paper-like": PosePlan(free_views=21, lit=2, placements=1, angles=2, span_deg=10.0),
    # 30 lit views, and 4 boards at 9 angles over +-12 degrees.
    "good": PosePlan(free_views=30, placements=4, angles=9, span_deg=24.0),
}
"""Plans of the boards' poses, which are drawn anew in every trial."""
POINTS = 150
"""Of each stripe."""


def draw_truth(config: SimulationConfig, seed: int) -> SimulationConfig:
    """The rig with values drawn from the priors where a calibration knows nothing else.

    Gain and harmonics of the table, and the ratio of the focal lengths: with their true values at the prior's mean in
    every trial, errors would be smaller than stated.
    """
    random = np.random.default_rng([seed, 81])
    table = config.turntable.model_copy(
        update={
            "gain": 1.0 + PRIORS["gain"] * random.normal(),
            "harmonics": tuple(PRIORS["harmonics"] * random.normal(size=4)),
        }
    )
    camera = config.camera.model_copy(update={"fy": config.camera.fx / (1.0 + PRIORS["aspect"] * random.normal())})
    return config.model_copy(update={"turntable": table, "camera": camera})


def observations_of(config: SimulationConfig, kind: Kind, seed: int, stop_deg: float = 0.0) -> Observations:
    """Noisy corners and stripes of boards: 0.1 px and 0.15 px; of a table that stops anywhere within `stop_deg`."""
    poses = _poses(_plain(config), seed, PLANS[kind])
    beside = np.deg2rad(stop_deg) * np.random.default_rng([seed, 89]).uniform(-0.5, 0.5, len(poses.angle))
    ideal = ideal_boards(config, poses._replace(angle=poses.angle + beside), points=POINTS)
    seen = add_noise(ideal, np.random.default_rng([seed, 82]))
    return trials.observations(seen._replace(angle=poses.angle), config)


def calibration_of(config: SimulationConfig, kind: Kind, seed: int, stop_deg: float = 0.0) -> Calibration:
    """A calibration of the configuration's rig.

    Args:
        config: The true rig.
        kind: "paper-like" or "good".
        seed: Of poses and noise.
        stop_deg: Width within which the table stops anywhere [deg].

    A bow of the sheet is free where the true sheet has one: jaxscan's own calibration would find it.
    """
    bowed = any(any(laser.bow) for laser in config.laser)
    free = USUALLY_FREE if bowed else tuple(block for block in USUALLY_FREE if block != "bow")
    settings = CalibrationSettings(judge=False, free=free)
    return calibrate_observations(observations_of(config, kind, seed, stop_deg), settings=settings)


def _plain(config: SimulationConfig) -> SimulationConfig:
    """Without the values that `draw_truth` draws: poses do not depend on them."""
    table = config.turntable.model_copy(update={"gain": 1.0, "harmonics": (0.0, 0.0, 0.0, 0.0)})
    camera = config.camera.model_copy(update={"fy": config.camera.fx})
    return config.model_copy(update={"turntable": table, "camera": camera})


@lru_cache(maxsize=8)
def _poses(config: SimulationConfig, seed: int, plan: PosePlan) -> BoardPoses:
    return draw_poses(config, seed, plan)
