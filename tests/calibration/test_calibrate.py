"""The joint calibration against a known world."""

from dataclasses import replace

import numpy as np
import pytest

from jaxscan.calibration import CalibrationSettings
from jaxscan.calibration import calibrate_observations as judged_calibration
from jaxscan.geometry import Chessboard


def calibrate_observations(observed, *, settings=None):
    """Without tests of the models, which have tests of their own."""
    return judged_calibration(observed, settings=settings or CalibrationSettings(judge=False))


@pytest.fixture(scope="module")
def perfect(world):
    return world.observe(world.Rig())


@pytest.fixture(scope="module")
def noisy(world, perfect):
    """Eight calibrations of the same captures with fresh noise."""
    return [calibrate_observations(world.with_noise(perfect, seed)) for seed in range(8)]


def normalised_error(calibration, error):
    free = np.diag(calibration.covariance) > 0
    return error[free] @ np.linalg.solve(calibration.covariance[np.ix_(free, free)], error[free]), free.sum()


def test_perfect_data_recover_the_truth(world, perfect):
    calibration = calibrate_observations(perfect)
    error = world.errors(calibration.scanner, world.Rig())
    # Rounding of float64 pixels only; what the priors pull is scaled down with the noise.
    assert np.abs(error).max() < 1e-6
    assert calibration.order == calibration.scanner.parameter_names()
    assert calibration.quality.converged and calibration.quality.corner_rms_px < 1e-7
    assert calibration.quality.corners_rejected == 0


def test_residuals_are_one_standard_deviation(noisy):
    assert all(c.quality.converged for c in noisy)
    for group in ("corner", "stripe"):
        rms = np.array([getattr(c.quality, f"{group}_rms_whitened") for c in noisy])
        # Eight times about 2500 corner coordinates, or 1000 stripe points: 1 / sqrt(2 n) = 0.8 %
        # at most; 3 standard deviations of the mean and 4 of one.
        assert abs(rms.mean() - 1.0) < 0.01
        assert np.abs(rms - 1.0).max() < 0.09


def test_errors_are_as_the_covariance_says(world, noisy):
    values = [normalised_error(c, world.errors(c.scanner, world.Rig())) for c in noisy]
    count = sum(size for _, size in values)
    total = sum(value for value, _ in values)
    # Chi-squared with 8 x 21 degrees of freedom: 4 standard deviations either way. Four to five of
    # the 21 are known from priors that are the truth here, so the lower bound is without those.
    assert count - 5 * 8 - 4 * np.sqrt(2 * count) < total < count + 4 * np.sqrt(2 * count)


def test_held_parameters_stay_and_have_no_variance(world, perfect):
    held = tuple(block for block in CalibrationSettings().free if block != "bow")
    settings = CalibrationSettings(free=held, judge=False)
    calibration = calibrate_observations(world.with_noise(perfect, 0), settings=settings)
    names = list(calibration.order)
    for name in ("laser.laser.b2", "laser.laser.b3"):
        assert not calibration.covariance[names.index(name)].any()
    assert not calibration.scanner.lasers.bow.any()
    np.testing.assert_array_equal(calibration.scanner.covariance, calibration.covariance)


def test_poison_in_entries_that_are_not_valid_changes_nothing(world, perfect):
    hidden = world.with_noise(perfect, 0)
    corner_valid, stripe_valid = hidden.corners.valid.copy(), hidden.stripes.valid.copy()
    corner_valid[::3, ::5] = False
    corner_valid[1] = False
    stripe_valid[:, ::4] = False
    clean = replace(
        hidden,
        corners=replace(hidden.corners, valid=corner_valid),
        stripes=replace(hidden.stripes, valid=stripe_valid),
    )
    corner_q, stripe_q = hidden.corners.q.copy(), hidden.stripes.q.copy()
    corner_sigma, stripe_sigma = hidden.corners.sigma.copy(), hidden.stripes.sigma.copy()
    corner_q[~corner_valid], stripe_q[~stripe_valid] = np.nan, np.inf
    corner_sigma[~corner_valid], stripe_sigma[~stripe_valid] = -1.0, np.nan
    poisoned = replace(
        clean,
        corners=replace(clean.corners, q=corner_q, sigma=corner_sigma),
        stripes=replace(clean.stripes, q=stripe_q, sigma=stripe_sigma),
    )
    a, b = calibrate_observations(clean), calibrate_observations(poisoned)
    np.testing.assert_array_equal(a.covariance, b.covariance)
    np.testing.assert_array_equal(a.camera.distortion, b.camera.distortion)
    assert a.quality.views == 19


