"""Second reflections as bright as the stripe: which one is the stripe's, the lines above and below know."""

import numpy as np
import pytest

from jaxscan.stripes import NoiseModel, estimate_noise, extract_stripes


FRAMES, ROWS, COLUMNS = 24, 512, 320
AMBIENT = 10.0
SHARE = 0.2
APART = 12.0
WIDTH, AMPLITUDE = 1.6, 100.0
PATCH = 25
"""Columns in which a stripe is rendered: 4.6 standard deviations of the widest."""


def _profiles(rng):
    """Smooth centres with two jumps of depth each, [frames, rows]."""
    v = np.linspace(-1.0, 1.0, ROWS)
    course = rng.uniform(130, 190, (FRAMES, 1)) + rng.uniform(-20, 20, (FRAMES, 1)) * v
    course = course + rng.uniform(-15, 15, (FRAMES, 1)) * v**2
    jumps = rng.uniform(8, 30, (FRAMES, 2)) * rng.choice([-1, 1], (FRAMES, 2))
    places = np.sort(rng.uniform(0.15, 0.85, (FRAMES, 2)), 1) * ROWS
    below = np.arange(ROWS)[None, None, :] >= places[:, :, None]
    return course + (jumps[:, :, None] * below).sum(1)


def _runs(truth, rng):
    """Centres of reflections in runs of 5 to 150 rows with a course of their own, brightness, width; which rows."""
    u, factor, wider = np.zeros(truth.shape), np.zeros(truth.shape), np.ones(truth.shape)
    affected = np.zeros(truth.shape, bool)
    while affected.mean() < SHARE:
        frame, length = rng.integers(FRAMES), int(rng.integers(5, 151))
        start = int(rng.integers(0, ROWS - length + 1))
        run = slice(start, start + length)
        v = np.arange(length) - length / 2
        course = rng.uniform(20, COLUMNS - 20) + rng.uniform(-0.4, 0.4) * v + rng.uniform(-8, 8) * (v / 75) ** 2
        beside = np.abs(course - truth[frame, run]).min() >= APART
        if not beside or course.min() < 12 or course.max() > COLUMNS - 13 or affected[frame, run].any():
            continue
        u[frame, run], affected[frame, run] = course, True
        factor[frame, run] = np.linspace(*rng.uniform(0.7, 1.3, 2), length)
        wider[frame, run] = rng.uniform(0.8, 1.6)
    return u, factor, wider, affected


def _single_rows(truth, rng):
    """The same on random rows, each at a place of its own."""
    u = rng.uniform(12, COLUMNS - 13, truth.shape)
    affected = (rng.random(truth.shape) < 1.15 * SHARE) & (np.abs(u - truth) >= APART)
    return u, rng.uniform(0.7, 1.3, truth.shape), rng.uniform(0.8, 1.6, truth.shape), affected


def _light(u, width, peak, profile):
    """A stripe per row [frames, rows, columns]; `width` and `peak` may differ from row to row."""
    start = np.floor(u).astype(int) - PATCH // 2
    flat = lambda a: np.broadcast_to(a, u.shape).reshape(-1)
    patch = profile(flat(u - start), flat(width)[:, None], 1.0, PATCH) * flat(peak)[:, None]
    light = np.zeros((*u.shape, COLUMNS))
    np.put_along_axis(light, start[..., None] + np.arange(PATCH), patch.reshape(*u.shape, PATCH), -1)
    return light


@pytest.fixture(scope="module", params=[_runs, _single_rows], ids=["runs", "single rows"])
def reflected(request, profile, sensor):
    """A pair of stacks with reflections: on, off, true centres, affected rows."""
    rng = np.random.default_rng(5)
    truth = _profiles(rng)
    u, factor, wider, affected = request.param(truth, rng)
    light = _light(truth, WIDTH, AMPLITUDE, profile)
    light += _light(np.where(affected, u, 160.0), WIDTH * wider, AMPLITUDE * factor * affected, profile)
    camera = sensor(seed=1)
    return camera.expose(AMBIENT + light), camera.expose(np.full_like(light, AMBIENT)), truth, affected


@pytest.mark.more
def test_the_true_stripe_is_chosen(reflected):
    on, off, truth, affected = reflected
    assert 0.18 < affected.mean() < 0.25
    stripes = extract_stripes(on, off, noise=NoiseModel(read_dn=1.0, electrons_per_dn=40.0))
    right = np.asarray(stripes.valid) & (np.abs(np.asarray(stripes.u) - truth) < 1.5)
    # By brightness alone it would be less than half: a wider or brighter reflection wins.
    assert right[affected].mean() >= 0.99
    # What the neighbours say must not cost the rows that nothing disturbs.
    assert right[~affected].mean() >= 0.995


def test_reflections_are_not_taken_for_noise(reflected):
    on, off, _, _ = reflected
    noise = estimate_noise(on, off)
    # Half a per cent is what the number of samples gives; reflections fill a fifth of the rows.
    level = noise.read_dn**2 + AMBIENT / noise.electrons_per_dn
    assert level == pytest.approx(1.0 + AMBIENT / 40.0, rel=0.1)
    assert 20.0 < noise.electrons_per_dn < 80.0
