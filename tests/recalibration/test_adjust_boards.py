"""Boards that were captured with the rig as it is, beside the walls of a room."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.recalibration.trial import observations_of
from jaxscan.calibration import CalibrationSettings, calibrate_observations
from jaxscan.errors import CalibrationError
from jaxscan.recalibration import Start
from jaxscan.recalibration.adjust import adjust
from jaxscan.recalibration.adjust.boards import prepare_boards
from tests.recalibration.small_room import SIGMA, config, exact_sweep, observe, stored, truth_scanner


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_boards_show_the_size_that_walls_leave_open():
    random = np.random.default_rng(21)
    truth, room = truth_scanner(), exact_sweep(60, 64)
    # A calibration so poor that boards alone are better.
    prior = stored(truth, random, 4 * SIGMA)
    noise = 0.1 * random.standard_normal(int((room[1].surface >= 0).sum()))
    observations = observe(prior, noise, sweep_truth=room)
    boards = observations_of(config(), "paper-like", 3)
    walls = adjust(prior, Start(prior, np.eye(4)[None]), observations)
    both = adjust(prior, Start(prior, np.eye(4)[None]), observations._replace(boards=boards))
    names = truth.parameter_names()
    sigma = lambda result: np.sqrt(np.diag(result.scanner.covariance))
    alone = calibrate_observations(boards, settings=CalibrationSettings(judge=False))
    for name in ("fx", "fy", "laser.red.d"):
        k = names.index(name)
        assert sigma(both)[k] < 0.7 * sigma(walls)[k]
        # Walls and a stored calibration take nothing away; the noise that each learns differs by some per cent.
        assert sigma(both)[k] < 1.1 * np.sqrt(alone.covariance[k, k])
    free = sigma(both) > 0
    after, own = truth.departure(both.scanner)[free], both.scanner.covariance[np.ix_(free, free)]
    # 21 numbers: beyond 46.8 once in a thousand.
    assert after @ np.linalg.solve(own, after) < 46.8


def test_boards_of_another_camera_or_laser_are_refused():
    boards = observations_of(config(), "paper-like", 3)
    scanner = truth_scanner()
    with pytest.raises(CalibrationError, match="give captures of this camera mode"):
        prepare_boards(replace(boards, width=boards.width + 1), scanner)
    with pytest.raises(CalibrationError, match="lit by laser 'blue'"):
        prepare_boards(replace(boards, laser_names=("blue",)), scanner)
