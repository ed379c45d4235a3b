"""What must not matter: where the stripe is, how frames are grouped, precision, array kind."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxscan.stripes import (
    ExtractionSetup,
    FrameFormat,
    LaserLine,
    NoiseModel,
    StripeSettings,
    extract_stripes,
    prepare_engines,
    stripes_of_frames,
)
from jaxscan.stripes.engine import StripeEngine
from jaxscan.stripes.search import learn_search


KNOWN = NoiseModel(read_dn=1.0, electrons_per_dn=40.0)
FIELDS = ("u", "sigma", "amplitude", "width", "chi2", "saturated", "valid")


@functools.cache
def unmoved(render, width):
    scene = render(width, 100.0)
    return scene, extract_stripes(scene.on, scene.off, noise=KNOWN)


@settings(max_examples=20, deadline=None)
@given(shift=st.integers(-24, 24), width=st.sampled_from([1.0, 2.0, 3.0]))
def test_shift_by_whole_pixels(render, shift, width):
    scene, still = unmoved(render, width)
    moved = extract_stripes(np.roll(scene.on, shift, 2), np.roll(scene.off, shift, 2), noise=KNOWN)
    both = np.asarray(still.valid & moved.valid)
    assert both.mean() > 0.99
    difference = (np.asarray(moved.u) - np.asarray(still.u) - shift)[both]
    # A shift may move the window's ends by a sample, where about a hundredth of the information
    # is: a tenth of sigma, four times that in the worst of 2048 rows.
    assert np.max(np.abs(difference) / np.asarray(still.sigma)[both]) < 0.4
    assert np.median(np.abs(difference)) < 2e-4


@pytest.mark.more
def test_more_frames_than_a_chunk(render):
    scene = render(1.5, 80.0, rows=64)
    on = np.concatenate([np.roll(scene.on, i, 1) for i in range(19)])
    off = np.concatenate([np.roll(scene.off, i, 1) for i in range(19)])
    stripes = extract_stripes(on, off, noise=KNOWN)
    assert stripes.u.shape == (19, 64)
    for i in range(19):
        np.testing.assert_array_equal(np.asarray(stripes.u)[i], np.roll(np.asarray(stripes.u)[0], i))
    np.testing.assert_array_equal(np.asarray(stripes.record), np.arange(19))


@pytest.mark.more
@pytest.mark.parametrize("first", [0, 3, 18])
def test_frames_inside_of_a_larger_array_are_those_frames(first, render):
    # They go to the compiled function without a copy, with bytes of other frames around them.
    scene = render(1.5, 80.0, rows=64)
    on, off = (np.concatenate([np.roll(frames, i, 1) for i in range(19)]) for frames in (scene.on, scene.off))
    setup = ExtractionSetup((96, 64), FrameFormat(), LaserLine(), StripeSettings())
    (engine,) = prepare_engines(on, off, [setup], noise=KNOWN)
    inside = engine.extract(on[first:], off[first:], 16).stripes
    apart = engine.extract(on[first:].copy(), off[first:].copy(), 16).stripes
    for one, other in zip(inside, apart, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    ("u", "share"), [(0.3, 0.3), (3.0, 0.95), (6.0, 0.99), (89.2, 0.99), (92.0, 0.95), (94.7, 0.3)]
)
def test_stripe_at_the_borders(u, share, render):
    scene = render(1.5, 150.0, u=np.full(2048, u))
    stripes = extract_stripes(scene.on, scene.off, noise=KNOWN)
    valid = np.asarray(stripes.valid)[0]
    # With half of the profile outside the image not every fit comes to rest.
    assert valid.mean() > share
    pull = ((np.asarray(stripes.u)[0] - u) / np.where(valid, np.asarray(stripes.sigma)[0], 1.0))[valid]
    # Part of the profile is cut off by the image: less information, but honest about it.
    assert 0.85 < np.sqrt(np.mean(pull**2)) < 1.15


@pytest.mark.more
@pytest.mark.parametrize("columns", [23, 65])
def test_images_of_any_size(columns, render):
    scene = render(1.0, 100.0, rows=64, columns=columns, u=np.full(64, columns / 2 - 0.3))
    stripes = extract_stripes(scene.on, scene.off, noise=KNOWN)
    assert np.all(np.asarray(stripes.valid))
    # Six sigma of 0.022 px.
    assert np.abs(np.asarray(stripes.u) - columns / 2 + 0.3).max() < 0.13


def test_same_with_and_without_64_bit(render):
    scene = render(1.5, 80.0)
    results = []
    for wide in (False, True):
        with jax.enable_x64(wide):
            results.append(extract_stripes(scene.on, scene.off))
    for name in FIELDS:
        a, b = (np.asarray(getattr(r, name)) for r in results)
        assert a.dtype == b.dtype, name
        # float32 in both: only the order of sums may differ.
        np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-4, err_msg=name)
    assert results[1].u.dtype == np.float32


def test_numpy_and_jax_frames(render):
    scene = render(1.5, 80.0)
    a = extract_stripes(scene.on, scene.off)
    b = extract_stripes(jnp.asarray(scene.on), jnp.asarray(scene.off))
    for name in FIELDS:
        np.testing.assert_array_equal(np.asarray(getattr(a, name)), np.asarray(getattr(b, name)))


SETUP = ExtractionSetup((96, 64), FrameFormat(), LaserLine(), StripeSettings())


@pytest.mark.more
def test_extraction_gives_what_the_pure_function_does_inside_a_larger_jit(render):
    scene = render(1.5, 80.0, rows=64)
    on, off = (np.concatenate([frame, frame[:, ::-1]]) for frame in (scene.on, scene.off))
    extracted = extract_stripes(on, off, noise=KNOWN)
    (engine,) = prepare_engines(on, off, [SETUP], noise=KNOWN)

    @jax.jit
    def compute(engine, on, off):
        stripes = stripes_of_frames(engine, on, off)
        count = jnp.sum(stripes.valid.astype(jnp.float32))
        return stripes, jnp.sum(jnp.where(stripes.valid, stripes.u, 0.0)) / count

    with jax.enable_x64(False):
        learned = StripeEngine(engine.setup, learn_search(engine.search, compute(engine, on, off)[0], engine.setup))
        traced, mean_centre = compute(learned, on, off)
    for name in FIELDS:
        a, b = np.asarray(getattr(extracted, name)), np.asarray(getattr(traced, name))
        # The order of float32 sums may differ.
        np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-4, err_msg=name)
    # A float32 mean over 128 centres near 48 px.
    assert abs(float(mean_centre) - np.asarray(extracted.u)[np.asarray(extracted.valid)].mean()) < 1e-3
