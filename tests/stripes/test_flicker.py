"""The gain between the frames of a pair: lamps that flicker, a stripe, and frames that tell nothing."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.stripes.frames.flicker import NO_INFORMATION, SMALLEST_CHANGE, LampRatio, applied_ratio, lamp_ratio


ROWS, COLUMNS = 64, 160
# The part of sigma that is noise; the rest is 0.03 of a pixel's noise for what glow may pull.
NOISE = 1.0 / np.sqrt(1.0 + 0.03**2 * ROWS * COLUMNS)


def room(rng, frames=1, mean=40.0):
    """Smooth and textured ambient light [frames, rows, columns]."""
    x, y = np.linspace(0, 1, COLUMNS), np.linspace(0, 1, ROWS)[:, None]
    shade = mean * (0.4 + x + 0.3 * np.sin(9 * y))
    return np.broadcast_to(shade * np.where(rng.random((ROWS, COLUMNS)) < 0.3, 0.4, 1.0), (frames, ROWS, COLUMNS))


def laser(stripe=120.0, glow=8.0, second=40.0):
    """A stripe, its glow over a tenth of the pixels, and a second reflection [rows, columns]."""
    light = np.zeros((ROWS, COLUMNS))
    light[:, 60:76] += glow
    light[:, 67:69] += stripe
    light[::2, 120] += second
    return light


def both(sensor, on, off):
    return tuple(np.asarray(sensor.expose(a)).reshape(len(a), -1) for a in (on, off))


@pytest.mark.parametrize("gain", [0.8, 0.95, 1.0, 1.01, 1.2])
def test_gain_of_flickering_lamps_under_a_stripe(sensor, gain):
    sensor = sensor(seed=1)
    off = room(sensor.rng, frames=20)
    found = lamp_ratio(*both(sensor, gain * off + laser(), off), 1.0, 40.0)
    # The glow is 4 standard deviations of a pixel's noise; what it still pulls is far below the
    # smallest change that is applied.
    error, noise = np.asarray(found.ratio) - gain, NOISE * np.asarray(found.sigma)
    assert abs(np.mean(error)) < 0.4 * SMALLEST_CHANGE
    assert np.all(np.abs(error) < 0.4 * SMALLEST_CHANGE + 4.0 * noise)
    assert np.all(noise < 0.001)
    assert 0.9 < np.mean(found.unrest) < 1.15


def test_sigma_is_the_noise_and_what_glow_may_pull(sensor):
    sensor = sensor(seed=2)
    off = room(sensor.rng, frames=400, mean=15.0)
    found = lamp_ratio(*both(sensor, 1.1 * off, off), 1.0, 40.0)
    score = (np.asarray(found.ratio) - 1.1) / np.asarray(found.sigma)
    # Without glow the noise alone is left.
    # The rounding of the deviation over 400 pairs is 3.5 %; the rest is what clipped weights leave.
    np.testing.assert_allclose(np.std(score), NOISE, rtol=0.15)
    assert abs(np.mean(score)) < 0.3 * NOISE
    np.testing.assert_allclose(np.mean(found.unrest), 1.0, atol=0.03)


@pytest.mark.parametrize("glow", [1.0, 2.0, 3.0, 5.0, 8.0, 15.0])
@pytest.mark.parametrize("mean", [5.0, 20.0, 60.0])
def test_glow_of_any_brightness_is_not_taken_for_lamps(sensor, glow, mean):
    sensor = sensor(seed=9)
    off = np.broadcast_to(sensor.rng.gamma(4.0, mean / 4.0, (ROWS, COLUMNS)), (40, ROWS, COLUMNS))
    steady = lamp_ratio(*both(sensor, off + laser(glow=glow), off), 1.0, 40.0)
    assert np.mean(np.asarray(applied_ratio(steady)) != 1.0) <= 0.025
    brighter = lamp_ratio(*both(sensor, 1.1 * off + laser(glow=glow), off), 1.0, 40.0)
    assert np.all(np.abs(np.asarray(brighter.ratio) - 1.1) < 5.0 * np.asarray(brighter.sigma))


def test_steady_light_is_left_exactly_as_it_is(sensor):
    sensor = sensor(seed=3)
    off = room(sensor.rng, frames=50)
    found = lamp_ratio(*both(sensor, off + laser(), off), 1.0, 40.0)
    assert np.any(np.asarray(found.ratio) != 1.0)
    np.testing.assert_array_equal(applied_ratio(found), 1.0)
    brighter = lamp_ratio(*both(sensor, 1.03 * off + laser(), off), 1.0, 40.0)
    np.testing.assert_array_equal(applied_ratio(brighter), brighter.ratio)


def test_a_change_within_its_uncertainty_is_not_applied():
    number = lambda *values: jnp.asarray(values, jnp.float32)
    pair = LampRatio(number(1.02, 1.02, 0.996, 0.99), number(0.01, 0.001, 1e-5, 0.001), number(1, 1, 1, 1))
    np.testing.assert_array_equal(applied_ratio(pair), number(1.0, 1.02, 1.0, 0.99))


@pytest.mark.parametrize("level", [0.0, 300.0])
def test_frames_without_information(sensor, level):
    sensor = sensor(seed=4)
    off = np.full((3, ROWS, COLUMNS), level)
    found = lamp_ratio(*both(sensor, off + laser(), off), 1.0, 40.0)
    np.testing.assert_array_equal(found.ratio, 1.0)
    np.testing.assert_array_equal(found.sigma, NO_INFORMATION)
    np.testing.assert_array_equal(applied_ratio(found), 1.0)
    assert not np.any(np.isnan(found.unrest))


def test_lamps_in_a_partly_saturated_picture(sensor):
    sensor = sensor(seed=5)
    off = np.array(room(sensor.rng, frames=5))
    off[:, :, 100:] = 400.0
    found = lamp_ratio(*both(sensor, 1.15 * off + laser(), off), 1.0, 40.0)
    error = np.abs(np.asarray(found.ratio) - 1.15)
    assert np.all(error < 0.4 * SMALLEST_CHANGE + 4.0 * NOISE * np.asarray(found.sigma))


def test_what_moves_shows_as_unrest_and_not_as_gain(sensor):
    sensor = sensor(seed=6)
    off = np.array(room(sensor.rng, frames=10))
    off[:, 10:50, 20:60] = 120.0
    on = np.array(room(np.random.default_rng(6), frames=10))
    on[:] = off
    on[:, 10:50, 20:28] = 30.0
    on[:, 10:50, 60:68] = 120.0
    moved = lamp_ratio(*both(sensor, on + laser(), off), 1.0, 40.0)
    assert np.all(np.asarray(moved.unrest) > 1.3)
    np.testing.assert_allclose(moved.ratio, 1.0, atol=SMALLEST_CHANGE)


def test_any_number_of_pixels_single_precision_and_compiled(sensor):
    sensor = sensor(seed=8)
    off = room(sensor.rng, frames=2)
    on, off = (a[:, :9001] for a in both(sensor, 0.9 * off, off))
    found = jax.jit(lamp_ratio)(on, off, 1.0, 40.0)
    assert all(field.dtype == jnp.float32 for field in found)
    np.testing.assert_allclose(found.ratio, 0.9, atol=0.003)
