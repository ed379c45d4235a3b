"""Pairs of frames that are not what they should be are told."""

import numpy as np
import pytest

from jaxscan.stripes import LaserLine, extract_stripes
from jaxscan.stripes.pairs import NO_INFORMATION, frame_leak, judge_pairs, leak


ROWS, COLUMNS = 256, 320
PHASE = 2 * np.pi * np.arange(COLUMNS) / 40


def _pair(profile, sensor, leaking=0.0, moved=0):
    """A stripe of 100 DN on a textured wall, part of it in the laser-off frame, which may be shifted."""
    camera = sensor(seed=2)
    texture = np.broadcast_to(60.0 + 25.0 * np.sin(PHASE), (2, ROWS, COLUMNS))
    u = 160.0 + 20.0 * np.sin(np.arange(ROWS) / 50)
    stripe = profile(u, 2.0, 100.0, COLUMNS)
    on = camera.expose(texture + stripe)
    off = camera.expose(np.roll(texture, moved, axis=2) + leaking * stripe)
    return on, off


def judged(on, off):
    return judge_pairs(on, off, extract_stripes(on, off), line=LaserLine())


@pytest.mark.more
@pytest.mark.parametrize("leaking", [0.0, 0.05, 0.2])
def test_what_leaks_is_measured(profile, sensor, leaking):
    found = judged(*_pair(profile, sensor, leaking))
    # Relative to what the difference keeps of the stripe.
    expected = leaking / (1.0 - leaking)
    # A wave of the texture, 8 stripe widths long, is not all a straight line: 1 % of the stripe.
    assert np.all(np.abs(found.leak - expected) < 0.01 + 4 * found.leak_sigma)
    assert np.all(found.leak_sigma < 0.02)
    assert np.all(found.unrest < 1.3)


@pytest.mark.more
def test_motion_is_seen(profile, sensor):
    found = judged(*_pair(profile, sensor, moved=6))
    assert np.all(found.unrest > 2.0)


SAMPLES, LINES = 25, 2000


def measured(sensor, profile, ratio, *, amplitude=80.0, width=2.0, background=20.0, seed=0):
    """Lines [n, samples] of laser-off frames in which a part of the stripe is left."""
    sensor = sensor(seed=seed)
    u = sensor.rng.uniform(-0.5, 0.5, LINES)
    x = np.arange(SAMPLES) - 12.0
    level = background + 0.5 * x + profile(u, width, ratio * amplitude, SAMPLES, first=-12)
    dark = sensor.expose(level).astype(float)
    number = lambda a: np.full(LINES, a)
    return leak(dark, 1.0 / (1.0 + 1 / 12 + level / 40.0), u, number(width), number(amplitude))


@pytest.mark.parametrize("ratio", [0.0, 0.02, 0.3])
def test_ratio_and_sigma_are_true(sensor, profile, ratio):
    found, sigma = measured(sensor, profile, ratio)
    score = (found - ratio) / sigma
    # 2000 lines tell a mean to 2.2 % of a standard deviation and the standard deviation to 1.6 %.
    assert abs(np.mean(score)) < 0.1
    np.testing.assert_allclose(np.std(score), 1.0, atol=0.06)


def test_a_frame_knows_a_leak_that_its_lines_do_not(sensor, profile):
    lines = measured(sensor, profile, 0.005)
    assert np.median(lines[1]) > 0.005
    ratio, sigma = frame_leak(*lines, np.ones(LINES, bool))
    assert abs(ratio - 0.005) < 3 * sigma and ratio > 5 * sigma


def test_frames_are_summed_up_apart_and_texture_does_not_spoil_them(sensor, profile):
    several = [measured(sensor, profile, ratio, seed=seed) for seed, ratio in enumerate([0.0, 0.05, 0.0])]
    ratio, sigma = (np.stack(field) for field in zip(*several, strict=True))
    ratio[2, ::20] += 0.8
    valid = np.ones(ratio.shape, bool)
    valid[1, :100] = False
    ratio[1, :100] = 9.0
    of_frame, known_to = frame_leak(ratio, sigma, valid)
    assert of_frame.shape == (3,)
    np.testing.assert_array_less(np.abs(of_frame[:2] - [0.0, 0.05]), 4 * known_to[:2])
    # A twentieth of the lines is off by 0.8; a plain mean would say 0.04.
    assert abs(of_frame[2]) < 0.004


def test_what_tells_nothing_says_so():
    weight = np.zeros((3, SAMPLES))
    weight[0] = weight[1, 11:13] = 0.5
    found, sigma = leak(np.full((3, SAMPLES), 30.0), weight, np.zeros(3), np.full(3, 2.0), np.array([0.0, 50.0, 50.0]))
    np.testing.assert_array_equal(found, 0.0)
    np.testing.assert_array_equal(sigma, NO_INFORMATION)
    assert frame_leak(found, sigma, np.ones(3, bool)) == (0.0, NO_INFORMATION)
