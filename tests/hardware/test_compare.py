"""Whether a pair that was taken again is the same: the line's shift, and what else differs."""

import numpy as np
import pytest
from scanrig.cameras.synthetic import SyntheticScene, draw
from scanrig.compare import compare_pairs

from jaxscan.stripes.frames import LaserLine


RNG = np.random.default_rng(4)


def pair(scene, position=1000.0, *, pixel_format="mono8", roll=0):
    def one(lit):
        image = draw(scene, position, lit, width=256, height=192, pixel_format=pixel_format, generator=RNG)
        return np.roll(image, roll, 0 if scene.stripe_axis == "columns" else 1)

    return one(True), one(False)


def compare(first, again, *, pixel_format="mono8", line=None):
    return compare_pairs(first, again, pixel_format=pixel_format, response="linear", line=line or LaserLine())


def test_the_same_view_twice_differs_by_noise():
    scene = SyntheticScene()
    found = compare(pair(scene), pair(scene))
    # Two frames of sqrt(1 + 30 / 40) DN each: sqrt(2) times that, times sqrt(2 / pi) for the mean.
    assert found.difference_dn == pytest.approx(np.sqrt(2 * (1 + 30 / 40) * 2 / np.pi), rel=0.1)
    assert abs(found.shift_px) < 0.05 and found.lines > 150 and found.within(0.1, 2.0)


@pytest.mark.parametrize("roll", [-7, -1, 1, 3])
@pytest.mark.parametrize(("axis", "pixel_format"), [("rows", "mono8"), ("columns", "mono8"), ("rows", "rgb8")])
def test_a_shift_is_measured(roll, axis, pixel_format):
    scene = SyntheticScene(stripe_axis=axis)
    line = LaserLine(stripe_axis=axis)
    first, again = pair(scene, pixel_format=pixel_format), pair(scene, pixel_format=pixel_format, roll=roll)
    found = compare(first, again, pixel_format=pixel_format, line=line)
    assert found.shift_px == pytest.approx(roll, abs=0.1)
    assert not found.within(0.5, 255.0)


def test_a_bayer_pattern_is_measured_in_pixels_of_the_image():
    scene = SyntheticScene(width_px=3.0)
    first, again = pair(scene, pixel_format="bayer_rggb8"), pair(scene, pixel_format="bayer_rggb8", roll=4)
    found = compare(first, again, pixel_format="bayer_rggb8")
    assert found.shift_px == pytest.approx(4, abs=0.3)


def test_light_that_comes_and_goes_is_no_difference_of_view():
    found = compare(pair(SyntheticScene(ambient_dn=60.0)), pair(SyntheticScene(ambient_dn=20.0)))
    assert found.within(0.2, 3.0)


def test_another_view_is():
    found = compare(pair(SyntheticScene()), pair(SyntheticScene(), 1400.0))
    assert not found.within(1.0, 6.0)


def test_without_a_line_nothing_is_known():
    found = compare(pair(SyntheticScene(peak_dn=0.0)), pair(SyntheticScene(peak_dn=0.0)))
    assert found.shift_px is None and not found.within(100.0, 255.0)
    assert "the line is not on the same rows" in str(found)
