"""The fit of a pixel-integrated Gaussian, against numerical quadrature and closed forms."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.stripes.fit import UNUSED_VARIANCE, FitRules, Start, Window, fit_stripe


X = np.arange(24.0) - 11.5


def _window(level, **changes):
    ones = jnp.ones(level.shape[1])
    level = jnp.asarray(level)
    fields = {"y": level, "variance": jnp.full(level.shape, 2.0), "step": ones, "aperture": ones, "shot": ones / 40}
    return Window(**(fields | changes))


def _levels(profile, u, width, amplitude):
    """Pixel-integrated Gaussians [samples, stripes], by numerical quadrature."""
    return np.stack(
        [profile(np.array([a + 11.5]), w, h, 24)[0] for a, w, h in zip(u, width, amplitude, strict=True)], 1
    )


# What the fourth cumulant leaves out of a pixel's integration is of sixth order in 1 / width; the
# midpoint rule of the renderer adds 1 / (24 * 32^2 w^2) to a squared width.
@pytest.mark.parametrize(("width", "tolerance"), [(4.0, 2e-5), (2.0, 5e-5), (1.0, 1e-4), (0.7, 1e-3), (0.5, 1e-2)])
@pytest.mark.parametrize("background", [None, 7.0])
def test_exact_samples_give_back_the_truth(profile, width, tolerance, background):
    u = np.array([0.37, -1.2, 0.0, 0.5])
    amplitude = np.array([80.0, 30.0, 150.0, 200.0])
    level = _levels(profile, u, np.full(4, width), amplitude) + (background or 0.0)
    start = Start(
        jnp.asarray(u + 0.2 * width),
        jnp.asarray(0.8 * amplitude),
        jnp.full(4, 1.2 * width),
        None if background is None else jnp.zeros(4),
    )
    fit = fit_stripe(_window(level), start, FitRules(10.0), iterations=20)
    np.testing.assert_allclose(np.asarray(fit.u), u, atol=tolerance)
    np.testing.assert_allclose(np.asarray(fit.width), width, rtol=tolerance)
    np.testing.assert_allclose(np.asarray(fit.amplitude), amplitude, rtol=tolerance)
    assert np.all(np.abs(np.asarray(fit.skew)) < 1e-2)


def test_variance_is_that_of_the_information_matrix(profile):
    truth = np.array([0.3, 60.0, 1.7])
    model = lambda p: _levels(profile, p[:1], p[2:], p[1:2])[:, 0]
    step = 1e-4 * np.eye(3)
    jacobian = np.stack([(model(truth + d) - model(truth - d)) / 2e-4 for d in step], 1)
    level = model(truth)
    expected = np.linalg.inv(jacobian.T @ (jacobian / (2.0 + level / 40)[:, None]))[0, 0]
    start = Start(*(jnp.asarray(truth[i : i + 1]) for i in range(3)), None)
    fit = fit_stripe(_window(level[:, None]), start, FitRules(10.0), iterations=3)
    # The derivatives leave out the pixel's fourth cumulant: 1 / (2880 w^4) of the model.
    assert float(fit.variance[0]) == pytest.approx(expected, rel=1e-3)


def test_skewness_of_a_skewed_profile(profile):
    level = _levels(profile, [0.1], [2.0], [100.0])
    z = (X[:, None] - 0.1) / np.sqrt(4.0 + 1 / 12)
    for skew in (-0.3, 0.15, 0.3):
        # The series of Gram and Charlier, to its first term beyond the Gaussian.
        start = Start(jnp.array([0.1]), jnp.array([90.0]), jnp.array([2.0]), None)
        fit = fit_stripe(_window(level * (1 + skew / 6 * (z**3 - 3 * z))), start, FitRules(10.0), iterations=8)
        # What a Gaussian can imitate by its centre and what the weights prefer changes it by a fifth.
        assert float(fit.skew[0]) == pytest.approx(skew, rel=0.2)


def test_speckle_widens_the_variance(profile):
    level = _levels(profile, [0.2], [2.0], [150.0])
    start = Start(jnp.array([0.2]), jnp.array([150.0]), jnp.array([2.0]), None)
    fits = [fit_stripe(_window(level), start, FitRules(10.0, speckle=c), iterations=3) for c in (0.0, 0.2, 0.4)]
    variances = [float(fit.variance[0]) for fit in fits]
    # With speckle alone the variance would go with the square of its contrast.
    assert variances[0] < variances[1] < variances[2]
    assert variances[2] - variances[1] > 1.5 * (variances[1] - variances[0])


def test_clipped_tops_come_to_rest(profile):
    rng = np.random.default_rng(0)
    u = rng.uniform(-1, 1, 200)
    level = _levels(profile, u, np.full(200, 2.0), np.full(200, 612.0))
    variance = np.where(level > 244.0, UNUSED_VARIANCE, 2.7)
    noisy = level + rng.normal(size=level.shape) * np.sqrt(2.7 + level / 40)
    start = Start(jnp.asarray(u + 0.05), jnp.full(200, 650.0), jnp.full(200, 1.6), None)
    fit = fit_stripe(_window(noisy, variance=jnp.asarray(variance)), start, FitRules(10.0), iterations=8)
    assert np.max(np.asarray(fit.last_step)) < 0.01
    assert np.max(np.abs(np.asarray(fit.u) - u)) < 0.08


def test_samples_that_do_not_count(profile):
    level = jnp.asarray(_levels(profile, [0.3], [1.7], [60.0]))
    variance = jnp.full(level.shape, 2.0).at[jnp.array([2, 11])].set(UNUSED_VARIANCE)
    start = Start(jnp.zeros(1), jnp.array([50.0]), jnp.array([1.5]), None)
    fits = [
        fit_stripe(
            _window(level.at[jnp.array([2, 11])].set(poison), variance=variance), start, FitRules(9.0), iterations=8
        )
        for poison in (0.0, 255.0)
    ]
    assert float(fits[0].samples[0]) == 22.0
    for fit in fits:
        assert float(fit.u[0]) == pytest.approx(0.3, abs=1e-5)
    none = fit_stripe(
        _window(level, variance=jnp.full(level.shape, UNUSED_VARIANCE)), start, FitRules(9.0), iterations=4
    )
    assert all(np.all(np.isfinite(np.asarray(field))) for field in none)
