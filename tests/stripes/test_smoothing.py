"""Centres from their neighbours along the stripe: noise, edges, corners, curvature, strays, and stated sigmas."""

import numpy as np
import pytest

from jaxscan.stripes import ProfileRows, Sites, scatter_law, smooth_profiles


LINES, PROFILES = 240, 300
X = np.arange(LINES)
SLOPE = np.linspace(-0.6, 0.6, PROFILES)[:, None]


def scatter_of(rows):
    return scatter_law(rows).of(rows)


def noisy(truth, sigma, seed=1):
    return (truth + sigma * np.random.default_rng(seed).normal(size=truth.shape)).astype(np.float32)


EVERY_LINE, MOSAIC = Sites(), Sites(first_line=1, line_step=2)


def smooth(u, sigma, valid=None, sites=EVERY_LINE):
    sigma = np.broadcast_to(np.asarray(sigma, np.float32), u.shape)
    return smooth_profiles(u.astype(np.float32), sigma, np.ones(u.shape, bool) if valid is None else valid, sites)


def rms(error):
    return float(np.sqrt(np.mean(np.square(error))))


@pytest.mark.more
def test_a_parabola_by_least_squares():
    # Without noise nothing is an edge and everything fits: the window is that of 10 lines on either side.
    u = 100 + 0.3 * X + 1e-3 * (X - 120) ** 2 + 0.02 * np.sin(X / 4)
    sigma = 0.1 + 0.05 * np.sin(X / 9) ** 2
    found = smooth(u[None], sigma[None])
    for i in (0, 4, 50, 120, LINES - 1):
        # At the end one side makes up for the other.
        low, high = max(0, i - 10 - max(0, i + 10 - (LINES - 1))), min(LINES - 1, i + 10 + max(0, 10 - i))
        part = slice(low, high + 1)
        design = np.stack([np.ones(high - low + 1), X[part] - i, (X[part] - i) ** 2], 1) / sigma[part, None]
        covariance = np.linalg.inv(design.T @ design)
        value = (covariance @ design.T @ (u[part] / sigma[part]))[0]
        # Float32 at 200 px.
        assert found.u[0, i] == pytest.approx(value, abs=2e-5)
        assert found.sigma[0, i] == pytest.approx(np.sqrt(covariance[0, 0]), rel=1e-5)


@pytest.mark.more
@pytest.mark.parametrize("curvature", [0.0, 0.05, 0.2])
def test_noise_falls_and_is_stated_in_every_class(curvature):
    # Sigmas from 0.02 to 0.4 px; curved by so many of them per line squared.
    level = 0.02 * 20 ** np.linspace(0, 1, PROFILES)[:, None]
    sigma = level * np.exp(0.4 * np.sin(X / 15 + 40 * SLOPE))
    truth = 300 + SLOPE * X + curvature * level * 400 * np.sin(X / 20)
    found = smooth(noisy(truth, sigma), sigma)
    error = found.u - truth
    assert rms(error / sigma) < 0.6
    for part in np.array_split(np.arange(PROFILES), 5):
        # 14 000 rows of which nine are correlated: 2 %.
        assert 0.9 < rms(error[part] / found.sigma[part]) < 1.1


def width_of_step(u):
    """Rows from 10 to 90 % of the mean response to a step of 1."""
    response = np.maximum.accumulate(u.mean(0))
    return np.interp(0.9, response, X) - np.interp(0.1, response, X)


@pytest.mark.parametrize("height", [8.0, 25.0, 100.0])
def test_a_step_stays_a_step(height):
    # 50 mm at 2 m are 25 or more standard deviations of a row in speckle, 15 mm are about 8.
    truth = np.broadcast_to(np.where(X >= 120, 1.0, 0.0), (PROFILES, LINES))
    found = smooth(noisy(truth, 1 / height), 1 / height)
    assert width_of_step(found.u) <= 1.2 * width_of_step(truth)
    # Beside the step noise falls too.
    beside = (np.abs(X - 119.5) < 8) & (np.abs(X - 119.5) > 2)
    assert rms((found.u - truth)[:, beside]) < 0.8 / height


