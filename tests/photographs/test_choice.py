"""Which photographs are looked at: by place, so many as every lens needs."""

import dataclasses

import numpy as np

from jaxscan.photographs import choose_evenly, enough_photographs


def test_few_are_all_looked_at():
    np.testing.assert_array_equal(choose_evenly(np.arange(5.0), 5), np.arange(5))


def test_every_step_of_a_fine_turn_is_looked_at_once():
    """3600 steps of 0.1 degrees: 180 photographs, 2 degrees apart."""
    angles = 2 * np.pi * np.arange(3600) / 3600
    chosen = choose_evenly(angles, 180, period=2 * np.pi)
    np.testing.assert_array_equal(chosen, np.arange(0, 3600, 20))


def test_a_part_that_was_swept_slowly_has_no_more_of_them():
    slow, fast = np.linspace(0, 0.5, 900, endpoint=False), np.linspace(0.5, 2 * np.pi, 300)
    angles = np.concatenate([slow, fast])
    chosen = choose_evenly(angles, 100, period=2 * np.pi)
    assert len(chosen) == 100
    # A part of the way each, so neighbours are less than two parts apart.
    assert np.diff(angles[chosen]).max() < 2 * 2 * np.pi / 100


def test_a_second_turn_is_the_first_one_again():
    angles = 2 * np.pi * np.arange(800) / 400
    chosen = choose_evenly(angles, 100, period=2 * np.pi)
    np.testing.assert_array_equal(chosen, np.arange(0, 400, 4))


def test_a_part_of_a_turn_has_as_many_as_a_turn():
    angles = np.radians(200 + 60 * np.arange(600) / 599)
    chosen = choose_evenly(angles, 60, period=2 * np.pi)
    assert len(chosen) == 60 and np.diff(angles[chosen]).max() < np.radians(2.1)


def test_a_narrow_lens_has_more_of_them(world):
    assert [enough_photographs(world.scanner, use) for use in ("points", "pictures")] == [60, 180]
    camera = dataclasses.replace(world.scanner.camera, fx=np.array(3000.0), fy=np.array(3000.0))
    # 240 px of 3000 px are 4.6 degrees, of which there are 79 in a turn.
    narrow = dataclasses.replace(world.scanner, camera=camera)
    assert 8 * 78 < enough_photographs(narrow, "points") < 8 * 80
    assert 16 * 78 < enough_photographs(narrow, "pictures") < 16 * 80
