"""A reflection that takes over in single steps of the table gives way to what its neighbours know."""

import numpy as np
import pytest

from jaxscan.reconstruction import ReconstructSettings, Sweep, extract, reconstruct
from jaxscan.stripes import LaserLine, NoiseModel, StripeSettings

from .conftest import small_scanner, stripes_on_plane
from .rendered import ELECTRONS_PER_DN, READ_DN, pairs, stripe


pytestmark = pytest.mark.more


WIDTH, HEIGHT, RECORDS = 192, 96, 24
NORMAL = np.array([0.9, 0.4, 0.17]) / np.linalg.norm([0.9, 0.4, 0.17])
DISTANCE = 1.5
BRIGHTER, HIDING = (5, 10, 15), 20
"""Steps in which a reflection outshines the stripe, and one in which it is all that is seen."""
NOISE = NoiseModel(READ_DN, ELECTRONS_PER_DN)
CHECKED = ReconstructSettings(check_steps=True, chunk_records=16)
"""One size of chunk for all tests: few compilations."""


@pytest.fixture(scope="module")
def scanner():
    return small_scanner(lasers=2, width=WIDTH, height=HEIGHT)


def lit(scanner, phi, laser=0):
    """Light of a sweep, with reflections: somewhere else in each step, as smooth as a surface."""
    u, seen = stripes_on_plane(scanner, phi, NORMAL, DISTANCE, laser)
    assert seen.all()
    step = np.arange(len(phi))
    # The sheets are seen near 128 and 57 px.
    ghost = ((25.0, 95.0)[laser] + 37.0 * step % 60.0)[:, None] + 0.1 * np.arange(HEIGHT)
    there = np.isin(step, (*BRIGHTER, HIDING))[:, None] & seen
    return stripe(u, seen & (step != HIDING)[:, None], 60.0, WIDTH) + stripe(ghost, there, 180.0, WIDTH)


@pytest.fixture(scope="module")
def sweep(scanner):
    phi = np.radians(np.arange(RECORDS))
    on, off = pairs(lit(scanner, phi))
    return Sweep(on, off, phi, lasers=(LaserLine("left"),))


def wrong(cloud):
    """Share of the points of each profile that are off the plane by more than six sigmas."""
    away = np.abs(cloud.xyz @ NORMAL - DISTANCE) > 6 * cloud.sigma_random
    return (away & cloud.valid).mean(1)


@pytest.mark.more
def test_reflections_in_single_steps_are_put_right(sweep, scanner):
    plain = reconstruct(sweep, scanner, noise=NOISE)
    checked = reconstruct(sweep, scanner, settings=CHECKED, noise=NOISE)
    steps = np.arange(RECORDS)
    struck = np.isin(steps, (*BRIGHTER, HIDING))
    assert wrong(plain)[struck].min() > 0.95, "the reflections are as bad as they were meant"
    assert wrong(checked).max() == 0.0
    assert checked.valid[steps != HIDING].mean() > 0.99
    # What hides the stripe itself is dropped: there is nothing to put in its place.
    assert checked.valid[HIDING].mean() < 0.02
    # What was right stays, with its colour.
    np.testing.assert_array_equal(checked.valid[~struck], plain.valid[~struck])
    np.testing.assert_array_equal(checked.rgb[~struck], plain.rgb[~struck])
    assert checked.xyz.shape == plain.xyz.shape


def test_the_steps_of_each_laser_are_its_own(scanner):
    """Records that alternate between two lasers, against the sense of the angle."""
    phi = np.radians(np.arange(RECORDS))
    light = np.stack([lit(scanner, phi, laser) for laser in (0, 1)], 1).reshape(2 * RECORDS, HEIGHT, WIDTH)
    on, off = pairs(light[::-1])
    number = np.tile([1, 0], RECORDS)
    both = Sweep(on, off, np.repeat(phi, 2)[::-1], lasers=(LaserLine("left"), LaserLine("right")), laser=number)
    cloud = reconstruct(both, scanner, settings=CHECKED, noise=NOISE)
    np.testing.assert_array_equal(cloud.laser, number)
    assert wrong(cloud).max() == 0.0
    struck = np.isin(np.arange(2 * RECORDS)[::-1] // 2, HIDING)
    assert cloud.valid[~struck].mean() > 0.99 and cloud.valid[struck].mean() < 0.02


@pytest.mark.more
def test_bayer_lines_that_hold_no_site_hold_no_stripe(scanner, sweep):
    """On a mosaic the choice, like the stripes, lives on the lines of the laser's colour."""
    mosaic = Sweep(sweep.on, sweep.off, sweep.angles, pixel_format="bayer_rggb8", lasers=sweep.lasers)
    checked = extract(mosaic, scanner, settings=CHECKED, noise=NOISE).stripes
    assert not checked.valid[:, 1::2].any() and checked.valid[:HIDING, ::2].mean() > 0.95


def test_all_candidates_cannot_be_checked():
    with pytest.raises(ValueError, match="there are none"):
        ReconstructSettings(stripes=StripeSettings(choice="all"), check_steps=True)