@pytest.mark.parametrize("bend", [0.3, 1.0, 5.0])
def test_a_corner_stays_a_corner(bend):
    truth = 300 + SLOPE * X + bend * 0.1 * np.abs(X - 120)
    found = smooth(noisy(truth, 0.1), 0.1)
    near = np.abs(X - 120) <= 10
    # No row is off by more than a part of the sigma of its own fit.
    assert np.abs((found.u - truth).mean(0)[near]).max() < 0.3 * 0.1
    assert rms((found.u - truth)[:, near]) < 0.06


def test_a_stray_centre_stays_alone():
    truth = 300 + SLOPE * X
    u = noisy(truth, 0.1)
    stray = np.zeros(u.shape, bool)
    stray[:, 20:-20:25] = True
    plain, far, farther = (smooth(u + shift * stray, 0.1) for shift in (0.0, 4.0, -30.0))
    # Its neighbours do not know where it is, and it stays where its row had it. Of four neighbours one group in three
    # thousand is off a line by chance, and then the window ends at the stray one.
    assert np.mean(far.u[~stray] != farther.u[~stray]) < 3e-3
    assert np.abs(far.u - farther.u)[~stray].max() < 0.3
    np.testing.assert_array_equal(far.u[stray], (u + np.float32(4.0))[stray])
    np.testing.assert_allclose(far.sigma[stray], 0.1, rtol=1e-5)
    assert rms((far.u - truth)[~stray]) < 1.1 * rms((plain.u - truth)[~stray])


def test_the_mask_is_obeyed():
    truth = 300 + SLOPE * X
    u, rng = noisy(truth, 0.1), np.random.default_rng(5)
    valid = rng.random(u.shape) < 0.7
    valid[0], valid[1, 5:] = False, False
    clean, poisoned = (smooth(np.where(valid, u, poison), np.where(valid, 0.1, poison), valid) for poison in (0, 1e6))
    for one, other in zip(clean, poisoned, strict=True):
        np.testing.assert_array_equal(one, other)
        assert not one[~valid].any() and np.isfinite(one).all()
    error = (clean.u - truth)[valid]
    assert rms(error) < 0.06 and 0.9 < rms(error / clean.sigma[valid]) < 1.1


def test_nothing_is_carried_over_a_gap_of_more_than_three_lines():
    u, valid = noisy(300 + SLOPE * X, 0.1), np.ones((PROFILES, LINES), bool)
    valid[:, 100:104] = False
    moved = u + np.where(X >= 104, 7.0, 0.0).astype(np.float32)
    one, other = smooth(u, 0.1, valid), smooth(moved, 0.1, valid)
    np.testing.assert_array_equal(one.u[:, :100], other.u[:, :100])


@pytest.mark.more
def test_every_second_line_of_a_mosaic():
    u = noisy(300 + SLOPE * X[:120], 0.1)
    wide, valid = np.zeros((PROFILES, LINES), np.float32), np.zeros((PROFILES, LINES), bool)
    wide[:, 1::2], valid[:, 1::2] = u, True
    dense, sparse = smooth(u, 0.1), smooth(wide, 0.1, valid, MOSAIC)
    np.testing.assert_array_equal(sparse.u[:, 1::2], dense.u)
    shared = np.where(dense.shared_lines > 1, 2 * dense.shared_lines, 1)
    np.testing.assert_array_equal(sparse.shared_lines[:, 1::2], shared)


@pytest.mark.more
def test_a_few_centres_far_apart_are_no_mosaic():
    u, valid = np.full((1, LINES), 5.0), np.zeros((1, LINES), bool)
    valid[:, ::40] = True
    np.testing.assert_array_equal(smooth(u, 0.1, valid).shared_lines, valid)


@pytest.mark.more
def test_profiles_and_directions_and_units_do_not_matter():
    sigma = 0.05 + 0.05 * np.random.default_rng(3).random((PROFILES, LINES))
    u = noisy(300 + SLOPE * X + 2.0 * (X > 77), sigma)
    found = smooth(u, sigma)
    np.testing.assert_array_equal(smooth(u[7:8], sigma[7:8]).u, found.u[7:8])
    np.testing.assert_allclose(smooth(u[:, ::-1], sigma[:, ::-1]).u[:, ::-1], found.u, atol=2e-4)
    np.testing.assert_allclose(smooth(4 * u, 4 * sigma).u, 4 * found.u, rtol=1e-6)


