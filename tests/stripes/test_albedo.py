"""Stripes across printed edges: how far the centre moves, and a standard deviation that knows it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.stripes.fit import albedo_shift


pytestmark = pytest.mark.more


SAMPLES, SUBSAMPLES = 24, 16
READ, GAIN = 1.0, 40.0


def blur(level, psf):
    if psf == 0:
        return level
    x = np.arange(-4 * SUBSAMPLES, 4 * SUBSAMPLES + 1) / SUBSAMPLES
    kernel = np.exp(-0.5 * (x / psf) ** 2)
    padded = np.pad(level, ((0, 0), (len(x) // 2, len(x) // 2)), mode="edge")
    return np.apply_along_axis(np.convolve, 1, padded, kernel / kernel.sum(), "valid")


def printed_edges(sensor, contrast, *, n=3000, width=2.0, amplitude=100.0, ambient=30.0, psf=0.8, seed=0):
    """Pairs [n, samples] of a stripe over an edge anywhere within two widths, and the true centres."""
    sensor = sensor(read_dn=READ, electrons_per_dn=GAIN, seed=seed)
    rng = sensor.rng
    x = (np.arange(SAMPLES * SUBSAMPLES) + 0.5) / SUBSAMPLES - SAMPLES / 2
    u = rng.uniform(-0.5, 0.5, n)
    edge = u + rng.uniform(-2 * width, 2 * width, n)
    side = rng.choice([-1.0, 1.0], n)
    albedo = np.where(side[:, None] * (x - edge[:, None]) > 0, 1.0, 1.0 / contrast)
    # The width that the camera sees is that of the light and of the lens.
    lit = np.sqrt(width**2 - psf**2)
    laser = amplitude * width / lit * np.exp(-0.5 * ((x - u[:, None]) / lit) ** 2)
    pixels = lambda level: level.reshape(n, SAMPLES, SUBSAMPLES).mean(2)
    on, off = pixels(blur(albedo * (ambient + laser), psf)), pixels(blur(albedo * ambient, psf))
    return u, sensor.expose(on).astype(float), sensor.expose(off).astype(float)


def fit(on, off, width):
    """Weighted least squares of centre, amplitude and width; sigma grows by a misfit beyond noise."""
    x = np.arange(SAMPLES) - SAMPLES / 2 + 0.5
    y, variance = on - off, 2 * READ**2 + 1 / 6 + 2 * off / GAIN
    used = np.broadcast_to(np.abs(x) <= 2.5 + 1.8 * width, y.shape)
    p = np.stack([y.max(1), np.zeros(len(y)), np.full(len(y), width)], 1)
    for _ in range(25):
        amplitude, u, spread = p.T
        seen = np.sqrt(spread**2 + 1 / 12)[:, None]
        z = (x - u[:, None]) / seen
        h = np.exp(-0.5 * z * z)
        model = amplitude[:, None] * h
        weight = np.where(used, 1 / (variance + np.maximum(model, 0) / GAIN), 0)
        jacobian = np.stack([h, model * z / seen, model * z * z / seen], 2)
        normal = np.einsum("ni,nij,nik->njk", weight, jacobian, jacobian)
        gradient = np.einsum("ni,nij,ni->nj", weight, jacobian, y - model)
        step = np.linalg.solve(normal + 1e-9 * np.eye(3), gradient[..., None])[..., 0]
        p = p + np.clip(step, [-0.5, -1.0, -0.4] * p[:, :1] ** [1, 0, 0], [1.0, 1.0, 0.6] * p[:, :1] ** [1, 0, 0])
        p[:, 2] = np.clip(p[:, 2], 0.4, 13.0)
    freedom = used.sum(1) - 3
    chi2 = np.sum(weight * (y - model) ** 2, 1) / freedom
    grown = np.maximum(chi2 / (1 + 3 * np.sqrt(2 / freedom)), 1.0)
    sigma = np.sqrt(np.linalg.inv(normal + 1e-9 * np.eye(3))[:, 1, 1] * grown)
    return x, p[:, 1], p[:, 2], sigma, used


def guarded(on, off, width, dtype=np.float64, offset=0.0):
    x, u, spread, sigma, used = fit(on, off, width)
    cast = lambda a: jnp.asarray(np.ascontiguousarray(a), dtype)
    columns = np.broadcast_to(x[:, None], used.T.shape)
    variance = READ**2 + 1 / 12 + off.T / GAIN
    dark = cast(off.T), cast(columns), jnp.asarray(used.T), cast(variance)
    return u, sigma, *albedo_shift(*dark, cast(u), cast(spread), offset=offset)


# A sharp lens and a common one. Without any blur a stripe at 5 : 1 comes to 1.21.
@pytest.mark.parametrize("psf", [0.5, 0.8])
@pytest.mark.parametrize("contrast", [2.0, 5.0])
@pytest.mark.parametrize("width, amplitude, ambient", [(2.0, 100.0, 30.0), (2.0, 40.0, 60.0), (3.0, 100.0, 60.0)])
def test_sigma_is_true_at_printed_edges(sensor, psf, contrast, width, amplitude, ambient):
    truth, on, off = printed_edges(sensor, contrast, width=width, amplitude=amplitude, ambient=ambient, psf=psf)
    u, sigma, shift, _ = guarded(on, off, width)
    error, shift = u - truth, np.asarray(shift)
    rms = lambda a: np.sqrt(np.mean(a**2))
    assert rms(error / sigma) > 3.0
    honest = rms(error / np.sqrt(sigma**2 + shift**2))
    assert 0.7 < honest < 1.2
    # And the shift is not only as large as the error, it is the error.
    assert rms(error - shift) < 0.65 * rms(error)


def test_a_slope_of_reflectance_moves_the_stripe_as_the_theory_says():
    width, slope = 2.0, 0.02
    x = np.arange(SAMPLES) - SAMPLES / 2 + 0.5
    column = jnp.asarray(x[:, None])
    dark = 60.0 * jnp.exp(slope * column)
    window = dark, column, jnp.ones((SAMPLES, 1), bool), 1e-6 * jnp.ones((1, 1))
    found, _ = albedo_shift(*window, jnp.array([0.3]), jnp.array([width]))
    # Of an exponential reflectance w^2 rho' / rho is exact; the width is that seen by a pixel.
    np.testing.assert_allclose(found, (width**2 + 1 / 12) * slope, rtol=1e-5)


def test_a_clean_surface_keeps_its_sigma(sensor):
    _, on, off = printed_edges(sensor, 1.0, n=5000)
    _, sigma, shift, of_shift = guarded(on, off, 2.0)
    # Three standard deviations: 0.27 %, of Gaussian noise.
    assert np.mean(np.asarray(shift) != 0) < 0.006
    assert 0 < np.median(of_shift) < 4.0 * np.median(sigma)


def test_the_noise_of_the_shift(sensor):
    sensor = sensor(read_dn=READ, electrons_per_dn=GAIN, seed=5)
    off = sensor.expose(np.full((SAMPLES, 4000), 40.0)).astype(float)
    x = np.broadcast_to((np.arange(SAMPLES) - 11.5)[:, None], off.shape)
    centre, width = jnp.full(4000, 0.2), jnp.full(4000, 2.0)
    # No gate where no variance is claimed.
    used = jnp.ones(off.shape, bool)
    shift = lambda v: albedo_shift(jnp.asarray(off), jnp.asarray(x), used, v, centre, width)
    (free, _), (_, claimed) = shift(jnp.full((1, 1), 1e-12)), shift(jnp.full((1, 1), READ**2 + 1 / 12 + 1.0))
    np.testing.assert_allclose(np.std(free), np.mean(claimed), rtol=0.05)


def test_in_the_dark_nothing_is_claimed(sensor):
    _, on, off = printed_edges(sensor, 5.0, ambient=0.0)
    assert np.mean(np.asarray(guarded(on, off, 2.0)[2]) != 0) < 0.01


def test_an_offset_is_no_reflectance(sensor):
    _, on, off = printed_edges(sensor, 2.0, ambient=40.0)
    plain = np.asarray(guarded(on, off, 2.0)[2])
    raised = np.asarray(guarded(on + 20.0, off + 20.0, 2.0, offset=20.0)[2])
    both = (plain != 0) & (raised != 0)
    assert np.mean(both) > 0.8
    np.testing.assert_allclose(raised[both], plain[both], rtol=0.02)


def test_unused_samples_do_not_count_and_nothing_is_nan():
    x = jnp.asarray(np.broadcast_to((np.arange(SAMPLES) - 11.5)[:, None], (SAMPLES, 3)), jnp.float32)
    dark = jnp.full((SAMPLES, 3), 50.0, jnp.float32)
    used = jnp.ones((SAMPLES, 3), bool).at[14:, :].set(False).at[:, 2].set(False)
    number = lambda a: jnp.full(3, a, jnp.float32)
    shift = jax.jit(albedo_shift)
    variance = jnp.full((1, 1), 2.0, jnp.float32)
    found = shift(dark, x, used, variance, number(0.1), number(2.0))
    dirty = shift(dark.at[14:, :].set(255.0), x, used, variance, number(0.1), number(2.0))
    np.testing.assert_array_equal(found[0], 0.0)
    np.testing.assert_array_equal(dirty[0], 0.0)
    assert found[0].dtype == found[1].dtype == jnp.float32
    assert not np.any(np.isnan(np.asarray(found)))
