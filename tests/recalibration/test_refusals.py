"""Sweeps by which no calibration may be updated, from end to end: each ends in one line that says why."""

import numpy as np
import pytest

from experiments.recalibration.world import Noise, Sweeping, moved, true_sweep
from jaxscan.calibration import Calibration
from jaxscan.errors import CalibrationError
from jaxscan.recalibration import RecalibrationSettings, recalibrate

from .linear_room import GOOD
from .small_room import config, truth_scanner, with_covariance


HOW = Sweeping(steps=180, line_stride=24, furniture=False, noise=Noise(px=0.1, shared_lines=1))


def refused(sweep):
    """The one line by which a sweep is refused."""
    scanner = with_covariance(truth_scanner(), np.diag(GOOD**2))
    stored = Calibration(scanner.camera, scanner, scanner.parameter_names(), np.asarray(scanner.covariance))
    try:
        result = recalibrate([sweep], stored, RecalibrationSettings(points=5_000))
    except CalibrationError as problem:
        return str(problem)
    assert result.updated == (not result.refused) and (result.updated or result.scanner is stored.scanner)
    return result.refused


def one_wall():
    sweep, truth = true_sweep(config(), 5, HOW)
    return sweep._replace(valid=sweep.valid & (truth.surface == 0))


def pushed():
    """The tripod was pushed by 20 mm after half of the turn."""
    sweep, _ = true_sweep(config(), 5, HOW)
    room = config().room
    x, y, z = room.rig_m
    other, _ = true_sweep(moved(config(), (x + 0.02, y + 0.01, z), room.yaw_deg), 6, HOW)
    late = np.asarray(sweep.record)[:, None] >= 90
    return sweep._replace(
        centre=np.where(late, other.centre, sweep.centre), valid=np.where(late, other.valid, sweep.valid)
    )


def bent():
    """Walls that bulge: every stripe is as if its wall had a barrel of its own."""
    sweep, _ = true_sweep(config(), 5, HOW)
    line = np.linspace(-1.0, 1.0, sweep.centre.shape[1])
    return sweep._replace(centre=sweep.centre + 8.0 * np.cos(6.0 * line))


@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    ("sweep", "said"),
    [(one_wall, r"the planes found face 1 direction, expected at least 2")],
)
def test_no_calibration_is_updated(sweep, said):
    text = refused(sweep())
    assert said in text and "\n" not in text
