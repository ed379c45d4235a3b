"""Two lasers lit in one record are told apart by where the range limits let them be seen."""

import numpy as np
import pytest

from jaxscan.errors import CaptureError
from jaxscan.reconstruction import ReconstructSettings, Sweep, reconstruct
from jaxscan.stripes import LaserLine

from .conftest import small_scanner, stripes_on_plane
from .rendered import pairs, stripe


pytestmark = pytest.mark.more


WIDTH, HEIGHT, RECORDS = 192, 96, 6
NORMAL = np.array([0.9, 0.4, 0.17]) / np.linalg.norm([0.9, 0.4, 0.17])
DISTANCE = 1.5
LINES = (LaserLine("left"), LaserLine("right"))
SETTINGS = ReconstructSettings(min_range_m=1.0, max_range_m=4.0)


@pytest.fixture(scope="module")
def scanner(request):
    return small_scanner(lasers=2, width=WIDTH, height=HEIGHT)


@pytest.fixture(scope="module")
def sweep(scanner):
    """A plane in the light of two sheets at once, with a true stripe of each in every line."""
    phi = np.radians(np.arange(RECORDS))
    light = 0.0
    for laser in (0, 1):
        u, seen = stripes_on_plane(scanner, phi, NORMAL, DISTANCE, laser)
        assert seen.all()
        # The second one is by far the brighter, so that no rule of brightness could find the first.
        light = light + stripe(u, seen, (50.0, 150.0)[laser], WIDTH)
    on, off = pairs(light)
    record, laser = np.divmod(np.arange(2 * RECORDS, dtype=np.int32), 2)
    return Sweep(on, off, phi, lasers=LINES, record=record, laser=laser)


def test_each_sheet_gives_its_own_points(sweep, scanner):
    cloud = reconstruct(sweep, scanner, settings=SETTINGS)
    np.testing.assert_array_equal(cloud.record, np.repeat(np.arange(RECORDS), 2))
    np.testing.assert_array_equal(cloud.laser, np.tile([0, 1], RECORDS))
    np.testing.assert_allclose(cloud.angle, np.repeat(sweep.angles, 2))
    for laser in (0, 1):
        own = cloud.laser == laser
        valid = cloud.valid[own]
        assert valid.mean() > 0.99
        error = (cloud.xyz[own] @ NORMAL - DISTANCE)[valid]
        # The sigma is along the ray, so across the plane the error is smaller; chance alone
        # exceeds five of them once in two million.
        assert np.all(np.abs(error) < 5 * cloud.sigma_random[own][valid])


def test_the_brighter_sheet_is_not_taken_for_the_other(sweep, scanner):
    """Without range limits that keep them apart the sweep is refused, not guessed at."""
    with pytest.raises(CaptureError, match=r"Two lasers .* same places .*narrow min_range_m and max_range_m"):
        reconstruct(sweep, scanner, settings=ReconstructSettings())


def test_one_after_the_other_needs_no_limits(sweep, scanner):
    """The same lasers in records of their own: neither range limits nor gates are needed."""
    number = np.arange(RECORDS) % 2
    light = 0.0
    for laser in (0, 1):
        u, seen = stripes_on_plane(scanner, np.asarray(sweep.angles), NORMAL, DISTANCE, laser)
        light = light + stripe(u, seen & (number == laser)[:, None], 80.0, WIDTH)
    on, off = pairs(light)
    cloud = reconstruct(Sweep(on, off, sweep.angles, lasers=LINES, laser=number), scanner)
    np.testing.assert_array_equal(cloud.laser, number)
    assert cloud.valid.mean() > 0.99
    error = (cloud.xyz @ NORMAL - DISTANCE)[cloud.valid]
    assert np.all(np.abs(error) < 5 * cloud.sigma_random[cloud.valid])
