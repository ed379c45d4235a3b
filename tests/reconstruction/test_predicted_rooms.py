"""Laser-off frames that other steps predict, where both of two steps see a place and where one does."""

import numpy as np
import pytest

from jaxscan.reconstruction.without_off import Lattice, moved
from jaxscan.stripes import Channels, LaserLine, laser_sites


LINES, SAMPLES, PEAK, STRIPE = 48, 128, 60, 60
BARS = slice(64, 124)


def _step(shift, stripe, *, peak=PEAK):
    """A wall with bars that repeat themselves, seen after a motion to higher samples, under a stripe."""
    at = np.arange(SAMPLES) - shift
    wall = np.where((at >= BARS.start) & (at < BARS.stop) & (at // 4 % 2 == 0), 30, 140 - at // 4)
    level = np.broadcast_to(wall, (LINES, SAMPLES)).copy()
    level[:, stripe - 1 : stripe + 2] += peak
    return Channels(level[None].astype(np.uint8), ())


def _places(shift):
    """Where another step shows what this one does, one distance for all."""
    lattice = Lattice.of((LINES, SAMPLES), laser_sites("mono8", LaserLine()))
    sample, line = np.meshgrid(lattice.u, lattice.line)
    return np.stack([line, sample + shift], -1)[None].astype(np.float32)


@pytest.mark.parametrize("shifts", [(-28, 28), (-28, -56), (28, 56)])
def test_the_room_is_predicted_without_any_stripe(shifts):
    """At the end of a sweep two steps on one side tell; what has left the image in one of them is in the other."""
    own, others = _step(0, STRIPE), tuple(_step(shift, STRIPE) for shift in shifts)
    found = moved(own, others, tuple(_places(shift) for shift in shifts)).laser[0]
    bare, at = _step(0, STRIPE, peak=0).laser[0], np.arange(SAMPLES)
    seen = np.stack([(at + shift >= 0) & (at + shift < SAMPLES) for shift in shifts])
    both, one = seen.all(0), seen.any(0) & ~seen.all(0)
    np.testing.assert_array_equal(found[:, both], bare[:, both])
    # Nothing tells the stripe of the only step that sees a place; the room around it is as it was.
    lit = np.zeros(SAMPLES, bool)
    for shift in shifts:
        lit[np.abs(at + shift - STRIPE) <= 1] = True
    np.testing.assert_array_equal(found[:, one & ~lit], bare[:, one & ~lit])


def test_an_edge_that_two_steps_show_beside_its_place_leaves_no_line():
    """A wrong distance leaves half a sample on either side; the darker of both would give a line at each edge."""
    own, others = _step(0, STRIPE), (_step(-28, STRIPE), _step(28, STRIPE))
    found = moved(own, others, (_places(-27.5), _places(27.5))).laser[0]
    bare = _step(0, STRIPE, peak=0).laser[0]
    inner = slice(62, 85)
    np.testing.assert_array_equal(found[:, inner], bare[:, inner])
