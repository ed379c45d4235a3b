"""Speckle learned from the stripes themselves; fields of coherent light with known truth, apart from the library."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.stripes import (
    ExtractionSetup,
    FrameFormat,
    LaserLine,
    NoiseModel,
    ProfileRows,
    StripeSettings,
    extract_stripes,
    scatter_law,
)
from jaxscan.stripes.correlation import INDEPENDENT
from jaxscan.stripes.engine import prepare_engines
from jaxscan.stripes.fit import FitRules, Start, Window, fit_stripe
from jaxscan.stripes.speckle import Rows, correct_speckle


pytestmark = pytest.mark.more


KNOWN = NoiseModel(read_dn=1.7, electrons_per_dn=8.0, black_dn=5.0)
FINE = 4
ROWS, COLUMNS, FRAMES, WIDTH = 256, 64, 8, 1.3
AMPLITUDE = 130.0 - 90.0 * np.cos(np.linspace(0, 4 * np.pi, ROWS))


def _patterns(shape, contrast, grain, rng):
    """Mean of 1 / contrast^2 speckle patterns; `grain` is wavelength times f-number [px]."""
    frequency = np.hypot(*np.meshgrid(*(np.fft.fftfreq(n, 1 / FINE) for n in shape), indexing="ij"))
    total = np.zeros(shape)
    for _ in range(round(1 / contrast**2)):
        waves = (rng.normal(size=shape) + 1j * rng.normal(size=shape)) * (frequency <= 0.5 / grain)
        total += np.abs(np.fft.ifft2(waves)) ** 2
    return total / total.mean()


def _scene(contrast, grain=0.5, *, rough=0.0, lobe=0.0, seed=1):
    """Pairs of frames and the true centres [frames, rows] of a gently curved stripe."""
    rng = np.random.default_rng(seed)
    v = np.linspace(-0.5, 0.5, ROWS)
    u = COLUMNS / 2 + rng.uniform(-2, 2, (FRAMES, 1)) + rng.uniform(-6, 6, (FRAMES, 1)) * v + 5 * v**2
    u = u + rng.uniform(-rough, rough, u.shape)
    fine = (np.arange(COLUMNS * FINE) + 0.5) / FINE - 0.5
    room = np.linspace(3, 60, ROWS)[:, None] * np.ones(COLUMNS)
    lit = []
    for centre in u:
        x = fine - np.repeat(centre, FINE)[:, None]
        light = np.exp(-0.5 * (x / WIDTH) ** 2) + lobe * np.exp(-0.5 * ((np.abs(x) - 4.0) / WIDTH) ** 2)
        light *= np.repeat(AMPLITUDE, FINE)[:, None]
        if contrast:
            light *= _patterns(light.shape, contrast, grain, rng)
        lit.append(light.reshape(ROWS, FINE, COLUMNS, FINE).mean((1, 3)))

    def expose(light):
        electrons = rng.poisson(8.0 * light)
        return np.clip(np.rint(electrons / 8.0 + 5.0 + 1.7 * rng.normal(size=light.shape)), 0, 255).astype(np.uint8)

    return expose(room + np.stack(lit)), expose(room + np.zeros((FRAMES, 1, 1))), u


def _ratio(stripes, u, rows=slice(None)):
    """Stated sigma over error, both root mean square."""
    valid = np.asarray(stripes.valid)[:, rows]
    error, sigma = (np.asarray(stripes.u) - u)[:, rows][valid], np.asarray(stripes.sigma)[:, rows][valid]
    return np.sqrt(np.mean(sigma**2) / np.mean(error**2))


def _learned(on, off, noise=KNOWN, settings=None):
    frames = FrameFormat("mono8", "linear")
    setup = ExtractionSetup((COLUMNS, ROWS), frames, LaserLine(), settings or StripeSettings())
    (engine,) = prepare_engines(on, off, [setup], noise=noise)
    return engine.learn(on, off).noise


# Grains of half a pixel, and of one and a half: then neighbouring pixels and rows share them.
@pytest.mark.more
@pytest.mark.parametrize(("contrast", "grain"), [(0.5, 0.5), (0.5, 1.5), (0.25, 1.0)])
def test_sigma_is_honest_where_speckle_rules(contrast, grain):
    on, off, u = _scene(contrast, grain)
    stripes = extract_stripes(on, off, noise=KNOWN)
    assert np.mean(np.asarray(stripes.valid)) > 0.995
    # Photons alone explain less than four fifths of the error: the learned speckle is needed.
    assert _ratio(extract_stripes(on, off, noise=KNOWN, settings=StripeSettings(speckle=0.0)), u) < 0.8
    # 2048 rows, of which some share grains: 2 % of a root mean square; asked for are 10 %.
    assert 0.9 < _ratio(stripes, u) < 1.1
    for low, high in ((30, 100), (100, 170), (170, 230)):
        # A third of the rows each: three standard errors are 8 % with shared grains.
        assert 0.9 - 0.04 < _ratio(stripes, u, (low <= AMPLITUDE) & (high > AMPLITUDE)) < 1.1 + 0.04


def test_centres_gain_by_weights_that_know_speckle():
    on, off, u = _scene(0.5)
    error = []
    for speckle in (0.0, None):
        stripes = extract_stripes(on, off, noise=KNOWN, settings=StripeSettings(speckle=speckle))
        valid = np.asarray(stripes.valid)
        error.append(np.sqrt(np.mean((np.asarray(stripes.u) - u)[valid] ** 2)))
    # Speckle of bright pixels then weighs no more than that of dim ones: a fifth here.
    assert error[1] < 0.9 * error[0]


def test_without_speckle_nothing_changes():
    on, off, u = _scene(0.0)
    learned = extract_stripes(on, off, noise=KNOWN)
    without = extract_stripes(on, off, noise=KNOWN, settings=StripeSettings(speckle=0.0))
    for name in ("u", "sigma", "amplitude", "width", "valid"):
        np.testing.assert_array_equal(np.asarray(getattr(learned, name)), np.asarray(getattr(without, name)))
    assert 0.9 < _ratio(learned, u) < 1.1


def test_a_rough_surface_is_no_speckle():
    on, off, _ = _scene(0.0, rough=0.5)
    assert _learned(on, off).speckle == 0.0


def test_a_profile_that_is_no_gaussian_is_no_speckle():
    on, off, _ = _scene(0.0, lobe=0.06)
    assert _learned(on, off).speckle == 0.0


def test_learned_contrast_and_what_neighbours_share():
    scenes = [_scene(0.5, grain)[:2] for grain in (0.5, 1.5)]
    fine, coarse = (_learned(*pairs) for pairs in scenes)
    # A pixel holds about three and a half grains of half a pixel, so a little over half of the contrast is left.
    assert fine.speckle == pytest.approx(0.26, rel=0.15)
    assert coarse.speckle > 1.5 * fine.speckle
    shared = []
    for pairs in scenes:
        found = extract_stripes(*pairs, noise=KNOWN)
        rows = ProfileRows(*(np.asarray(field) for field in (found.u, found.sigma, found.valid, found.amplitude)))
        shared.append(sum(scatter_law(rows).correlation.near[:1]))
    assert shared[0] < 0.1
    # |2 J1(x) / x|^2 at x = pi / 1.5 is 0.29; pixels average it up a little.
    assert shared[1] == pytest.approx(0.3, abs=0.15)


def test_a_given_contrast_is_taken():
    on, off, _ = _scene(0.0)
    assert _learned(on, off, NoiseModel(1.7, 8.0, 5.0, speckle=0.2)).speckle == pytest.approx(0.2)
    assert _learned(on, off, settings=StripeSettings(speckle=0.1)).speckle == pytest.approx(0.1)
    assert extract_stripes(on, off, noise=NoiseModel(1.7, 8.0, 5.0, speckle=0.2)).sigma.mean() > 1.2 * (
        extract_stripes(on, off, noise=KNOWN).sigma.mean()
    )


def test_speckle_does_not_hide_a_stripe():
    x = np.arange(24.0) - 11.5
    level = jnp.asarray(60.0 * np.exp(-0.5 * (x / 1.5) ** 2))[:, None]
    one = jnp.ones(1)
    window = Window(level, jnp.full((24, 1), 8.0), one, one, one / 8)
    start = Start(jnp.zeros(1), 60.0 * one, 1.5 * one, None)
    fits = [fit_stripe(window, start, FitRules(10.0, speckle=c), iterations=3) for c in (0.0, 1.0)]
    # Whether there is a stripe is asked against the noise without one.
    assert float(fits[1].energy[0]) == pytest.approx(float(fits[0].energy[0]), rel=0.02)
    assert float(fits[1].variance[0]) > 10 * float(fits[0].variance[0])


def _stated(scatter, seed=0):
    """Rows whose centres scatter by `scatter` times the speckle that is stated, and the variance by photons."""
    rng = np.random.default_rng(seed)
    shape = (8, 256)
    photons, speckle = np.full(shape, 0.02**2), np.linspace(0.02, 0.08, 256) ** 2 * np.ones(shape)
    u = 30.0 + rng.normal(size=shape) * np.sqrt(photons + scatter**2 * speckle)
    flat = np.ones(shape)
    yes = np.ones(shape, bool)
    return Rows(u, np.sqrt(photons + speckle), 100 * flat, 1.3 * flat, 5 * flat, yes, yes), photons


@pytest.mark.parametrize("scatter", [0.5, 1.0, 2.0])
def test_a_contrast_is_corrected_by_the_scatter(scatter):
    rows, photons = _stated(scatter)
    contrast = correct_speckle(rows, photons, 0.2)
    # Second differences over 2000 rows: some per cent of a contrast.
    assert contrast == pytest.approx(0.2 * scatter, rel=0.15)
    assert scatter_law(ProfileRows(rows.u, rows.sigma, rows.valid, rows.amplitude)).correlation == INDEPENDENT


def test_no_scatter_at_all_lowers_a_contrast_as_far_as_can_be():
    rows, photons = _stated(0.0)
    still = rows._replace(u=30.0 + 0.5 * (rows.u - 30.0))
    for seen in (rows, still):
        assert 0.06 - 1e-12 <= correct_speckle(seen, photons, 0.2) < 0.08
        assert scatter_law(ProfileRows(seen.u, seen.sigma, seen.valid, seen.amplitude)).correlation == INDEPENDENT


def test_too_few_rows_correct_nothing():
    rows, photons = _stated(0.0)
    assert correct_speckle(rows._replace(usable=rows.usable & False), photons, 0.2) == 0.2


def test_the_reasons_where_nothing_is_learned():
    def reason(on, off, settings=None):
        setup = ExtractionSetup((COLUMNS, ROWS), FrameFormat(), LaserLine(), settings or StripeSettings())
        (engine,) = prepare_engines(on, off, [setup], noise=KNOWN)
        return engine.learn(on, off).speckle_reason

    on, off, _ = _scene(0.0)
    assert reason(on, off) == "lost in the other noise"
    assert reason(off, off) == "too few stripes"
    assert reason(*_scene(0.0, rough=0.5)[:2]) == "the surface scatters the centres more than the widths"
    assert reason(on, off, StripeSettings(speckle=0.0)) == "set to 0"
    plain = StripeSettings(estimator="centre_of_gravity")
    assert reason(on, off, plain) == "the estimator does not tell it"


@pytest.mark.more
def test_only_the_first_frames_are_learned_from():
    on, off, _ = _scene(0.5)
    setup = ExtractionSetup((COLUMNS, ROWS), FrameFormat(), LaserLine(), StripeSettings())
    (engine,) = prepare_engines(on, off, [setup], noise=KNOWN)
    more = [np.concatenate([frames, frames[::-1]]) for frames in (on, off)]
    assert engine.learn(*more).noise == engine.learn(on, off).noise
