"""Several exposures of one record: what one of them cannot see, another does."""

import numpy as np
import pytest

from jaxscan.reconstruction import ReconstructSettings, Sweep, reconstruct
from jaxscan.reconstruction.reconstruct import extract_sweep
from jaxscan.stripes.stripes import NoiseModel

from .rendered import ELECTRONS_PER_DN, READ_DN, expose, stripe


WIDTH, HEIGHT, RECORDS = 192, 96, 6
NORMAL = np.array([0.9, 0.4, 0.17]) / np.linalg.norm([0.9, 0.4, 0.17])
DISTANCE = 1.5
EXPOSURES = (0.01, 0.04)
NOISE = NoiseModel(READ_DN, ELECTRONS_PER_DN)
# In the short exposure [DN]: the long one shows 600, which is clipped, and 8.8; 2.2 drown in noise.
BRIGHT, FAINT = 150.0, 2.2
AMPLITUDE = np.where(np.arange(HEIGHT) < HEIGHT // 2, BRIGHT, FAINT)


@pytest.fixture(scope="module")
def scanner():
    from .conftest import small_scanner

    return small_scanner(width=WIDTH, height=HEIGHT)


@pytest.fixture(scope="module")
def sweep(scanner):
    from .conftest import stripes_on_plane

    phi = np.radians(np.arange(RECORDS))
    u, seen = stripes_on_plane(scanner, phi, NORMAL, DISTANCE)
    assert seen.all()
    light = stripe(u, seen, AMPLITUDE, WIDTH)
    longer = np.array(EXPOSURES)[:, None, None] / EXPOSURES[0]
    on = expose(longer * (light[:, None] + 5.0), 1)
    off = expose(np.broadcast_to(longer * 5.0, on.shape), 2)
    return Sweep(on, off, phi, exposures=EXPOSURES)


def alone(sweep, which):
    return Sweep(sweep.on[:, which], sweep.off[:, which], sweep.angle)


def test_bright_and_faint_parts_both_give_points(sweep, scanner):
    cloud = reconstruct(sweep, scanner, noise=NOISE)
    assert cloud.valid.mean() > 0.99
    error = (cloud.xyz @ NORMAL - DISTANCE)[cloud.valid]
    # Chance alone exceeds five standard deviations once in two million.
    assert np.all(np.abs(error) < 5 * cloud.sigma_random[cloud.valid])
    # Grey and intensity are in levels of the first exposure, whichever gave the point.
    bright = np.arange(HEIGHT) < HEIGHT // 2
    assert np.median(cloud.intensity[:, bright]) == pytest.approx(BRIGHT, rel=0.02)
    assert np.median(cloud.intensity[:, ~bright]) == pytest.approx(FAINT, rel=0.1)
    assert np.median(cloud.rgb[cloud.valid]) == 5


def test_each_exposure_alone_misses_what_the_other_has(sweep, scanner):
    bright = np.arange(HEIGHT) < HEIGHT // 2
    both, short, long = (extract_sweep(one, scanner, noise=NOISE) for one in (sweep, alone(sweep, 0), alone(sweep, 1)))
    assert short.valid[:, ~bright].mean() < 0.2 and both.valid[:, ~bright].mean() > 0.99
    assert (long.saturated[:, bright] > 0).all() and not short.saturated.any()
    # Of every line the exposure that knows its centre best; two compiled functions round otherwise.
    best = np.minimum(*(np.where(one.valid, one.sigma, np.inf) for one in (short, long)))
    np.testing.assert_allclose(both.sigma, np.where(both.valid, best, 0.0), rtol=1e-4)
    taken = np.isclose(both.sigma, short.sigma, rtol=1e-4)
    assert taken[:, bright].any() and not taken[:, ~bright].all()


def test_candidates_of_the_better_exposure_are_compared_over_the_steps(sweep, scanner):
    """Nothing is wrong with this sweep, so nothing changes."""
    plain = extract_sweep(sweep, scanner, noise=NOISE)
    checked = extract_sweep(sweep, scanner, settings=ReconstructSettings(check_steps=True), noise=NOISE)
    np.testing.assert_array_equal(checked.valid, plain.valid)
    for name in ("u", "sigma", "amplitude"):
        # Two compiled functions may round otherwise: a few units in the last place of float32.
        np.testing.assert_allclose(getattr(checked, name), getattr(plain, name), rtol=1e-5, err_msg=name)
    np.testing.assert_array_equal(checked.rgb, plain.rgb)
