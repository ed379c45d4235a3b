"""Pairs of frames that are not what they should be are told."""

import numpy as np
import pytest

from jaxscan.stripes import LaserLine, extract_stripes
from jaxscan.stripes.pairs import judge_pairs


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
