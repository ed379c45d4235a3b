"""The pixel-integrated Gaussian, its derivatives, and the solution of the normal equations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.stripes.fit import UNUSED, Start, Window, fit_stripe, integrated_gaussian


@pytest.mark.parametrize(("width", "tolerance"), [(2.0, 1e-6), (1.0, 5e-5), (0.7, 4e-4), (0.5, 3e-3)])
def test_series_against_the_integral(profile, width, tolerance):
    x = np.linspace(-6, 6, 25)
    exact = np.stack([profile(np.array([-shift]), width, 1.0, 1)[0] for shift in x])
    h, _, _ = integrated_gaussian(jnp.asarray(x)[:, None], jnp.array([width]), jnp.array([1.0]))
    # The midpoint rule with 32 parts is good to 1 / (24 * 32^2 w^2), below all tolerances but the first.
    assert np.max(np.abs(np.asarray(h) - exact)) < tolerance + 5e-5 / width**2


@pytest.mark.parametrize(("width", "aperture"), [(0.7, 1.0), (1.5, 1.0), (4.0, 2.0)])
def test_derivatives(width, aperture):
    def value(x, w):
        return integrated_gaussian(x[None, None], w[None], jnp.array([aperture]))[0][0, 0]

    for x in (-2.3, -0.4, 0.0, 0.9, 3.1):
        x, w = jnp.asarray(x), jnp.asarray(width)
        _, minus_slope, by_width = integrated_gaussian(x[None, None], w[None], jnp.array([aperture]))
        assert float(minus_slope[0, 0]) == pytest.approx(-float(jax.grad(value)(x, w)), abs=1e-10)
        # The width's derivative goes one term of the series further than the value does.
        left_out = 3e-4 * (aperture / width) ** 6 / width
        assert float(by_width[0, 0]) == pytest.approx(float(jax.grad(value, 1)(x, w)), abs=left_out + 1e-10)


def _window(x, level, **changes):
    ones = jnp.ones(level.shape[1])
    fields = {"x": x, "y": level, "variance": jnp.full(level.shape, 2.0), "aperture": ones, "shot": ones / 40}
    return Window(**(fields | changes))


def test_exact_samples_give_back_the_truth():
    truth = jnp.array([[0.37, 80.0, 1.3], [-1.2, 30.0, 2.5], [0.0, 150.0, 4.0]])
    x = jnp.arange(24.0)[:, None] - 11.5 + jnp.zeros((1, 3))
    h, _, _ = integrated_gaussian(x - truth[None, :, 0], truth[:, 2], jnp.ones(3))
    for background in (None, 7.0):
        level = truth[None, :, 1] * h + (0.0 if background is None else background)
        start = Start(
            truth[:, 0] + 0.4, 0.8 * truth[:, 1], 1.3 * truth[:, 2], None if background is None else jnp.zeros(3)
        )
        fit = fit_stripe(_window(x, level), start, iterations=12, max_width=10.0)
        np.testing.assert_allclose(np.asarray(jnp.stack([fit.u, fit.amplitude, fit.width], 1)), truth, atol=1e-6)
        np.testing.assert_allclose(np.asarray(fit.chi2), 0.0, atol=1e-6)


def test_variance_is_that_of_the_information_matrix():
    x = jnp.arange(24.0)[:, None] - 11.5
    u, amplitude, width = 0.3, 60.0, 1.7
    h, slope, by_width = integrated_gaussian(x - u, jnp.array([width]), jnp.ones(1))
    start = Start(jnp.array([u]), jnp.array([amplitude]), jnp.array([width]), None)
    fit = fit_stripe(_window(x, amplitude * h), start, iterations=2, max_width=10.0)
    jacobian = np.asarray(jnp.concatenate([amplitude * slope, h, amplitude * by_width], 1))
    variance = 2.0 + amplitude * np.asarray(h) / 40
    expected = np.linalg.inv(jacobian.T @ (jacobian / variance))[0, 0]
    assert float(fit.variance[0]) == pytest.approx(expected, rel=1e-9)


def test_samples_that_do_not_count():
    x = jnp.arange(24.0)[:, None] - 11.5
    h, _, _ = integrated_gaussian(x - 0.3, jnp.array([1.7]), jnp.ones(1))
    level = 60.0 * h
    variance = jnp.full(level.shape, 2.0).at[jnp.array([2, 11])].set(UNUSED)
    start = Start(jnp.zeros(1), jnp.array([50.0]), jnp.array([1.5]), None)
    fits = [
        fit_stripe(
            _window(x, level.at[jnp.array([2, 11])].set(poison), variance=variance), start, iterations=8, max_width=9.0
        )
        for poison in (0.0, 255.0)
    ]
    assert float(fits[0].samples[0]) == 22.0
    for fit in fits:
        assert float(fit.u[0]) == pytest.approx(0.3, abs=1e-6)
    none = fit_stripe(_window(x, level, variance=jnp.full(level.shape, UNUSED)), start, iterations=4, max_width=9.0)
    assert all(np.all(np.isfinite(np.asarray(field))) for field in none)
