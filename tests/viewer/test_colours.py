"""Colours of the viewer."""

import dataclasses

import numpy as np

from jaxscan.viewer.colours import UNKNOWN, Scale, brightened, coloured_normals
from jaxscan.viewer.shown import ShownCloud, middle_of


def test_ends_and_outside():
    scale = Scale(1.0, 3.0, "m")
    first, last = scale.coloured(np.array([1.0, 3.0]))
    np.testing.assert_array_equal(scale.coloured(np.array([-9.0, 99.0])), [first, last])
    assert first.tolist() == [68, 1, 84] and last.tolist() == [253, 231, 37]
    assert scale.words() == "1 … 3 m"
    # Brighter where there is more, for those who see no colours.
    grey = scale.coloured(np.linspace(1, 3, 100)) @ [0.299, 0.587, 0.114]
    assert (np.diff(grey) > -1e-9).mean() > 0.95


def test_a_plane_is_white_and_its_sides_are_not():
    scale = Scale(-5.0, 5.0, "mm", diverging=True)
    white, blue, red = scale.coloured(np.array([0.0, -9.0, 9.0])).astype(int)
    assert white.min() > 235 and blue[2] > blue[0] + 80 and red[0] > red[2] + 80


def test_numbers_that_are_none_have_a_colour():
    assert Scale(0.0, 0.0, "m").coloured(np.array([np.nan, 0.0, np.inf])).shape == (3, 3)


def test_dark_pictures_are_brightened_and_bright_ones_left():
    dark = np.full((100, 3), 40, np.uint8)
    assert 220 < brightened(dark)[0, 0] < 250
    bright = np.full((100, 3), 250, np.uint8)
    np.testing.assert_array_equal(brightened(bright), bright)
    assert brightened(np.zeros((10, 3), np.uint8)).max() == 0


def test_normals():
    colours = coloured_normals(np.array([[1.0, 0, 0], [-1, 0, 0], [0, 0, 0]]))
    assert colours.tolist() == [[255, 127, 127], [0, 127, 127], [127, 127, 127]]


def test_a_cloud_without_colours_is_grey_not_black(room):
    cloud = dataclasses.replace(room.cloud, rgb=np.zeros_like(room.cloud.rgb))
    shown = ShownCloud("", cloud, middle_of(cloud))
    grey, scale = shown.coloured("photograph", plane=None)
    assert not shown.has("photograph") and scale is None
    assert grey.min() >= 60 and len(np.unique(grey)) > 20 and np.ptp(grey, axis=1).max() == 0
    plain = dataclasses.replace(cloud, intensity=np.zeros_like(cloud.intensity))
    assert np.all(ShownCloud("", plain, middle_of(cloud)).coloured("photograph", plane=None)[0] == UNKNOWN)
