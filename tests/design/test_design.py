"""Rigs on paper: sigmas against a closed form and a Monte Carlo of an independent triangulation; the choice."""

import math

import numpy as np
import pytest

from jaxscan.design import RigDesign, RigWish, Sensor, depth_sigma, design_rig, spread_at
from jaxscan.errors import OptionError


SENSOR = Sensor(1440, 1080, 3.45e-6)
DESIGNS = [
    RigDesign(SENSOR, 6.0, 0.3, 2.0),
    RigDesign(SENSOR, 8.0, 0.15, 4.0),
    RigDesign(Sensor(1280, 1024, 4.8e-6), 4.0, 0.6, 3.0),
]
SEED, DRAWS = 20261123, 40_000


@pytest.mark.parametrize("design", DESIGNS, ids=lambda d: f"{d.lens_mm:g}mm-{d.baseline_m:g}m")
@pytest.mark.parametrize("depth", [1.0, 2.5, 6.0])
def test_depth_has_the_closed_form(design, depth):
    """z^2 / (f b) per pixel, wherever the sheet crosses the axis; float32 and a ray found to 1e-3 px leave 1e-3."""
    expected = depth**2 / (design.focal_px * design.baseline_m) * 0.1
    assert depth_sigma(design, depth, 0.1) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("design", DESIGNS, ids=lambda d: f"{d.lens_mm:g}mm-{d.baseline_m:g}m")
def test_spread_is_that_of_perturbed_pixels(design):
    """Pixels are moved at random and triangulated by the law of sines, which shares nothing with the package.

    Root mean squares of 40 000 draws are uncertain by 0.35 %: the limit is 2 %, and that is far below what a wrong
    component would make.
    """
    random, depth, noise = np.random.default_rng(SEED), 2.5, 0.1
    focal, baseline = design.focal_px, design.baseline_m
    u = focal * baseline * (1 / depth - 1 / design.crossing_m) + noise * random.normal(size=DRAWS)
    v = random.uniform(-design.sensor.height / 2, design.sensor.height / 2, DRAWS)
    # In the plane of the camera's centre, the laser and the foot of the ray: angles at both ends of the baseline.
    at_camera = math.pi / 2 - np.arctan(u / focal)
    at_laser = math.pi / 2 - math.atan2(baseline, design.crossing_m)
    leg = baseline * np.sin(at_laser) / np.sin(at_camera + at_laser)
    z, x = leg * np.sin(at_camera), leg * np.cos(at_camera)
    y = z * v / focal
    x0, y0 = baseline * (1 - depth / design.crossing_m), depth * v / focal
    expected = [np.sqrt(np.mean(each**2)) for each in (z - depth, x - x0, y - y0)]
    found = spread_at(design, [depth], noise)
    for name, one in zip(("depth", "across", "along"), expected, strict=True):
        assert float(getattr(found, name)[0]) == pytest.approx(one, rel=0.02), name


def test_limits_of_view_are_where_the_stripe_leaves_the_image():
    design = RigDesign(SENSOR, 8.0, 0.5, 3.0)
    near, far = design.view_m
    for depth, edge in ((near, 0.5), (far, -0.5)):
        if math.isfinite(depth):
            x = design.baseline_m * (1 - depth / design.crossing_m)
            assert design.focal_px * x / depth == pytest.approx(edge * SENSOR.width, rel=1e-9)
    assert near < design.crossing_m < far
    narrow = RigDesign(Sensor(320, 1080, 3.45e-6), 8.0, 0.5, 3.0)
    assert math.isfinite(narrow.view_m[1])


def test_the_choice_reaches_the_wish_and_no_simpler_rig_does():
    wish = RigWish(range_m=3.0, sigma_m=1e-3)
    choice = design_rig(wish)
    assert choice.sigma_m <= wish.sigma_m and choice.reaches(choice.design, choice.sigma_m)
    assert choice.design.fields_deg[1] >= wish.field_deg
    wider = [(one, sigma) for one, sigma in choice.alternatives if one.lens_mm < choice.design.lens_mm]
    shorter = [
        (one, sigma)
        for one, sigma in choice.alternatives
        if one.lens_mm == choice.design.lens_mm and one.baseline_m < choice.design.baseline_m
    ]
    assert wider and shorter
    assert not any(choice.reaches(one, sigma) for one, sigma in (*wider, *shorter))
    fewer = wish.sensors[: wish.sensors.index(choice.design.sensor)]
    with pytest.raises(OptionError):
        design_rig(RigWish(range_m=3.0, sigma_m=1e-3, sensors=fewer))


@pytest.mark.more
def test_what_an_impossible_wish_is_told_is_possible():
    with pytest.raises(OptionError) as told:
        design_rig(RigWish(range_m=4.0, sigma_m=5e-4))
    words = str(told.value).split()
    best = float(words[words.index("possible") + 2])
    nearer = float(str(told.value).split("or 0.5 mm at ")[1].split()[0])
    assert 0.5 < best < 1.0 and 2.0 < nearer < 4.0
    assert design_rig(RigWish(range_m=4.0, sigma_m=1e-3 * best)).sigma_m <= 1e-3 * best
    assert design_rig(RigWish(range_m=nearer, sigma_m=5e-4)).sigma_m <= 5e-4
    # As near as this wish asks for, the best rig would be longer than its range.
    with pytest.raises(OptionError) as told:
        design_rig(RigWish(range_m=4.0, sigma_m=1e-5))
    assert " or 0.01 mm at" not in str(told.value)


@pytest.mark.parametrize("key", ["range_m", "sigma_m", "longest_baseline_m", "field_deg", "stripe_px"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_wishes_that_mean_nothing(key, value):
    with pytest.raises(OptionError, match=key):
        RigWish(**({"range_m": 1.0, "sigma_m": 1e-3} | {key: value}))
