"""Another model of the lens is tried where the chosen one falls short, and only there."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from jaxscan.calibration import NOTHING_KNOWN, CalibrationSettings, calibrate_camera, settle_lens
from jaxscan.calibration.calibrate import estimate
from jaxscan.calibration.cross_validation import compare_regions
from jaxscan.calibration.other_lens import ray_difference
from jaxscan.calibration.structure import beyond_noise


pytestmark = pytest.mark.more


PINHOLE = CalibrationSettings(free=tuple(b for b in CalibrationSettings().free if b != "shape"))


def seen_by_a_fisheye(world, views=30, focal=400.0, reach_deg=55.0):
    """Corners of boards within 10 degrees more of the axis of an equidistant fisheye, without noise."""
    random, rig = np.random.default_rng(5), world.Rig()
    corners = rig.board.corners()
    corners = corners - corners.mean(0)
    q = []
    while len(q) < views:
        theta, turn = np.radians(reach_deg * np.sqrt(random.random())), random.uniform(0, 2 * np.pi)
        away = world.rodrigues(theta * np.array([-np.sin(turn), np.cos(turn), 0.0]))
        tilt = world.rodrigues(random.uniform(-0.5, 0.5, 3))
        p = (corners @ tilt.T + [0.0, 0.0, random.uniform(0.5, 0.8)]) @ away.T
        radius = np.linalg.norm(p[:, :2], axis=1, keepdims=True)
        seen = np.array(rig.centre) + focal * np.arctan2(radius, p[:, 2:]) * p[:, :2] / radius
        if (seen > 5).all() and (seen < np.array(rig.size) - 6).all():
            q.append(seen)
    template = world.observe(rig, free=views, placements=0, stripes=False)
    return replace(template, corners=replace(template.corners, q=np.array(q)))


@pytest.fixture(scope="module")
def mistaken(world):
    """A fisheye's corners, and the pinhole that was fitted to them."""
    seen = world.with_noise(seen_by_a_fisheye(world), 0)
    return seen, calibrate_camera(seen, settings=PINHOLE)


def test_a_fisheye_that_was_taken_for_a_pinhole(mistaken):
    """Nobody asked for a pinhole: the model that explains the corners is taken, and said first."""
    seen, found = mistaken
    settled = settle_lens(found, PINHOLE, seen, NOTHING_KNOWN)
    off = ray_difference(settled.camera, found.camera)
    assert settled.camera.model in ("fisheye", "double_sphere") and settled.quality.verdict.usable
    assert settled.quality.warnings[0].startswith(f"the lens was solved as `--lens {settled.camera.model}`")
    # The noise is 0.1 px in each direction.
    assert settled.quality.corner_rms_px == pytest.approx(0.1 * np.sqrt(2), rel=0.15)
    assert settled.quality.verdict.good_to.sigma_px < 0.01 * off


def test_a_wrong_lens_knows_by_itself_how_far_it_goes_astray(mistaken):
    """The middle of the image alone says so: of the corners it explains most, beyond them it is off by far."""
    seen, found = mistaken
    true = calibrate_camera(seen, settings=replace(PINHOLE, camera="fisheye"))
    off = ray_difference(true.camera, found.camera)
    assert found.quality.corner_rms_px < 0.01 * off
    verdict = found.quality.verdict
    assert off / 1.5 < verdict.good_to.sigma_px < 1.5 * off
    assert max(verdict.tests, key=lambda test: test.effect_px or 0.0).name == "regions"
    assert all(test.effect_px is None for test in true.quality.verdict.tests if test.name == "regions")


@pytest.mark.parametrize(("reach_deg", "camera", "told"), [(30.0, "fisheye", False), (55.0, "pinhole", True)])
def test_what_noise_does_beyond_the_corners_is_no_fault_of_the_lens(world, reach_deg, camera, told):
    """Four coefficients, known in the middle alone, are lost at the rim by noise; a pinhole is lost by itself."""
    seen, settings = world.with_noise(seen_by_a_fisheye(world, reach_deg=reach_deg), 0), replace(PINHOLE, camera=camera)
    with jax.enable_x64(True):
        result = estimate(seen, settings=replace(settings, only="camera")).adjustment
        split = compare_regions(result, settings)
        scales = np.asarray(result.problem.scales)
        step = np.zeros((1, len(scales)))
        step[0, split.free] = split.difference * scales[split.free]
        assert beyond_noise(result, split, step) == told


def test_a_pinhole_that_was_asked_for_is_as_far_off_as_it_is(mistaken):
    """The advice comes first, and the verdict says the distance of its rays from those of the true model."""
    seen, found = mistaken
    settings = replace(PINHOLE, choose_lens=False)
    advised = settle_lens(found, settings, seen, NOTHING_KNOWN)
    verdict = advised.quality.verdict
    assert advised.camera is found.camera and verdict.advice[1:] == found.quality.verdict.advice
    assert verdict.advice[0].split("`")[1] in ("--lens fisheye", "--lens double_sphere", "--free rational")
    true = calibrate_camera(seen, settings=replace(PINHOLE, camera="fisheye"))
    off = ray_difference(true.camera, found.camera)
    assert off / 1.5 < verdict.good_to.sigma_px < 1.5 * off


def test_a_lens_that_suffices_is_left_alone(world, monkeypatch):
    seen = world.with_noise(world.observe(world.Rig(), free=12, placements=0, stripes=False), 0)
    found = calibrate_camera(seen, settings=PINHOLE)
    monkeypatch.setattr("jaxscan.calibration.other_lens.calibrate_observations", lambda *_, **__: pytest.fail())
    assert settle_lens(found, PINHOLE, seen, NOTHING_KNOWN) is found
