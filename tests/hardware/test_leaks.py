"""A laser that is slow to go out, distinguished from wallpaper with stripes."""

import numpy as np
from scanrig.checks.compare import PLACES, LeakWatch


def test_a_slow_laser_is_found_at_the_eighth_place():
    watch = LeakWatch()
    found = [watch.add(2.0 * k, 0.2) for k in range(PLACES)]
    assert found == [None] * (PLACES - 1) + [0.2]


def test_stripes_of_wallpaper_are_no_leak():
    watch, rng = LeakWatch(), np.random.default_rng(1)
    # A stripe along the line at every third place, as bright as a quarter of the laser.
    leaks = [0.25 if k % 3 == 0 else float(rng.normal(0.0, 0.03)) for k in range(180)]
    found = [watch.add(2.0 * k, leak) for k, leak in enumerate(leaks)]
    assert max(value for value in found if value is not None) < 0.1


def test_small_steps_see_the_same_texture():
    watch = LeakWatch()
    # 0.1 degrees: a stripe of 1.5 degrees is met fifteen times, and counts once.
    found = [watch.add(0.1 * k, 0.3 if k < 15 else 0.0) for k in range(200)]
    values = [value for value in found if value is not None]
    assert len(values) == 3 and max(values) == 0.0


def test_boards_count_each():
    watch = LeakWatch()
    assert [watch.add(None, 0.15) for _ in range(PLACES)][-1] == 0.15
