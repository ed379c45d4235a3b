"""Stops of a table that err by chance: learned, in the covariance, and told from faults that come back."""

from dataclasses import replace

import numpy as np
import pytest

from jaxscan.calibration import CalibrationSettings, calibrate_observations
from jaxscan.errors import CalibrationError


pytestmark = pytest.mark.more


SIGMA = 3e-4


def calibrated(observed, **settings):
    return calibrate_observations(observed, settings=CalibrationSettings(judge=False, **settings))


@pytest.fixture(scope="module")
def exact(world):
    return world.with_noise(world.observe(world.Rig(), placements=3, angles=5), 2)


def stopped_beside(observed, random):
    """The same images; the journal has the angles to which the table was sent."""
    corners = observed.corners
    turning = np.bincount(corners.placement)[corners.placement] > 1
    angle = corners.angle + SIGMA * turning * random.standard_normal(len(turning))
    return replace(observed, corners=replace(corners, angle=angle))


def axis_error(world, calibration):
    """Of the place of the axis, in stated standard deviations."""
    table, rig = calibration.scanner.turntable, world.Rig()
    error = np.asarray(table.basis) @ (np.asarray(table.point) - rig.foot())
    at = [calibration.order.index(name) for name in ("axis.p1", "axis.p2")]
    covariance = np.asarray(calibration.covariance)[np.ix_(at, at)]
    return float(np.sqrt(error @ np.linalg.solve(covariance, error) / 2.0))


def test_exact_stops_change_nothing(exact):
    learned, told = calibrated(exact), calibrated(exact, angle_sigma=0.0)
    assert learned.quality.angle_sigma == told.quality.angle_sigma == 0.0
    np.testing.assert_array_equal(learned.covariance, told.covariance)


@pytest.mark.more
def test_stops_are_learned_and_their_errors_stated(world, exact):
    found = [stopped_beside(exact, np.random.default_rng(seed)) for seed in range(6)]
    learned = [calibrated(one) for one in found]
    sizes = [one.quality.angle_sigma / SIGMA for one in learned]
    # By some eight independent stops beside faults that come back: good to a quarter each.
    assert np.mean(sizes) == pytest.approx(1.0, abs=0.35) and min(sizes) > 0.3
    # Corners keep their own noise.
    assert max(one.quality.corner_noise_over_sigma for one in learned) < 1.1
    size = lambda every: np.sqrt(np.mean([axis_error(world, one) ** 2 for one in every]))
    # Root mean square of twelve numbers of unit variance, three standard deviations; and of those that know nothing.
    assert size(learned) < 1.7 < size([calibrated(one, angle_sigma=0.0) for one in found])


def test_stops_are_as_good_as_the_settings_say(exact):
    found = stopped_beside(exact, np.random.default_rng(0))
    assert calibrated(found, angle_sigma=5e-4).quality.angle_sigma == pytest.approx(5e-4)
    with pytest.raises(CalibrationError, match="angle_sigma: found -1"):
        CalibrationSettings(angle_sigma=-1.0)


def test_an_error_that_comes_back_is_no_stop(world):
    observed = world.with_noise(world.observe(world.Rig(harmonics=(8e-3, 6e-3, 4e-3, 0.0)), placements=3), 1)
    assert calibrated(observed).quality.angle_sigma == 0.0
