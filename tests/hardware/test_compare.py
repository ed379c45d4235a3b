"""Whether a pair that was taken again is the same: the stripe's shift, and other differences."""

from dataclasses import replace

import numpy as np
import pytest
from scanrig.cameras.simulated import FrameShape, SyntheticScene, draw
from scanrig.checks.compare import compare_pairs
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