def test_shared_lines_are_the_sum_of_the_correlations():
    u = noisy(np.zeros((PROFILES, LINES)), 0.1)
    found = smooth(u, 0.1)
    inside = slice(40, 200)
    # The mean of 160 smoothed rows is as good as that of the rows, and says so.
    stated = np.sqrt((found.sigma[:, inside] ** 2 * found.shared_lines[:, inside]).mean() / 160)
    assert 0.9 < rms(found.u[:, inside].mean(1)) / stated < 1.1
    assert np.median(found.shared_lines[:, inside]) == pytest.approx(21 / 2.25, rel=0.02)


def test_the_scatter_of_rows_corrects_their_sigmas():
    amplitude = np.broadcast_to(10 * 20 ** np.linspace(0, 1, PROFILES)[:, None], (PROFILES, LINES)).astype(np.float32)
    valid = np.random.default_rng(2).random(amplitude.shape) < 0.9
    truth = 300 + SLOPE * X + 3.0 * ((X // 24) % 2) + 20 * np.sin(X / 30)
    # Bright rows scatter 1.6 times as much as they say.
    true = np.where(amplitude > 60, 1.6, 1.0)
    promised = np.full(truth.shape, 0.1, np.float32)
    scale = scatter_of(ProfileRows(noisy(truth, 0.1 * true), promised, valid, amplitude)).scale
    dark, bright = scale[amplitude < 30], scale[amplitude > 120]
    # One of six triples lies on a step of 30 standard deviations.
    assert 1.0 <= dark.min() and dark.max() < 1.06
    assert np.median(bright) == pytest.approx(1.6, rel=0.05) and bright.min() > 1.4
    smooth_surface = scatter_of(ProfileRows(noisy(300 + SLOPE * X, 0.1 * true), promised, valid, amplitude)).scale
    assert np.median(smooth_surface[amplitude > 120]) == pytest.approx(1.6, rel=0.05)
    assert smooth_surface[amplitude < 30].max() < 1.06


def test_sigmas_are_never_made_smaller():
    u, valid = noisy(300 + SLOPE * X, 0.02), np.ones((PROFILES, LINES), bool)
    scatter = scatter_of(ProfileRows(u, np.full(u.shape, 0.1, np.float32), valid, np.full(u.shape, 50, np.float32)))
    np.testing.assert_array_equal(scatter.scale, 1.0)


@pytest.mark.parametrize("weight", [0.0, 0.05, 0.15])
def test_rows_that_are_alike_are_noticed(weight):
    """Noise that blur has spread over neighbouring rows, of which each keeps its promised variance."""
    drawn = np.random.default_rng(4).normal(size=(PROFILES, LINES + 2))
    kernel = np.array([weight, 1.0, weight])
    noise = sum(k * drawn[:, i : i + LINES] for i, k in enumerate(kernel)) / np.linalg.norm(kernel)
    u, all_there = (300 + SLOPE * X + 0.1 * noise).astype(np.float32), np.ones((PROFILES, LINES), bool)
    scatter = scatter_of(ProfileRows(u, np.full(u.shape, 0.1, np.float32), all_there, np.full(u.shape, 50, np.float32)))
    correlation = 2 * weight / (1 + 2 * weight**2)
    # The second neighbours are alike too, by the square of the weight.
    assert sum(scatter.correlation.near[:1]) == pytest.approx(correlation, abs=0.02 + weight**2)
    assert scatter.scale.max() < 1.05


@pytest.mark.more
@pytest.mark.parametrize("shape", [(0, 0), (1, 1), (2, 7)])
def test_hardly_any_rows(shape):
    u, valid = np.full(shape, 5, np.float32), np.ones(shape, bool)
    for some in (valid, ~valid):
        found = smooth(u, 0.1, some)
        np.testing.assert_allclose(found.u, np.where(some, 5, 0))
        assert (scatter_of(ProfileRows(u, 0.1 * u, some, u)).scale == 1).all()
