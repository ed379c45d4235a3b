"""Noise that neighbouring profiles share, on made-up grids with known correlations."""

import numpy as np
import pytest

from jaxscan.recalibration.adjust.noise import shared_by_profiles


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
    random = np.random.default_rng(1)
    error = errors(random, 0.7)
    grid = grid_of()
    apart = grid.copy()
    apart[:, 1] = grid[:, 2] % 4
    # Neighbours of one wall are four profiles apart now, where nothing is shared.
    assert shared_by_profiles(error, grid) > 1.8 and shared_by_profiles(error, apart) == 1.0
    assert shared_by_profiles(np.zeros(0), np.zeros((0, 4), int)) == 1.0
