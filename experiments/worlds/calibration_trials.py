"""Shared by the calibration experiments: noisy observations of a known rig."""

from pathlib import Path

import numpy as np

import jaxscan
from jaxscan.calibration import CalibrationSettings
from jaxscan.geometry import Scanner
from jaxscan.observation import BoardViews, Observations, StripeViews
from jaxscan.simulation import SimulationConfig, true_scanner

from .ideal_boards import IdealBoards


CORNER_PX, STRIPE_PX = 0.1, 0.15
CORRELATIONS = {"white": 0.0, "correlated": 0.6}
"""Noise along the stripe: between neighbouring points; at 0.6, n points are worth n / 4."""
SETTINGS = CalibrationSettings(judge=False)
"""The tests of the models take longer than the solve and are not looked at here."""
REFERENCE = Path(__file__).resolve().parents[2] / "configs" / "reference.toml"


def reference() -> SimulationConfig:
    """The rig that the targets refer to."""
    return jaxscan.load_simulation(REFERENCE)


def drawn(config: SimulationConfig, random: np.random.Generator) -> SimulationConfig:
    """The rig with values drawn from the priors where a calibration knows nothing else.

    Gain and harmonics of the table, and the ratio of the focal lengths: with their true values at the prior's mean in
    every trial, errors would be smaller than stated.
    """
    priors = SETTINGS.priors
    harmonics = {
        "gain": 1.0 + priors["gain"] * random.normal(),
        "harmonics": tuple(priors["harmonics"] * random.normal(size=4)),
    }
    camera = config.camera.model_copy(update={"fy": config.camera.fx / (1.0 + priors["aspect"] * random.normal())})
    return config.model_copy(update={"turntable": config.turntable.model_copy(update=harmonics), "camera": camera})


def observations(ideal: IdealBoards, config: SimulationConfig) -> Observations:
    """As the estimator takes them, with the standard deviations a detector would state."""
    views, corners = ideal.corner_q.shape[:2]
    return Observations(
        board=config.boards.board(),
        corners=BoardViews(
            q=ideal.corner_q,
            sigma=np.full((views, corners), CORNER_PX),
            valid=np.ones((views, corners), bool),
            angle=ideal.angle,
            placement=ideal.placement,
            record=np.arange(views, dtype=np.int32),
        ),
        stripes=StripeViews(
            q=ideal.stripe_q,
            sigma=np.full(ideal.stripe_valid.shape, STRIPE_PX),
            valid=ideal.stripe_valid,
            view=ideal.stripe_view,
            laser=ideal.stripe_laser,
        ),
        width=config.camera.width,
        height=config.camera.height,
        laser_names=tuple(laser.name for laser in config.laser),
        up=config.camera.up,
        carries=config.turntable.carries,
    )


def errors(scanner: Scanner, config: SimulationConfig) -> np.ndarray:
    """Estimate minus truth in the scanner's minimal coordinates, to first order."""
    camera, true = config.camera, true_scanner(config)
    lens = np.array([camera.k1, camera.k2, camera.p1, camera.p2, camera.k3])
    parts = [*(np.asarray(scanner.camera.parameters()) - np.array([camera.fx, camera.fy, *camera.centre(), *lens]))]
    for laser in range(len(config.laser)):
        # The truth as seen from the estimate's tangent vectors, hence the minus.
        parts += list(-scanner.lasers.basis[laser] @ true.lasers.normal[laser])
        parts += [scanner.lasers.distance[laser] - true.lasers.distance[laser]]
        parts += list(scanner.lasers.bow[laser] - true.lasers.bow[laser])
    table, axis = scanner.turntable, true.turntable
    parts += list(-table.basis @ axis.direction) + list(table.basis @ (table.point - axis.point))
    parts += [table.gain - axis.gain, *(table.harmonics - axis.harmonics)]
    return np.array(parts, float)


def to_true_tangents(scanner: Scanner, config: SimulationConfig) -> np.ndarray:
    """Matrix from coordinates in the estimate's tangent vectors to those in the truth's.

    The estimate's own may stand at a right angle to those of the next one: they are drawn beside
    the coordinate axis that a direction is farthest from, and of an upright axis that is a toss-up.
    """
    true, names = true_scanner(config), list(scanner.parameter_names())
    turned = np.eye(len(names))
    pairs = [("axis.d1", scanner.turntable.basis, true.turntable.basis)]
    pairs += [("axis.p1", scanner.turntable.basis, true.turntable.basis)]
    for index, name in enumerate(scanner.laser_names):
        pairs += [(f"laser.{name}.n1", scanner.lasers.basis[index], true.lasers.basis[index])]
    for first, own, wanted in pairs:
        at = slice(names.index(first), names.index(first) + 2)
        turned[at, at] = np.asarray(wanted) @ np.asarray(own).T
    return turned
