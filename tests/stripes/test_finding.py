"""Which rows hold a stripe: faint ones are found, empty ones and edges are not."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.stripes import (
    ExtractionSetup,
    FrameFormat,
    LaserLine,
    NoiseModel,
    StripeSettings,
    extract_stripes,
    whole_lines,
)
from jaxscan.stripes.peaks import find_peaks
from jaxscan.stripes.planes import Plane
from jaxscan.stripes.search import prepare_search


KNOWN = NoiseModel(read_dn=1.0, electrons_per_dn=40.0)
# Standard deviation of a difference pixel: read noise, shot noise of 10 DN, rounding, twice.
NOISE_DN = np.sqrt(2 * (1.0 + 10 / 40 + 1 / 12))


def _empty(stripes, rows):
    for name in ("u", "sigma", "amplitude", "width", "chi2", "saturated"):
        assert np.all(np.asarray(getattr(stripes, name))[:, rows] == 0), name


@pytest.mark.more
@pytest.mark.parametrize("width", [1.0, 2.0, 3.0])
def test_faint_stripe_is_located(width, render):
    u = np.random.default_rng(1).uniform(60, 1220, 1024)
    scene = render(width, 5 * NOISE_DN, columns=1280, rows=1024, u=u)
    setup = ExtractionSetup((1280, 1024), FrameFormat(), LaserLine(), StripeSettings())
    search = prepare_search(setup, KNOWN, whole_lines(setup), has_off=True)
    on, off = (Plane.of(jnp.asarray(frames[0])) for frames in (scene.on, scene.off))
    gate = (jnp.asarray(field) for field in (search.low, search.high, search.thresholds))
    with jax.enable_x64(False):
        peaks = find_peaks(on, off, jnp.float32(1.0), *gate, pitch=1)
    near = np.asarray(peaks.exists) & (np.abs(np.asarray(peaks.at) - u) < 3 * width + 1)
    assert near.any(0).mean() > 0.98


def test_a_brighter_place_does_not_hide_a_stripe_in_a_darker_one():
    off = np.full((64, 640), 5, np.uint8)
    off[:, :320] = 200
    on = off.copy()
    # Four maxima in the bright half, each below the threshold there and higher than the stripe in the dark half.
    for column, height in ((60, 17), (120, 18), (180, 16), (240, 17), (480, 13)):
        on[:, column - 1 : column + 3] += np.uint8(height)
    thresholds = np.where(np.arange(256) < 100, 100, 250).astype(np.int16)
    gate = jnp.zeros(64, jnp.int32), jnp.full(64, 640, jnp.int32), jnp.asarray(thresholds)
    with jax.enable_x64(False):
        planes = (Plane.of(jnp.asarray(frame)) for frame in (on, off))
        alone = find_peaks(*planes, jnp.float32(1.0), *gate, pitch=1)
        on[:, 100:300] = off[:, 100:300]
        planes = (Plane.of(jnp.asarray(frame)) for frame in (on, off))
        beside = find_peaks(*planes, jnp.float32(1.0), *gate, pitch=1)
    assert not np.asarray(alone.exists).any()
    at, exists = np.asarray(beside.at), np.asarray(beside.exists)
    np.testing.assert_array_equal(exists.sum(0), 1)
    np.testing.assert_allclose(at[exists], 480.5, atol=1.0)


@pytest.mark.slow
def test_false_rows_on_many_empty_frames(render):
    false = [
        np.asarray(extract_stripes(s.on, s.off, noise=KNOWN).valid).mean()
        for s in (render(1.0, 0.0, columns=1280, rows=4096, seed=seed) for seed in range(10))
    ]
    assert np.mean(false) < 0.002


def test_poisoned_rows_change_nothing_elsewhere(render):
    scene = render(1.5, 60.0)
    clean = extract_stripes(scene.on, scene.off, noise=KNOWN)
    rng = np.random.default_rng(5)
    on, off = scene.on.copy(), scene.off.copy()
    on[:, 500:900] = rng.integers(0, 256, on[:, 500:900].shape)
    off[:, 500:900] = rng.integers(0, 256, off[:, 500:900].shape)
    poisoned = extract_stripes(on, off, noise=KNOWN)
    others = np.r_[0:500, 900:2048]
    for name in ("u", "sigma", "amplitude", "width", "chi2", "skew", "saturated", "valid"):
        assert np.all(np.isfinite(np.asarray(getattr(poisoned, name))))
    np.testing.assert_array_equal(*(np.asarray(stripes.valid)[:, others] for stripes in (clean, poisoned)))
    # Rows share only what is learned of the width, to which a fifth of the rows now say nothing.
    moved = np.abs(np.asarray(poisoned.u) - np.asarray(clean.u))[:, others]
    assert np.max(moved / np.asarray(clean.sigma)[:, others]) < 0.02


def test_garbage_away_from_the_stripe_changes_nothing(render):
    scene = render(1.5, 60.0)
    # Of rows whose stripes have nothing to do with each other the brightest is the one.
    settings = StripeSettings(choice="brightest")
    clean = extract_stripes(scene.on, scene.off, noise=KNOWN, settings=settings)
    on = scene.on.copy()
    # Half as bright and 25 px away at least: neither the maximum nor inside the window.
    on[:, :, 4:7] = 30
    on[:, :, -7:-4] = 30
    disturbed = extract_stripes(on, scene.off, noise=KNOWN, settings=settings)
    np.testing.assert_array_equal(np.asarray(clean.u), np.asarray(disturbed.u))


def test_negative_stripe_and_edges_do_not_win(render, profile, sensor):
    u = np.full(2048, 30.3)
    camera = sensor()
    ambient = np.full((2048, 96), 60.0)
    ambient[:, 60:] = 200.0
    dark = profile(np.full(2048, 75.0), 2.0, 90.0, 96)
    on = camera.expose(1.005 * ambient + profile(u, 1.5, 40.0, 96))[None]
    off = camera.expose(ambient + dark)[None]
    stripes = extract_stripes(on, off, noise=KNOWN)
    assert np.asarray(stripes.valid).mean() > 0.99
    assert np.abs(np.asarray(stripes.u)[0] - u).max() < 1.0


def test_albedo_edge_without_laser_off_frame(profile, sensor):
    camera = sensor()
    edge = np.full((2048, 96), 60.0)
    edge[:, 60:] = 200.0
    alone = extract_stripes(camera.expose(edge)[None], None, noise=KNOWN)
    # An edge of 140 DN is no stripe, whatever the noise does beside it.
    near_edge = np.asarray(alone.valid)[0] & (np.abs(np.asarray(alone.u)[0] - 60) < 8)
    assert near_edge.mean() < 0.01
    u = np.full(2048, 30.3)
    both = extract_stripes(camera.expose(edge + profile(u, 1.5, 40.0, 96))[None], None, noise=KNOWN)
    valid = np.asarray(both.valid)[0]
    assert valid.mean() > 0.99
    assert np.abs(np.asarray(both.u)[0] - u)[valid].max() < 1.0


@pytest.mark.parametrize(("on", "off"), [(0, 0), (255, 255), (0, 255), (255, 0), (7, 3)])
def test_flat_frames_hold_no_point(on, off):
    shape = (1, 2048, 96)
    stripes = extract_stripes(np.full(shape, on, np.uint8), np.full(shape, off, np.uint8), noise=KNOWN)
    assert not np.any(np.asarray(stripes.valid))
    _empty(stripes, np.arange(2048))


def test_one_bright_pixel_is_finite():
    on = np.zeros((1, 2048, 96), np.uint8)
    on[0, np.arange(2048), np.arange(2048) % 96] = 255
    stripes = extract_stripes(on, np.zeros_like(on), noise=KNOWN)
    for name in ("u", "sigma", "amplitude", "width", "chi2"):
        assert np.all(np.isfinite(np.asarray(getattr(stripes, name)))), name