def test_gross_errors_are_rejected(world, perfect, noisy):
    observed = world.with_noise(perfect, 0)
    random = np.random.default_rng(7)
    corner_q, stripe_q = observed.corners.q.copy(), observed.stripes.q.copy()
    wrong_corners = random.random(corner_q.shape[:2]) < 0.03
    wrong_stripes = (random.random(stripe_q.shape[:2]) < 0.10) & observed.stripes.valid
    corner_q[wrong_corners] += random.normal(size=(wrong_corners.sum(), 2)) * 8.0
    stripe_q[wrong_stripes, 0] += random.normal(size=wrong_stripes.sum()) * 8.0
    calibration = calibrate_observations(
        replace(
            observed,
            corners=replace(observed.corners, q=corner_q),
            stripes=replace(observed.stripes, q=stripe_q),
        )
    )
    error = world.errors(calibration.scanner, world.Rig())
    value, size = normalised_error(calibration, error)
    # As good as without: chi-squared within 4 standard deviations, and hardly less certain.
    assert value < size + 4 * np.sqrt(2 * size)
    free = np.diag(calibration.covariance) > 0
    ratio = np.sqrt(np.diag(calibration.covariance)[free] / np.diag(noisy[0].covariance)[free])
    assert ratio.max() < 1.3
    # A tenth of the 8 px errors lies within one px in both coordinates and may stay.
    assert calibration.quality.converged
    assert calibration.quality.corners_rejected > 0.8 * wrong_corners.sum()


def test_the_noise_is_estimated(world, perfect):
    calibration = calibrate_observations(world.with_noise(perfect, 3, corner=2.0, stripe=0.5))
    quality = calibration.quality
    assert quality.corner_noise_over_sigma == pytest.approx(2.0, rel=0.08)
    assert quality.stripe_noise_over_sigma == pytest.approx(0.5, rel=0.10)
    value, size = normalised_error(calibration, world.errors(calibration.scanner, world.Rig()))
    assert value < size + 4 * np.sqrt(2 * size)


@pytest.mark.more
def test_every_contrast_class_has_a_noise_of_its_own(world, perfect):
    stripes = perfect.stripes
    contrast = np.random.default_rng(0).integers(0, 3, stripes.valid.shape).astype(np.int8)
    size = np.array([1.0, 0.5, 2.5])[contrast]
    uneven = replace(perfect, stripes=replace(stripes, sigma=stripes.sigma * size))
    noisy = world.with_noise(uneven, 5)
    stated = replace(noisy, stripes=replace(noisy.stripes, sigma=stripes.sigma, contrast=contrast))
    # The plane by stripes alone: few boards leave its bow to the prior, which knows no classes.
    held = CalibrationSettings(free=tuple(block for block in CalibrationSettings().free if block != "bow"))
    calibration = calibrate_observations(stated, settings=held)
    ratio = calibration.fit.stripe_sigma / stripes.sigma
    named = calibration.quality.stripe_noise_by_contrast
    assert list(named) == ["even print", "weak edge", "strong edge"]
    assert list(named.values()) == pytest.approx([1.0, 0.5, 2.5], rel=0.15)
    for number, true in enumerate((1.0, 0.5, 2.5)):
        some = stripes.valid & (contrast == number)
        # The size is known to 1 / sqrt(2 n); three times that.
        assert ratio[some] == pytest.approx(true, rel=3.0 / np.sqrt(2 * np.count_nonzero(some)))
        assert np.count_nonzero(some) > 150
    value, count = normalised_error(calibration, world.errors(calibration.scanner, world.Rig()))
    assert value < count + 4 * np.sqrt(2 * count)
    # Without the classes all points count alike, and the sheet is known worse.
    alike = calibrate_observations(replace(stated, stripes=replace(stated.stripes, contrast=None)), settings=held)
    place = calibration.order.index("laser.laser.n1" if "laser.laser.n1" in calibration.order else "laser.n1")
    assert calibration.covariance[place, place] < 0.7 * alike.covariance[place, place]


def test_a_bowed_board_is_found_out(world):
    rig = world.Rig(warp=(5e-4, -3e-4))
    calibration = calibrate_observations(world.observe(rig))
    np.testing.assert_allclose(calibration.quality.board_warp_m, rig.warp, atol=1e-9)
    assert np.abs(world.errors(calibration.scanner, rig)).max() < 1e-6
    free = tuple(block for block in CalibrationSettings().free if block != "warp")
    flat = calibrate_observations(world.observe(rig), settings=CalibrationSettings(free=free, judge=False))
    assert flat.quality.board_warp_m == (0.0, 0.0)
    assert flat.quality.corner_rms_px > 0.02


