"""The joint adjustment of a small known room: estimates and stated standard deviations against the truth."""

import numpy as np
import pytest

from experiments.recalibration.world import Noise, Sweeping, features_of, true_sweep
from jaxscan.calibration.propagate import length_sigma, measure_lengths, typical_lengths
from jaxscan.errors import CalibrationError
from jaxscan.recalibration import RecalibrationSettings, RoomObservations, Start
from jaxscan.recalibration.adjust import adjust, joint
from jaxscan.recalibration.adjust.prepare import prepare
from jaxscan.recalibration.segment import observe_surfaces
from jaxscan.recalibration.triangulate import triangulate_points
from tests.recalibration import faces
from tests.recalibration.faces import X, Y, pose
from tests.recalibration.linear_room import with_held
from tests.recalibration.small_room import SIGMA, config, exact_sweep, observe, stored, truth_scanner, with_covariance


SMALL = (60, 64)
ONE = np.eye(4)[None]


def trial(seed):
    """Departures of the stored and of the adjusted scanner from the truth, with the adjustment."""
    random = np.random.default_rng([seed, 7])
    truth, room = truth_scanner(), exact_sweep(*SMALL)
    prior = stored(truth, random)
    noise = 0.1 * random.standard_normal(int((room[1].surface >= 0).sum()))
    adjusted = adjust(prior, Start(prior, ONE), observe(prior, noise, sweep_truth=room))
    return truth.departure(prior), truth.departure(adjusted.scanner), adjusted


@pytest.mark.more
def test_a_poor_calibration_gets_better_by_as_much_as_it_says():
    before, after, adjusted = trial(0)
    sigma = np.sqrt(np.diag(adjusted.scanner.covariance))
    names = adjusted.scanner.parameter_names()
    assert adjusted.converged
    assert adjusted.point_kept.mean() > 0.99
    # Held by a variance of 0.
    assert after[names.index("laser.red.b2")] == 0
    gain = names.index("gain")
    assert sigma[gain] < 0.1 * SIGMA[gain]
    assert abs(after[gain]) < 4 * sigma[gain] < abs(before[gain])
    free = sigma > 0
    own = adjusted.scanner.covariance[np.ix_(free, free)]
    # 21 numbers: beyond 46.8 once in a thousand.
    assert after[free] @ np.linalg.solve(own, after[free]) < 46.8
    assert 0.8 < adjusted.cost / adjusted.freedom < 1.2


def test_outliers_do_not_pull():
    random = np.random.default_rng(3)
    truth, room = truth_scanner(), exact_sweep(*SMALL)
    prior = stored(truth, random)
    noise = 0.1 * random.standard_normal(int((room[1].surface >= 0).sum()))
    wrong = random.random(len(noise)) < 0.05
    noise[wrong] += random.uniform(3, 20, wrong.sum())
    adjusted = adjust(prior, Start(prior, ONE), observe(prior, noise, sweep_truth=room))
    assert not adjusted.point_kept[wrong].any()
    assert adjusted.point_kept[~wrong].mean() > 0.99
    free = np.diag(adjusted.scanner.covariance) > 0
    after, own = truth.departure(adjusted.scanner)[free], adjusted.scanner.covariance[np.ix_(free, free)]
    assert after @ np.linalg.solve(own, after) < 46.8


@pytest.mark.more
def test_a_closed_gear_is_closed():
    random = np.random.default_rng(4)
    prior = stored(truth_scanner(), random)
    noise = 0.1 * random.standard_normal(int((exact_sweep(*SMALL)[1].surface >= 0).sum()))
    observations = observe(prior, noise, sweep_truth=exact_sweep(*SMALL))
    adjusted = adjust(prior, Start(prior, ONE), observations, RecalibrationSettings(closed=True))
    gain = adjusted.scanner.parameter_names().index("gain")
    assert np.sqrt(adjusted.scanner.covariance[gain, gain]) < 5.1e-6
    assert abs(abs(float(adjusted.scanner.turntable.gain)) - 1) < 2.5e-5


