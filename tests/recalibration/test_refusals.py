"""Sweeps by which no calibration may be updated, from end to end: each ends in one line that says why."""

import numpy as np
import pytest

from experiments.recalibration.world import Noise, Sweeping, true_sweep, turn_laser
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


def of_another_rig():
    """Its laser stands 3 degrees elsewhere."""
    return true_sweep(turn_laser(config(), 3.0, 3), 5, HOW)[0]


@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    ("sweep", "said"),
    [
        (one_wall, "the planes found face 1 direction, expected at least 2"),
        (of_another_rig, "found no plane, expected flat walls"),
    ],
)
def test_no_calibration_is_updated(sweep, said):
    text = refused(sweep())
    assert said in text and "\n" not in text
