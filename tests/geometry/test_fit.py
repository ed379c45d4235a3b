"""Closed-form plane and axis."""

import numpy as np
import pytest

from jaxscan.geometry import Turntable, fit_axis, fit_plane


def test_plane_of_exact_points():
    rng = np.random.default_rng(0)
    n = np.array([0.3, -0.2, 0.93]) / np.linalg.norm([0.3, -0.2, 0.93])
    points = rng.normal(size=(500, 3)) * [2.0, 1.0, 3.0] + 4.0
    points += np.outer(1.7 - points @ n, n)
    plane = fit_plane(points)
    np.testing.assert_allclose(plane.normal, n, atol=1e-12)
    np.testing.assert_allclose(plane.distance, 1.7, atol=1e-12)
    assert plane.rms < 1e-7  # the square root of the rounding error of a variance


def test_plane_noise_is_its_rms():
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-1, 1, (20000, 2)), 3 + 0.01 * rng.normal(size=20000)])
    # Sampling error of a standard deviation: 1 / sqrt(2 n) = 0.5 %; five of them.
    np.testing.assert_allclose(fit_plane(points).rms, 0.01, rtol=0.025)


def test_points_on_a_line_show_in_the_spread():
    plane = fit_plane(np.outer(np.linspace(0, 1, 50), [1.0, 2.0, 3.0]))
    assert plane.spread[1] < 1e-6


def test_two_points_are_no_plane():
    with pytest.raises(ValueError, match="3 points"):
        fit_plane(np.zeros((2, 3)))


TABLE = Turntable.from_axis([0.05, -0.99, 0.1], [0.1, 0.3, -0.2])


def test_axis_of_motions():
    motions = np.stack([np.asarray(TABLE.tr(angle)) for angle in (0.1, -0.3, 0.7)])
    axis = fit_axis(motions)
    np.testing.assert_allclose(np.abs(axis.direction @ TABLE.direction), 1, atol=1e-13)
    np.testing.assert_allclose(axis.point, TABLE.point, atol=1e-12)
    assert axis.rms < 1e-12


def test_axis_of_an_arc():
    start = np.array([0.3, 0.1, 0.5, 1.0])
    arc = np.stack([(np.asarray(TABLE.tr(angle)) @ start)[:3] for angle in np.linspace(0, 1.5, 20)])
    axis = fit_axis(arc)
    np.testing.assert_allclose(np.abs(axis.direction @ TABLE.direction), 1, atol=1e-12)
    np.testing.assert_allclose(axis.point, TABLE.point, atol=1e-10)


@pytest.mark.parametrize("motion", [np.eye(4)[None], np.outer(np.arange(5.0), [1.0, 0, 0])])
def test_what_does_not_turn_is_refused(motion):
    with pytest.raises(ValueError, match="turn"):
        fit_axis(motion)
