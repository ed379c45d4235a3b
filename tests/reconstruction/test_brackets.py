"""Several exposures of one record: what one of them cannot see, another does."""

import numpy as np
import pytest

from jaxscan.reconstruction import ReconstructSettings, Sweep, extract, reconstruct
from jaxscan.stripes import NoiseModel

from .conftest import small_scanner, stripes_on_plane
from .rendered import ELECTRONS_PER_DN, READ_DN, expose, stripe


pytestmark = pytest.mark.more


WIDTH, HEIGHT, RECORDS = 192, 96, 6
NORMAL = np.array([0.9, 0.4, 0.17]) / np.linalg.norm([0.9, 0.4, 0.17])
DISTANCE = 1.5
EXPOSURES = (0.01, 0.04)
NOISE = NoiseModel(READ_DN, ELECTRONS_PER_DN)
BRIGHT = np.arange(HEIGHT) < HEIGHT // 2
# In the short exposure [DN]. A sunlit wall, of which the long one clips stripe and surroundings, and
# a dark one, on which the long one sees 8.8 and the short one noise.
AMPLITUDE, AMBIENT = np.where(BRIGHT, 150.0, 2.2), np.where(BRIGHT, 70.0, 5.0)


@pytest.fixture(scope="module")
def scanner():
    return small_scanner(width=WIDTH, height=HEIGHT)


@pytest.fixture(scope="module")
def sweep(scanner):
    phi = np.radians(np.arange(RECORDS))
    u, seen = stripes_on_plane(scanner, phi, NORMAL, DISTANCE)
    assert seen.all()
    light = stripe(u, seen, AMPLITUDE, WIDTH)
    longer = np.array(EXPOSURES)[:, None, None] / EXPOSURES[0]
    on = expose(longer * (light[:, None] + AMBIENT[:, None]), 1)
    off = expose(np.broadcast_to(longer * AMBIENT[:, None], on.shape), 2)
    return Sweep(on, off, phi, exposures=EXPOSURES)


def alone(sweep, which):
    return Sweep(sweep.on[:, which], sweep.off[:, which], sweep.angles)


@pytest.fixture(scope="module")
def stripes(sweep, scanner):
    return extract(sweep, scanner, noise=NOISE).stripes


@pytest.mark.more
def test_bright_and_faint_parts_both_give_points(sweep, scanner):
    cloud = reconstruct(sweep, scanner, noise=NOISE)
    assert cloud.valid.mean() > 0.99
    error = (cloud.xyz @ NORMAL - DISTANCE)[cloud.valid]
    # Chance alone exceeds five standard deviations once in two million.
    assert np.all(np.abs(error) < 5 * cloud.sigma_random[cloud.valid])
    # Grey and intensity are in levels of the first exposure, whichever gave the point.
    for half in (BRIGHT, ~BRIGHT):
        assert np.median(cloud.intensity[:, half]) == pytest.approx(AMPLITUDE[half][0], rel=0.1)
        assert np.median(cloud.rgb[:, half]) == AMBIENT[half][0]


def test_each_exposure_alone_misses_what_the_other_has(sweep, scanner, stripes):
    short, long = (extract(alone(sweep, which), scanner, noise=NOISE).stripes for which in (0, 1))
    assert stripes.valid.mean() > 0.99
    # Several lines together show the short exposure a few of the dark ones.
    assert short.valid[:, BRIGHT].mean() > 0.99 and short.valid[:, ~BRIGHT].mean() < 0.3
    assert long.valid[:, ~BRIGHT].mean() > 0.99 and long.valid[:, BRIGHT].mean() < 0.2


def test_candidates_of_the_better_exposure_are_compared_over_the_steps(sweep, scanner, stripes):
    """Nothing is wrong with this sweep, so nothing changes."""
    plain = stripes
    checked = extract(sweep, scanner, settings=ReconstructSettings(check_steps=True), noise=NOISE).stripes
    np.testing.assert_array_equal(checked.valid, plain.valid)
    for name in ("u", "sigma", "amplitude"):
        # Two compiled functions may round otherwise: a few units in the last place of float32.
        np.testing.assert_allclose(getattr(checked, name), getattr(plain, name), rtol=1e-5, err_msg=name)
    np.testing.assert_array_equal(checked.rgb, plain.rgb)
