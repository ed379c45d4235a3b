"""What is left of the stripe in the laser-off frame."""

import numpy as np
import pytest

from jaxscan.stripes.leak import NO_INFORMATION, Leak, OffWindow, frame_leak, leak


SAMPLES, LINES = 24, 2000


def measured(
    sensor, profile, ratio, *, amplitude=80.0, width=2.0, background=20.0, seed=0, slope=0.5, dtype=np.float64
):
    """Lines [samples, n] of laser-off frames in which a part of the stripe is left."""
    sensor = sensor(seed=seed)
    u = SAMPLES / 2 + sensor.rng.uniform(-0.5, 0.5, LINES)
    x = np.arange(float(SAMPLES))
    level = background + slope * (x - 12) + profile(u, width, ratio * amplitude, SAMPLES)
    dark = sensor.expose(level).T.astype(float)
    number = lambda a: np.full(LINES, a, dtype)
    variance = 1.0 + 1 / 12 + level.T / 40.0
    columns = np.broadcast_to(x[:, None], dark.shape)
    dark, columns, u, variance = (np.asarray(a, dtype) for a in (dark, columns, u, variance))
    window = OffWindow(dark, columns, np.ones(dark.shape, bool), variance)
    return leak(window, u, number(width), number(amplitude))


@pytest.mark.parametrize("ratio", [0.0, 0.02, 0.3])
def test_ratio_and_sigma_are_true(sensor, profile, ratio):
    found = measured(sensor, profile, ratio)
    score = (np.asarray(found.ratio) - ratio) / np.asarray(found.sigma)
    # 2000 lines tell a mean to 2.2 % of a standard deviation and the standard deviation to 1.6 %.
    assert abs(np.mean(score)) < 0.1
    np.testing.assert_allclose(np.std(score), 1.0, atol=0.06)


def test_a_frame_knows_a_leak_that_its_lines_do_not(sensor, profile):
    lines = measured(sensor, profile, 0.005)
    assert np.median(lines.sigma) > 0.005
    frame = frame_leak(lines, np.ones(LINES, bool))
    assert abs(float(frame.ratio) - 0.005) < 3 * float(frame.sigma)
    assert float(frame.ratio) > 5 * float(frame.sigma)


def test_frames_are_summed_up_apart_and_texture_does_not_spoil_them(sensor, profile):
    several = [measured(sensor, profile, ratio, seed=seed) for seed, ratio in enumerate([0.0, 0.05, 0.0])]
    ratio, sigma = (np.stack([np.asarray(getattr(one, name)) for one in several]) for name in Leak._fields)
    ratio[2, ::20] += 0.8
    valid = np.ones(ratio.shape, bool)
    valid[1, :100] = False
    ratio[1, :100] = 9.0
    frame = frame_leak(Leak(np.asarray(ratio), np.asarray(sigma)), np.asarray(valid))
    assert frame.ratio.shape == (3,)
    np.testing.assert_array_less(np.abs(np.asarray(frame.ratio)[:2] - [0.0, 0.05]), 4 * np.asarray(frame.sigma)[:2])
    # A twentieth of the lines is off by 0.8; a plain mean would say 0.04.
    assert abs(float(frame.ratio[2])) < 0.004


def test_what_tells_nothing_says_so():
    x = np.asarray(np.broadcast_to(np.arange(24.0)[:, None], (24, 3)), np.float32)
    number = lambda *a: np.asarray(a, np.float32)
    used = np.zeros((24, 3), bool)
    used[:, 0] = used[11:13, 1] = True
    dark = OffWindow(np.full((24, 3), 30.0, np.float32), x, used, np.full((1, 1), 2.0, np.float32))
    found = leak(dark, number(12, 12, 12), number(2, 2, 2), number(0, 50, 50))
    np.testing.assert_array_equal(found.ratio, 0.0)
    np.testing.assert_array_equal(found.sigma, NO_INFORMATION)
    frame = frame_leak(found, np.ones(3, bool))
    assert float(frame.ratio) == 0.0 and float(frame.sigma) == NO_INFORMATION
    assert frame.ratio.dtype == np.float32


def test_single_precision_is_enough_on_bright_slopes(sensor, profile):
    double, single = (
        measured(sensor, profile, 0.1, background=150.0, slope=3.0, dtype=dtype) for dtype in (np.float64, np.float32)
    )
    assert single.ratio.dtype == np.float32
    assert abs(np.mean(double.ratio) - 0.1) < 0.003
    np.testing.assert_allclose(single.ratio, double.ratio, atol=0.01 * float(np.median(double.sigma)))
