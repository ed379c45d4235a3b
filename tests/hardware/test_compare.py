"""Whether a pair that was taken again is the same: the stripe's shift, and other differences."""

from dataclasses import replace

import numpy as np
import pytest
from scanrig.cameras.simulated import FrameShape, SyntheticScene, draw
from scanrig.checks.compare import PLACES, LeakWatch, compare_pairs
from scanrig.config import ChecksTable

from jaxscan.stripes import LaserLine


LEAST = ChecksTable().correlation
RNG = np.random.default_rng(4)


def pair(scene, position=1000.0, *, pixel_format="mono8", roll=0):
    def one(lit):
        image = draw(scene, position, lit, FrameShape(256, 192, pixel_format), RNG)
        return np.roll(image, roll, 0 if scene.stripe_axis == "columns" else 1)

    return one(True), one(False)


def compare(first, again, *, pixel_format="mono8", line=None):
    return compare_pairs(first, again, pixel_format=pixel_format, response="linear", line=line or LaserLine())


def test_the_same_view_twice_differs_by_noise():
    scene = SyntheticScene()
    found = compare(pair(scene), pair(scene))
    assert found.correlation == pytest.approx(1.0, abs=0.01)
    assert abs(found.shift_px) < 0.05 and found.lines > 150 and found.within(0.1, 0.98)


@pytest.mark.parametrize("roll", [-7, -1, 1, 3])
@pytest.mark.parametrize(("axis", "pixel_format"), [("rows", "mono8"), ("columns", "mono8"), ("rows", "rgb8")])
def test_a_shift_is_measured(roll, axis, pixel_format):
    scene = SyntheticScene(stripe_axis=axis)
    line = LaserLine(stripe_axis=axis)
    first, again = pair(scene, pixel_format=pixel_format), pair(scene, pixel_format=pixel_format, roll=roll)
    found = compare(first, again, pixel_format=pixel_format, line=line)
    assert found.shift_px == pytest.approx(roll, abs=0.1)
    assert not found.within(0.5, -1.0)


def test_a_bayer_pattern_is_measured_in_pixels_of_the_image():
    scene = SyntheticScene(width_px=3.0)
    first, again = pair(scene, pixel_format="bayer_rggb8"), pair(scene, pixel_format="bayer_rggb8", roll=4)
    found = compare(first, again, pixel_format="bayer_rggb8")
    assert found.shift_px == pytest.approx(4, abs=0.3)


def test_light_that_comes_and_goes_is_no_difference_of_view():
    found = compare(pair(SyntheticScene(ambient_dn=60.0)), pair(SyntheticScene(ambient_dn=20.0)))
    assert found.within(0.2, 0.98)


def test_another_view_is():
    found = compare(pair(SyntheticScene()), pair(SyntheticScene(), 1400.0))
    assert not found.within(1.0, LEAST)


@pytest.mark.parametrize("pixel_format", ["mono8", "bayer_rggb8", "rgb8"])
@pytest.mark.parametrize("degrees", [1.0, 5.0, 15.0, -90.0])
def test_a_table_that_stands_elsewhere_is_seen_by_the_room_alone(degrees, pixel_format):
    """The line may lie where it lay, by chance: the scene's is the same at places all around."""
    for position in range(0, 28800, 7200):
        scene = SyntheticScene()
        brighter = replace(scene, ambient_dn=1.2 * scene.ambient_dn)
        first = pair(scene, position, pixel_format=pixel_format)
        same = compare(first, pair(brighter, position, pixel_format=pixel_format), pixel_format=pixel_format)
        other = pair(brighter, position + 80 * degrees, pixel_format=pixel_format)
        elsewhere = compare(first, other, pixel_format=pixel_format)
        assert same.correlation > 0.95 and same.within(0.2, LEAST)
        assert elsewhere.correlation < 0.65 and not elsewhere.within(1000.0, LEAST)


@pytest.mark.parametrize("ambient", [7.0, 30.0, 120.0])
def test_what_is_alike_does_not_depend_on_how_bright_it_is(ambient):
    scene = SyntheticScene(ambient_dn=ambient)
    for position in (0, 5000, 20000):
        assert compare(pair(scene, position), pair(scene, position)).correlation > 0.95
        assert compare(pair(scene, position), pair(scene, position + 80)).correlation < 0.6


@pytest.mark.parametrize("scene", [SyntheticScene(ambient_dn=0.5), SyntheticScene(contrast=0.0)])
def test_a_room_without_contrast_is_not_compared(scene):
    found = compare(pair(scene), pair(scene, 1001.0))
    assert found.correlation is None and found.within(1.0, LEAST) and not found.within(1e-9, LEAST)
    assert "too little contrast to compare by" in str(found)
    half = compare(pair(SyntheticScene()), pair(scene))
    assert half.correlation is None


@pytest.mark.more
def test_a_rendered_room_is_recognised_and_distinguished_from_its_neighbourhood():
    pytest.importorskip("embreex")
    from bench.camera.rendered import View, load_world

    world = load_world()

    def seen(degrees, exposure=1.0):
        angle = np.deg2rad(150.0 + degrees)
        return tuple(
            world.frame(View(angle, (light,), exposure=exposure), k + round(1000 * exposure))
            for k, light in enumerate((1.0, 0.0))
        )

    first = seen(0.0)
    same, elsewhere = compare(first, seen(0.0, 0.8)), [compare(first, seen(by, 0.8)) for by in (1.0, -1.0, 15.0)]
    assert same.correlation > 0.99 and same.within(0.2, LEAST)
    assert all(found.correlation < 0.65 and not found.within(1000.0, LEAST) for found in elsewhere)


def test_without_a_line_nothing_is_known():
    found = compare(pair(SyntheticScene(peak_dn=0.0)), pair(SyntheticScene(peak_dn=0.0)))
    assert found.shift_px is None and not found.within(100.0, -1.0)
    assert "the line is not on the same rows" in str(found)


# A laser that is slow to go out, distinguished from wallpaper with stripes


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
