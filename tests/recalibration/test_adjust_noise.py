"""Noise that neighbouring profiles share, on made-up grids with known correlations."""

import numpy as np
import pytest

from jaxscan.recalibration.adjust.errors import learn_stops, shared_by_profiles


def grid_of(profiles=200, lines=10, apart=9):
    record, line = np.meshgrid(np.arange(profiles), apart * np.arange(lines), indexing="ij")
    zero = np.zeros(record.size, int)
    return np.stack([zero, zero, record.ravel(), line.ravel()], 1)


def errors(random, share, profiles=200, lines=10):
    white = random.standard_normal((profiles + 1, lines))
    return (np.sqrt(1 - share**2) * white[1:] + share * white[:-1]).ravel()


def test_independent_errors_are_not_shared():
    found = [shared_by_profiles(errors(np.random.default_rng(k), 0.0), grid_of()) for k in range(20)]
    # Beyond 2.5 sigmas once in 160 times.
    assert np.median(found) == 1.0 and max(found) < 1.25


def test_the_factor_is_that_of_the_variance_of_their_sum():
    share = 0.4
    every = np.array([errors(np.random.default_rng(k), share) for k in range(200)])
    expected = 1.0 + 2.0 * share * np.sqrt(1 - share**2)
    found = [shared_by_profiles(error, grid_of()) for error in every[:20]]
    assert np.mean(found) == pytest.approx(expected, rel=0.05)
    # By 200 sums: their variance is known to 10 %.
    assert np.var(every.sum(1)) / every.shape[1] == pytest.approx(expected, rel=0.3)


def test_no_pair_reaches_over_two_walls_or_sweeps():
    error = errors(np.random.default_rng(1), 0.7)
    grid = grid_of()
    apart = grid.copy()
    apart[:, 1] = grid[:, 2] % 4
    # Neighbours of one wall are four profiles apart now, where nothing is shared.
    assert shared_by_profiles(error, grid) > 1.5 and shared_by_profiles(error, apart) == 1.0
    assert shared_by_profiles(np.zeros(0), np.zeros((0, 4), int)) == 1.0


@pytest.mark.parametrize("prior", [2e-5, 1e-4, 5e-4])
def test_stops_are_learned_whatever_they_were_taken_for(prior):
    random = np.random.default_rng(4)
    variance = np.linspace(1e-5, 6e-5, 2000) ** 2
    noise = np.sqrt(variance) * random.standard_normal(2000)
    # With a prior each is drawn towards 0, and known better than by itself.
    after = 1.0 / (1.0 / variance + prior**-2)
    for true in (6e-5, 3e-4):
        found = (true * random.standard_normal(2000) + noise) * after / variance
        # Of 2000 numbers the standard deviation is known to 1.6 %, and less well beside noise as large.
        assert learn_stops(found, after, prior) == pytest.approx(true, rel=0.06)
    assert learn_stops(noise * after / variance, after, prior) == 0.0
    assert learn_stops(found[:4], after[:4], prior) == 0.0