def test_a_held_gain_contradicts_a_closed_gear():
    truth = truth_scanner()
    gain = truth.parameter_names().index("gain")
    sigma = np.where(np.arange(len(SIGMA)) == gain, 0.0, SIGMA)
    observations = observe(truth, sweep_truth=exact_sweep(*SMALL))
    closed = RecalibrationSettings(closed=True)
    held = with_covariance(truth, np.diag(sigma**2))
    one = with_held(held, (np.arange(len(sigma)) == gain) * (1.0 - float(truth.turntable.gain)))
    # Without a row for it the residuals are those of the prior alone.
    assert not prepare(one, Start(one, ONE), observations, closed).room.linear_rows.size
    off = with_held(one, (np.arange(len(sigma)) == gain) * 3e-4)
    with pytest.raises(CalibrationError, match=r"holds the table's gain at 1\.000300"):
        adjust(off, Start(off, ONE), observations, closed)


def test_a_ray_that_misses_the_sheet_is_no_observation():
    """It has neither an error nor a slope; counted, it would make the noise look smaller."""
    truth, room = truth_scanner(), exact_sweep(*SMALL)
    prior = with_covariance(truth, np.diag(SIGMA**2))
    observations = observe(truth, sweep_truth=room)
    missing = np.arange(len(observations.points.q)) % 7 == 0
    # Rays that are turned away from the sheet this far meet it behind the camera.
    q = np.where(missing[:, None], [6000.0, 800.0], observations.points.q)
    observations = observations._replace(points=observations.points._replace(q=q))
    assert not triangulate_points(truth, q, observations.points.laser, np.zeros(len(q)))[1][missing].any()
    adjusted = adjust(prior, Start(prior, ONE), observations)
    assert not adjusted.point_kept[missing].any() and adjusted.point_kept[~missing].mean() > 0.99
    assert adjusted.freedom < (~missing).sum()


@pytest.mark.parametrize("step", [np.nan, 1e3])
def test_a_last_step_that_does_not_help_is_not_taken(monkeypatch, step):
    truth, room = truth_scanner(), exact_sweep(*SMALL)
    prior = with_covariance(truth, np.diag(SIGMA**2))
    noise = 0.1 * np.random.default_rng(8).standard_normal(int((room[1].surface >= 0).sum()))
    take = joint.step_of
    spoiled = lambda *problem: take(*problem)._replace(scanner=np.full(len(SIGMA), step))
    monkeypatch.setattr(joint, "step_of", spoiled)
    adjusted = adjust(prior, Start(prior, ONE), observe(prior, noise, sweep_truth=room))
    assert not adjusted.converged
    assert np.isfinite(adjusted.departure).all() and np.abs(adjusted.departure[SIGMA > 0] / SIGMA[SIGMA > 0]).max() < 4


def test_a_calibration_without_covariance_is_refused():
    scanner = truth_scanner()
    with pytest.raises(CalibrationError, match="has no covariance"):
        adjust(scanner, Start(scanner, ONE), observe(scanner, 0.0, sweep_truth=exact_sweep(*SMALL)))


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_stops_beside_their_angles_are_learned():
    random, truth = np.random.default_rng(3), truth_scanner()
    prior = stored(truth, random)
    size = len(observe(prior).points.q)
    observed = observe(prior, 0.02 * random.standard_normal(size), sigma_px=0.02)
    beside = observed.angles[0] + 2e-4 * random.standard_normal(len(observed.angles[0]))
    start = Start(prior, ONE)
    exact, found = adjust(prior, start, observed), adjust(prior, start, observed._replace(angles=(beside,)))
    # By 90 records, of which some look at walls from the front: good to 15 %.
    assert exact.stop_sigma == 0.0 and found.stop_sigma == pytest.approx(2e-4, rel=0.4)
    # The walls keep their own noise, and the scanner is known less well.
    assert found.wall_m < exact.wall_m + 2e-4
    every = typical_lengths(truth, 0)
    error = measure_lengths(found.scanner, every) - measure_lengths(truth, every)
    sigma = length_sigma(found.scanner, every)
    assert np.abs(error / sigma).max() < 3.5 and (sigma > length_sigma(exact.scanner, every)).all()


# Of a table with 28,800 microsteps a turn, as a standard deviation.
WANDER_DEG = 360.0 / 28_800 / np.sqrt(12.0)


