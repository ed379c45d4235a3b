"""A recalibration from end to end: exact stripes of a known room with noise, and stored calibrations that are wrong."""

from functools import lru_cache

import numpy as np
import pytest

from experiments.recalibration.world import Noise, Sweeping, sweep_of, turn_laser
from jaxscan.calibration import Calibration
from jaxscan.errors import CalibrationError
from jaxscan.recalibration import (
    Given,
    MeasuredLength,
    RecalibrationSettings,
    Start,
    recalibrate,
)
from jaxscan.recalibration.adjust import departure
from jaxscan.recalibration.lengths import place_lengths

from .linear_room import GOOD
from .small_room import config, observe, stored, truth_scanner, with_covariance


SETTINGS = RecalibrationSettings(points=5_000)


def calibration_of(scanner):
    return Calibration(scanner.camera, scanner, scanner.parameter_names(), np.asarray(scanner.covariance))


@lru_cache(maxsize=4)
def sweep(laser_deg=0.0):
    # Noise that is independent from line to line, and no more lines than are used.
    how = Sweeping(steps=180, line_stride=24, furniture=False, noise=Noise(px=0.1, shared_lines=1))
    return sweep_of(turn_laser(config(), laser_deg, 3) if laser_deg else config(), 5, how)


@pytest.fixture(scope="module")
def poor():
    """From a poor calibration, with the calls of progress."""
    calls = []
    calibration = calibration_of(stored(truth_scanner(), np.random.default_rng(11)))
    result = recalibrate([sweep()], calibration, SETTINGS, progress=lambda done, total: calls.append((done, total)))
    return calibration, result, calls


@pytest.fixture(scope="module")
def drifted():
    """From a good calibration whose laser has turned by 0.05 degrees since."""
    return recalibrate([sweep(0.05)], calibration_of(with_covariance(truth_scanner(), np.diag(GOOD**2))), SETTINGS)


def test_a_poor_calibration_becomes_better(poor):
    calibration, result, _ = poor
    assert result.updated and not result.refused and result.hold_out is not None and result.hold_out.better
    assert not result.drift.drifted and result.drift.p > 1e-3
    error = departure(truth_scanner(), result.scanner)
    before = departure(truth_scanner(), calibration.scanner)
    sigma = np.sqrt(np.diag(np.asarray(result.scanner.covariance)))
    free = sigma > 0
    # 21 normal numbers, partly alike: none beyond 4 sigmas, which happens once in a thousand times.
    assert np.abs(error[free] / sigma[free]).max() < 4.0
    gain = result.scanner.parameter_names().index("gain")
    assert abs(error[gain]) < 0.2 * abs(before[gain]) and sigma[gain] < 0.2 * np.sqrt(
        calibration.covariance[gain, gain]
    )
    assert [each.name for each in result.gains[:2]] == ["radial scale", "height scale"]
    assert result.gains[-1].factor > 20.0
    assert any(line.startswith("height scale") for line in result.unobserved)


def test_the_stored_calibration_is_not_touched(poor):
    calibration, result, _ = poor
    assert result.adjusted.prior is calibration.scanner and result.scanner is not calibration.scanner
    again = stored(truth_scanner(), np.random.default_rng(11))
    np.testing.assert_array_equal(calibration.scanner.covariance, again.covariance)


def test_walls_become_flat_in_the_panorama(poor):
    _, result, _ = poor
    (panorama,) = result.panoramas
    assert panorama.seen.mean() > 0.02 and panorama.before.shape == panorama.after.shape
    before, after = (np.sqrt(np.mean(image[panorama.seen] ** 2)) for image in (panorama.before, panorama.after))
    assert after < 0.8 * before


def test_without_overlap_the_turn_is_known_better_but_no_gap_is_told(poor):
    calibration, result, _ = poor
    closure, names = result.closure, result.scanner.parameter_names()
    assert closure is not None and closure.source == "model" and closure.before_mm is closure.after_mm is None
    stored = np.sqrt(np.asarray(calibration.scanner.covariance)[names.index("gain"), names.index("gain")])
    assert closure.sigma_mm < 0.5 * 5e3 * np.pi * stored


def test_progress_ends_at_its_end(poor):
    calls = poor[2]
    assert calls == [(k, len(calls)) for k in range(1, len(calls) + 1)]


def test_a_laser_that_turned_is_found_and_put_right(drifted):
    assert drifted.updated and drifted.drift.drifted and drifted.drift.p < 1e-3
    assert "laser red" in drifted.drift.part and "degrees" in drifted.drift.size
    from jaxscan.simulation.truth import true_scanner

    truth = true_scanner(turn_laser(config(), 0.05, 3))
    error, names = departure(truth, drifted.scanner), truth.parameter_names()
    places = [names.index(f"laser.red.{name}") for name in ("n1", "n2", "d")]
    sigma = np.sqrt(np.diag(np.asarray(drifted.scanner.covariance)))[places]
    # Three numbers within 3.3 sigmas: 997 times in a thousand.
    assert np.abs(error[places] / sigma).max() < 3.3
    assert max(drifted.hold_out.after_mm) < 0.7 * max(drifted.hold_out.before_mm)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"centre": np.zeros((360, 700))}, "has stripes on 700 rows, the calibration is for images of 2048 x 1638 px"),
        ({"laser": np.ones(180, int)}, "has 2 lasers, the calibration 1"),
        ({"valid": np.zeros((180, 1638), bool)}, "found no plane|no plane"),
    ],
)
def test_sweeps_that_cannot_be_used_are_refused_in_one_line(change, said):
    calibration = calibration_of(with_covariance(truth_scanner(), np.diag(GOOD**2)))
    with pytest.raises(CalibrationError, match=said) as problem:
        recalibrate([sweep()._replace(**change)], calibration, SETTINGS)
    assert "\n" not in str(problem.value)


def test_no_sweep_is_told():
    with pytest.raises(CalibrationError, match="No sweep was given"):
        recalibrate([], calibration_of(with_covariance(truth_scanner(), np.diag(GOOD**2))))


def test_poses_of_too_few_stations_are_told():
    given = Given(stations=np.tile(np.eye(4), (3, 1, 1)))
    calibration = calibration_of(with_covariance(truth_scanner(), np.diag(GOOD**2)))
    with pytest.raises(CalibrationError, match="found 3 poses, expected one for each of 1"):
        recalibrate([sweep()], calibration, SETTINGS, given)


def test_known_lengths_find_their_walls():
    scanner = truth_scanner()
    observed = observe(scanner)
    start = Start(scanner, np.eye(4)[None])
    ends = [observed.surfaces.centre[k] for k in (0, 1)]
    near = MeasuredLength(3.82, 1e-3, ends[0] + 0.02, ends[1], "across")
    assert place_lengths([near], observed, start) == ((3.82, 1e-3, "surfaces", 0, 1),)
    with pytest.raises(CalibrationError, match="across: no surface within"):
        place_lengths([near._replace(first=np.array([0.0, 0.0, 9.0]))], observed, start)
    with pytest.raises(CalibrationError, match="both ends are on one"):
        place_lengths([near._replace(first=ends[1])], observed, start)
    with pytest.raises(CalibrationError, match="one end is a target"):
        place_lengths([near._replace(first="marker 7")], observed, start)
    with pytest.raises(CalibrationError, match="no target is called marker 7; found none"):
        place_lengths([near._replace(first="marker 7", second="marker 8")], observed, start)
