"""Tests of models: they find nothing where all is right, and name the model that is wrong."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.calibration import CalibrationSettings, calibrate_observations
from jaxscan.calibration.advice import warn
from jaxscan.calibration.cross_validation import deal_halves
from jaxscan.calibration.other_lens import ray_difference
from jaxscan.calibration.result import chance
from jaxscan.calibration.score import moving_twist
from jaxscan.geometry import Pinhole, exponential, invert
from jaxscan.report.words import headline


FREE = CalibrationSettings().free


def without(*blocks):
    return CalibrationSettings(free=tuple(block for block in FREE if block not in blocks))


def verdict(observed, settings=None):
    quality = calibrate_observations(observed, settings=settings or CalibrationSettings()).quality
    return quality.verdict, {test.name: test for test in quality.verdict.tests}


@pytest.fixture(scope="module")
def clean(world):
    return world.with_noise(world.observe(world.Rig()), 1)


def test_directions_that_share_a_parameter_are_one_warning(clean):
    quality = calibrate_observations(clean, settings=replace(CalibrationSettings(), judge=False)).quality
    weak = ({"p1": 0.9, "cy": 0.4}, {"k1": 0.9}, {"p2": 0.8, "cx": 0.5}, {"cx": 0.7, "p1": 0.3}, {"k3": 0.9, "k1": 0.1})
    held = [line for line in warn(replace(quality, unobserved=weak)) if "held by priors" in line]
    assert sorted(sorted(line.partition(": ")[2].split(", ")) for line in held) == [
        ["cx", "cy", "p1", "p2"],
        ["k1", "k3"],
    ]


def test_clean_data_have_no_structure(clean):
    judged, tests = verdict(clean)
    assert judged.usable and judged.refused is None and judged.p > 0.01
    assert {judged.result(test) for test in tests.values()} == {"passes"}
    assert set(tests) == {"lens", "board", "paper", "table", "axis", "sheet", "halves", "regions"}
    # The statistics are chi-squared: their degrees of freedom, within five standard deviations.
    for test in tests.values():
        assert abs(test.statistic - test.dof) < 5.0 * np.sqrt(2.0 * test.dof) or test.dof <= 2
    assert isinstance(judged.advice, tuple)


@pytest.mark.more
@pytest.mark.parametrize(
    ("rig", "held", "name"),
    [
        ({"warp": (4e-4, 0.0)}, "warp", "board"),
        ({"harmonics": (8e-3, 6e-3, 4e-3, 0.0)}, "harmonics", "table"),
        ({"lens": (-0.10, 0.06, 2e-3, 0.0, 0.0)}, "tangential", "lens"),
    ],
)
def test_what_is_wrong_is_named(world, rig, held, name):
    # The clean data's poses and noise: fixed shapes, one compilation.
    judged, tests = verdict(world.with_noise(world.observe(world.Rig(**rig)), 1), without(held))
    assert judged.result(tests[name]) == "structure" and tests[name].p_structure < 1e-3
    # It does harm, and the calibration is of use all the same.
    assert judged.usable and 0 < tests[name].effect_mm < judged.good_to.sigma_mm


def paper(number):
    """A sheet of paper: a cylinder of another axis and up to 3 mm of height, either way, wherever it is put."""
    random = np.random.default_rng(number)
    height, along = random.uniform(-3e-3, 3e-3), random.uniform(0.0, np.pi)
    return lambda a, b: height * (1.0 - (np.cos(along) * a + np.sin(along) * b) ** 2)


def test_a_board_that_bends_from_view_to_view_is_named_with_its_size(world, clean):
    rig = world.Rig(paper=paper)
    # The clean data's poses and noise: fixed shapes, one compilation.
    found = calibrate_observations(world.with_noise(world.observe(rig), 1))
    judged, tests = found.quality.verdict, {test.name: test for test in found.quality.verdict.tests}
    assert judged.result(tests["paper"]) == "structure"
    assert judged.advice[0].startswith("glue the board on a flat and stiff plate")
    assert "because the board bends from view to view by 0." in headline(found).headline
    # What other models lack beside it is little.
    assert max(tests.values(), key=lambda test: test.effect_px or 0.0).name == "paper"
    a, b = np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 7))
    a, b = a.ravel(), b.ravel()
    heights = np.array([paper(number)(a, b) for number in range(12)])
    plane = np.column_stack([np.ones_like(a), a, b])
    heights = heights - heights @ plane @ np.linalg.pinv(plane)
    true = 1e3 * np.sqrt(np.mean((heights - heights.mean(0)) ** 2))
    # A camera in error takes up a part of the bends.
    assert true / 1.5 < tests["paper"].bend_mm < 1.1 * true
    # Of one realisation: the stated error is that of a direction, not of chance alone.
    off = ray_difference(found.camera, Pinhole(*rig.focal, *rig.centre, np.array(rig.lens), *rig.size))
    assert 0.5 * off < judged.good_to.sigma_px < 2.0 * off
    assert calibrate_observations(clean).quality.verdict.tests[2].bend_mm is None


@pytest.mark.more
def test_a_bowed_sheet_is_named(world, clean):
    # The stripe moved by half a sigma along a parabola, as no plane can; 1000 points show it.
    stripes = clean.stripes
    v = stripes.q[..., 1]
    bend = 0.15 * ((v - 512) / 300) ** 2
    moved = stripes.q + np.where(stripes.valid, bend, 0.0)[..., None] * np.array([1.0, 0.0])
    _, tests = verdict(replace(clean, stripes=replace(stripes, q=moved)), without("bow"))
    assert tests["sheet"].p_structure < 1e-3
    # The corners suffer a little from the compromise, the sheet far more.
    assert tests["sheet"].p_structure == min(test.p_structure for test in tests.values())


@pytest.mark.more
def test_noise_that_was_promised_smaller_is_no_structure(world, clean):
    sigma = clean.corners.sigma / 3.0
    judged, tests = verdict(replace(clean, corners=replace(clean.corners, sigma=sigma)))
    assert {judged.result(test) for test in tests.values()} == {"passes", "noisy"}
    assert judged.good_to.sigma_mm == judged.good_to.statistical_mm
    # With the detector at its word, nine times the expected squares are no chance.
    assert judged.p < 1e-6


def test_turning_is_the_derivative_of_the_board_pose_by_the_angle(clean):
    rig = calibrate_observations(clean, settings=CalibrationSettings(judge=False)).scanner
    pose = exponential(jnp.array([0.1, -0.2, 1.1, 0.3, 0.2, -0.5]))
    seen = lambda phi: invert(rig.turntable.motion(jnp.asarray(phi))) @ pose
    step = 1e-6
    change = np.asarray(invert(seen(0.2))) @ np.asarray(seen(0.2 + step))
    twist = np.array([*change[:3, 3], change[2, 1], change[0, 2], change[1, 0]]) / step
    # Differences err by half a step times the second derivative, some 1e-6; the table turns by the
    # derivative of its angle model, about its gain.
    rate = jax.grad(rig.turntable.angle)(0.2)
    np.testing.assert_allclose(rate * moving_twist(np.asarray(seen(0.2)), rig.turntable), twist, atol=1e-5)


def test_halves_are_dealt_inside_placements():
    placement = np.array([0, 1, 2, 2, 2, 2, 3, 3, 3, 4])
    half = deal_halves(placement, np.array([True] * 9 + [False]))
    assert half[9] == -1
    assert sorted(half[:2]) == [0, 1]
    for number in (2, 3):
        counts = np.bincount(half[placement == number], minlength=2)
        assert abs(counts[0] - counts[1]) <= 1


def test_many_tests_have_many_chances():
    assert chance([0.01, 0.5]) == 0.02
    assert chance([]) == 1.0
    assert chance([0.9, 0.8, 0.7]) == 1.0


def test_terms_are_finite_without_stripes_and_turning(world):
    from jaxscan.calibration import calibrate_camera

    judged = calibrate_camera(world.with_noise(world.observe(world.Rig(), free=12, placements=0), 0)).quality.verdict
    assert {test.name for test in judged.tests} == {"lens", "board", "paper", "halves", "regions"}
    assert judged.usable and judged.good_to.sigma_mm is None and judged.good_to.sigma_px > 0
    assert jnp.isfinite(jnp.array([test.p for test in judged.tests])).all()