def seen_with_features(seed):
    """A sweep whose table stops anywhere within a microstep, points of its walls and features, and a calibration."""
    how = Sweeping(SMALL[0], line_stride=SMALL[1], furniture=False, noise=Noise(px=0.0), wander_deg=WANDER_DEG)
    room, random = true_sweep(config(), seed, how), np.random.default_rng([seed, 9])
    prior = stored(truth_scanner(), random)
    noise = 0.1 * random.standard_normal(int((room[1].surface >= 0).sum()))
    return prior, observe(prior, noise, sweep_truth=room), features_of(config(), room[1], seed)


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_features_know_that_the_table_stops_beside_its_angles():
    """Five trials, seeds 1 to 5. With angles that are exact, 60 images would hold the table's numbers too firmly."""
    chi2, stops = [], []
    for seed in range(1, 6):
        prior, observations, tracks = seen_with_features(seed)
        adjusted = adjust(prior, Start(prior, ONE), observations._replace(tracks=tracks))
        assert adjusted.converged and 0.95 < adjusted.cost / adjusted.freedom < 1.05
        after, free = truth_scanner().departure(adjusted.scanner), np.diag(adjusted.scanner.covariance) > 0
        chi2.append(after[free] @ np.linalg.solve(adjusted.scanner.covariance[np.ix_(free, free)], after[free]))
        stops.append(adjusted.stop_sigma)
    # By five times 60 images: to 5 %, and by what noise adds to that.
    assert np.mean(stops) == pytest.approx(np.deg2rad(WANDER_DEG), rel=0.2)
    # Observed over stated, of 21 numbers in five trials: 1 within 0.07.
    assert 0.75 < np.sqrt(np.mean(chi2) / 21) < 1.25


@pytest.mark.more
def test_stated_and_observed_errors_agree():
    """60 trials, seeds 0 to 59; each with a calibration and noise of its own."""
    sizes, chi2 = [], []
    for seed in range(60):
        _, after, adjusted = trial(seed)
        covariance = adjusted.scanner.covariance
        free = np.diag(covariance) > 0
        sizes.append(after[free] / np.sqrt(np.diag(covariance)[free]))
        chi2.append(after[free] @ np.linalg.solve(covariance[np.ix_(free, free)], after[free]))
    assert 0.85 < np.sqrt(np.mean(np.square(sizes))) < 1.15
    # The mean of 60 chi-squares of 21 has a standard deviation of 0.84.
    assert 21 - 3 * 0.84 < np.mean(chi2) < 21 + 3 * 0.84


@pytest.mark.more
@pytest.mark.parametrize("seed, lean", [(1, 0.006), (2, 0.003)])
def test_a_station_that_slides_along_its_walls_settles(seed, lean):
    """Two walls lean by a fraction of a degree, which is all that tells heights; patches of walls are off together."""
    walls = [faces.Face((1, 0, lean), -2.0), faces.Face(X, 2.2), faces.Face(Y, -2.1), faces.Face((0, 1, -lean), 2.4)]
    prior, truth = faces.poor(seed, better=20.0)
    second = pose((0.4, -0.3, 0.1), np.rad2deg(0.7))
    poses = np.stack([np.eye(4), second])
    sweeps = [
        faces.take(walls, truth, steps=90, seed=2 * seed + k, pose=place, station=k).sweep
        for k, place in enumerate(poses)
    ]
    points, surfaces = observe_surfaces(sweeps, truth, poses)
    patch = np.random.default_rng(seed).normal(scale=0.1, size=(2, 16, 9))
    q = points.q + np.outer(patch[points.sweep, points.record // 6, points.line // 64], [1.0, 0.0])
    observations = RoomObservations(
        points._replace(q=q), surfaces, tuple(sweep.angle for sweep in sweeps), np.arange(2), "rows"
    )
    adjusted = adjust(prior, Start(prior, poses), observations, RecalibrationSettings(stations=True))
    assert adjusted.converged
    away = (adjusted.stations[1] - second)[:3, 3]
    assert np.all(np.abs(away) < 4 * np.sqrt(np.diag(adjusted.station_covariance[1])[:3]))