def test_a_table_with_angle_errors_does_not_make_the_covariance_lie(world):
    rig = world.Rig(harmonics=(3e-4, -2e-4, 1e-4, 1e-4), gain=1.0004)
    observed = world.observe(rig)
    values = []
    for seed in range(4):
        calibration = calibrate_observations(world.with_noise(observed, seed))
        error = world.errors(calibration.scanner, rig)
        values.append(normalised_error(calibration, error))
    total, count = sum(v for v, _ in values), sum(n for _, n in values)
    # The prior's part of the error is the same in all four runs, hence the wider band.
    assert total < count + 8 * np.sqrt(2 * count)


def test_strong_distortion_is_no_trouble_for_the_seed(world):
    rig = world.Rig(lens=(-0.30, 0.10, 0.0, 0.0, 0.0))
    calibration = calibrate_observations(world.observe(rig))
    assert np.abs(world.errors(calibration.scanner, rig)).max() < 1e-6


def check_object_on_a_table(world, **rig):
    rig = world.Rig(gain=-1.0005, carries="object", up="+v", **rig)
    calibration = calibrate_observations(world.with_noise(world.observe(rig), 0))
    scanner = calibration.scanner
    assert scanner.turntable.direction[1] > 0
    assert scanner.turntable.carries == "object" and scanner.up == "+v"
    # Seen from the other side the table turns the other way.
    assert scanner.turntable.gain == pytest.approx(1.0005, abs=4e-3)
    value, size = normalised_error(calibration, world.errors(scanner, rig))
    assert value < size + 4 * np.sqrt(2 * size)
    # Gain and harmonics share what boards over 20 degrees show of them by their priors, so only a
    # table without errors is recovered to the last digit.
    exact = replace(rig, gain=-1.0)
    assert np.abs(world.errors(calibrate_observations(world.observe(exact)).scanner, exact)).max() < 1e-6
    return scanner


def test_an_object_on_a_table_that_counts_backwards(world):
    check_object_on_a_table(world)


@pytest.mark.slow
def test_two_lasers(world):
    scanner = check_object_on_a_table(
        world, normals=((0.990, -0.010, 0.140), (0.985, 0.02, 0.15)), distances=(0.200, 0.205)
    )
    assert scanner.laser_names == ("laser", "laser1")


def test_default_precision_of_the_caller_does_not_matter(world, perfect, noisy):
    import jax

    with jax.enable_x64(False):
        calibration = calibrate_observations(world.with_noise(perfect, 0))
    np.testing.assert_array_equal(calibration.covariance, noisy[0].covariance)
    assert calibration.scanner.turntable.direction.dtype == np.float64


@pytest.mark.slow
def test_monte_carlo(world, perfect):
    runs = [calibrate_observations(world.with_noise(perfect, seed)) for seed in range(200)]
    error = np.array([world.errors(c.scanner, world.Rig()) for c in runs])
    free = np.diag(runs[0].covariance) > 0
    ratio = error.std(0)[free] / np.sqrt(np.mean([np.diag(c.covariance)[free] for c in runs], axis=0))
    names = np.array(runs[0].order)[free]
    # 200 runs give a standard deviation to 5 %: three of these either way.
    assert ratio.max() < 1.15
    # Gain and harmonics have priors that are the truth itself, so their errors are smaller than said.
    seen = [name.startswith(("f", "c", "k", "laser")) and name not in ("c1", "c2") for name in names]
    assert ratio[seen].min() > 0.85
    values = np.array([normalised_error(c, e)[0] for c, e in zip(runs, error, strict=True)])
    assert values.mean() < free.sum() + 3 * np.sqrt(2 * free.sum() / len(runs))
    for group in ("corner", "stripe"):
        rms = np.array([getattr(c.quality, f"{group}_rms_whitened") for c in runs])
        assert np.mean(rms**2) == pytest.approx(1.0, abs=0.01)


def test_board_larger_than_a_bucket_of_corners_is_padded(world):
    from jaxscan.calibration.problem import prepare

    data = prepare(world.observe(world.Rig(board=Chessboard(9, 7, 0.035)), free=4, placements=1, angles=2))
    assert data.board.shape == (96, 3) and data.corner_q.shape == (24, 96, 2)
    assert not data.corner_valid[:, 63:].any() and not data.fixes_pose[6:].any()
