"""Roots of covariances, whatever the sizes of their parameters."""

import numpy as np
import pytest

from jaxscan.geometry import root_of, square_root


@pytest.fixture
def covariance():
    """Of pixels and radians, with a held parameter and two that only their sum is known of."""
    random = np.random.default_rng(0)
    steps = random.normal(size=(3, 5)) * np.array([1.0, 1e-6, 0.0, 1e-3, 1e2])
    return steps.T @ steps


def test_the_steps_add_up_and_take_the_inverse(covariance):
    steps, inverse = square_root(covariance)
    size = np.sqrt(np.diag(covariance))
    unit = np.where(size > 0, size, 1.0)
    np.testing.assert_allclose(steps.T @ steps / np.outer(unit, unit), covariance / np.outer(unit, unit), atol=1e-12)
    assert steps.any(1).sum() == 3 and not steps[:, 2].any()
    np.testing.assert_allclose(inverse[2], 0.0, atol=1e-12)
    # Along the directions that there are one undoes the other.
    np.testing.assert_allclose(steps @ inverse, np.diag(steps.any(1).astype(float)), atol=1e-6)
    np.testing.assert_array_equal(root_of(covariance), steps)


def test_of_nothing_there_is_nothing():
    steps, inverse = square_root(np.zeros((2, 2)))
    assert not steps.any() and not inverse.any()
    assert root_of(np.zeros((0, 0))).shape == (0, 0)
