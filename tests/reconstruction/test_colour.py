"""Bilinear colour in every pixel format, against functions it must reproduce exactly."""

import numpy as np
import pytest

from jaxscan.reconstruction.colours import sample_colours


ROWS, COLUMNS = 12, 16
POINTS = np.array([[5.0, 4.0], [5.25, 4.0], [6.5, 7.75], [2.0, 9.5]], np.float32)


def ramp(a, b, c):
    v, u = np.mgrid[:ROWS, :COLUMNS]
    return (a + b * u + c * v).astype(np.uint8)


def sampled(frame, pixel_format):
    return sample_colours(frame[None], np.zeros(len(POINTS), int), POINTS, pixel_format)


PLANES = {"r": (10, 8, 4), "g": (40, 4, 8), "b": (90, 4, 4)}
EXPECTED = np.stack([a + b * POINTS[:, 0] + c * POINTS[:, 1] for a, b, c in PLANES.values()], -1)


def test_mono_is_grey():
    grey = sampled(ramp(*PLANES["r"]), "mono8")
    # Linear in u and v, so bilinear is exact but for rounding to whole DN.
    np.testing.assert_allclose(grey, EXPECTED[:, :1] * np.ones(3), atol=0.5)


def test_rgb():
    frame = np.stack([ramp(*plane) for plane in PLANES.values()], -1)
    np.testing.assert_allclose(sampled(frame, "rgb8"), EXPECTED, atol=0.5)


@pytest.mark.parametrize("order", ["rggb", "bggr", "grbg", "gbrg"])
def test_bayer_mixes_no_colours(order):
    frame = np.zeros((ROWS, COLUMNS), np.uint8)
    for site, letter in enumerate(order):
        frame[site // 2 :: 2, site % 2 :: 2] = ramp(*PLANES[letter])[site // 2 :: 2, site % 2 :: 2]
    # Every plane is linear, so interpolation among its own sites alone gives it back.
    np.testing.assert_allclose(sampled(frame, f"bayer_{order}8"), EXPECTED, atol=0.5)


def test_edges_are_held():
    frame = ramp(10, 8, 4)
    outside = np.array([[-3.0, -1.0], [COLUMNS + 3.0, ROWS + 1.0]], np.float32)
    found = sample_colours(frame[None], np.zeros(2, int), outside, "mono8")
    assert found[:, 0].tolist() == [frame[0, 0], frame[-1, -1]]
