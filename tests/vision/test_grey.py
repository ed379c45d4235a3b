"""Grey pictures: no pixel moves, whatever the format."""

import numpy as np
import pytest

from jaxscan.vision import to_grey


def ramp(rows=16, columns=24):
    v, u = np.mgrid[:rows, :columns]
    return (3 * u + 5 * v).astype(np.uint8)


def test_mono_is_itself():
    frame = ramp()
    assert to_grey(frame, "mono8") is frame


def test_a_grey_rgb_frame():
    np.testing.assert_allclose(to_grey(np.repeat(ramp()[..., None], 3, 2), "rgb8"), ramp(), atol=1)


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "grbg", "gbrg"])
def test_a_grey_mosaic_keeps_its_place(pattern):
    # A linear ramp is what bilinear interpolation reproduces, so any shift would show as 3 or
    # 5 levels a pixel; rounding is 1. The border is extrapolated and left out.
    grey = to_grey(ramp(), f"bayer_{pattern}8").astype(int)
    np.testing.assert_allclose(grey[2:-2, 2:-2], ramp().astype(int)[2:-2, 2:-2], atol=1)


def test_red_weighs_what_red_weighs():
    # A red scene on an RGGB mosaic: only red sites are lit; Rec. 601 gives red 0.299.
    frame = np.zeros((16, 16), np.uint8)
    frame[0::2, 0::2] = 200
    np.testing.assert_allclose(to_grey(frame, "bayer_rggb8")[4:-4, 4:-4], 0.299 * 200, atol=1.5)


def test_unknown_format_is_named():
    with pytest.raises(ValueError, match="mono12"):
        to_grey(ramp(), "mono12")
