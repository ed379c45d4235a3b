"""Captures that do not determine a scanner say in one line what is missing."""

from dataclasses import replace

import numpy as np
import pytest

from jaxscan.calibration import CalibrationSettings, calibrate_camera, calibrate_observations
from jaxscan.calibration.first_values import check_tilts
from jaxscan.errors import CalibrationError


QUICK = CalibrationSettings(judge=False)
NO_SHAPE = tuple(block for block in QUICK.free if block != "shape")


def refusal(observations, call=calibrate_observations):
    with pytest.raises(CalibrationError) as found:
        call(observations)
    message = str(found.value)
    assert "\n" not in message
    return message


@pytest.fixture(scope="module")
def observed(world):
    return world.with_noise(world.observe(world.Rig()), 0)


def test_no_board_in_any_view(observed):
    corners = replace(observed.corners, valid=np.zeros_like(observed.corners.valid))
    assert "not found in any view" in refusal(replace(observed, corners=corners))


def test_corners_on_one_line_are_no_board(observed):
    valid = np.zeros_like(observed.corners.valid)
    valid[:, :9] = True
    assert "not found in any view" in refusal(replace(observed, corners=replace(observed.corners, valid=valid)))


def test_too_few_views(observed):
    valid = observed.corners.valid.copy()
    valid[2:] = False
    message = refusal(replace(observed, corners=replace(observed.corners, valid=valid)))
    assert "2 view" in message and "tilted" in message


@pytest.mark.parametrize("tilt", [0.0, 30.0])
def test_views_at_the_same_tilt(world, observed, tilt):
    rig = world.Rig()
    board = rig.board.corners() - rig.board.corners().mean(0)
    rotation = world.rodrigues(np.radians([tilt, 0.0, 0.0]))
    places = [(-0.1, -0.1, 0.9), (0.1, 0.05, 1.0), (0.0, 0.1, 1.2), (0.05, -0.05, 1.1)]
    q = np.array([world.project(rig, board @ rotation.T + np.array(place)) for place in places])
    q = q + 0.1 * np.random.default_rng(0).normal(size=q.shape)
    corners = replace(
        observed.corners,
        q=q,
        **{name: getattr(observed.corners, name)[:4] for name in ("sigma", "valid", "angle", "placement", "record")},
    )
    stripes = replace(observed.stripes, view=np.zeros_like(observed.stripes.view))
    assert "same tilt" in refusal(replace(observed, corners=corners, stripes=stripes), calibrate_camera)


def test_views_that_no_focal_length_explains_are_not_called_alike(world):
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[1, :3, :3] = world.rodrigues(np.radians([40.0, 0.0, 0.0]))
    check_tilts(poses)
    with pytest.raises(CalibrationError, match="No focal length explains all 3 views, whose tilts differ by up to 40"):
        check_tilts(poses, determined=False)


@pytest.mark.parametrize(("largest", "usable"), [(3.0, False), (25.0, True)])
def test_boards_that_lie_all_but_flat_make_no_camera(world, largest, usable):
    """Eleven boards on a bed: they are solved, and refused by how well they tell the focal length."""
    rig, random = world.Rig(), np.random.default_rng(3)
    board, q = rig.board.corners() - rig.board.corners().mean(0), []
    for _ in range(11):
        way, tilt = random.uniform(0, 2 * np.pi), np.radians(random.uniform(largest / 2, largest))
        turn = world.rodrigues(tilt * np.array([np.cos(way), np.sin(way), 0.0]))
        place = np.append(random.uniform(-0.1, 0.1, 2), random.uniform(0.85, 0.95))
        q.append(world.project(rig, board @ turn.T + place))
    template = world.observe(rig, free=11, placements=0, stripes=False)
    seen = world.with_noise(replace(template, corners=replace(template.corners, q=np.array(q))), 1)
    found = calibrate_camera(seen, settings=CalibrationSettings(free=NO_SHAPE))
    verdict, sigma = found.quality.verdict, np.sqrt(found.covariance[0, 0])
    assert abs(float(found.camera.fx) - rig.focal[0]) < 3.0 * sigma
    assert verdict.usable is usable and (sigma > 0.03 * rig.focal[0]) is not usable
    assert usable or "focal length is known to" in verdict.refused


def smaller(observations, settings=QUICK):
    """The one sentence about the part that is not solved, and the names of the parameters that are."""
    calibration = calibrate_observations(observations, settings=settings)
    (message,) = calibration.missing
    assert "\n" not in message and calibration.quality.converged
    return message, set(calibration.order)


def test_no_stripes(observed):
    stripes = replace(observed.stripes, valid=np.zeros_like(observed.stripes.valid))
    message, order = smaller(replace(observed, stripes=stripes))
    assert message.startswith("no sheet of laser 'laser'") and "laser on and off" in message
    assert {"fx", "axis.d1", "gain"} < order and "laser.laser.d" not in order


def test_stripes_on_one_board_pose(observed):
    valid = observed.stripes.valid.copy()
    valid[1:] = False
    message, order = smaller(replace(observed, stripes=replace(observed.stripes, valid=valid)))
    assert message.startswith("no sheet: ") and "one line" in message and "different distances" in message
    assert "axis.d1" in order and "laser.laser.d" not in order


@pytest.mark.more
def test_board_never_seen_from_two_angles(observed):
    count = len(observed.corners.placement)
    corners = replace(observed.corners, placement=np.arange(count, dtype=np.int32))
    message, order = smaller(replace(observed, corners=corners))
    assert message.startswith("no axis: ") and "leave the board standing and turn the table" in message
    assert {"fx", "laser.laser.d"} < order and "axis.d1" not in order and "gain" not in order


def test_one_angle_only(observed):
    corners = replace(observed.corners, angle=np.zeros_like(observed.corners.angle))
    message, order = smaller(replace(observed, corners=corners))
    assert "two table angles" in message and "axis.d1" not in order


def test_angles_of_another_scale(observed):
    corners = replace(observed.corners, angle=observed.corners.angle * 2)
    assert "steps per turn" in refusal(replace(observed, corners=corners))


def test_a_table_that_does_not_turn(observed):
    # Every placement as it was seen from its first angle, under the angles that were commanded.
    placement = np.asarray(observed.corners.placement)
    first = np.array([np.flatnonzero(placement == number)[0] for number in placement])
    stripes = replace(observed.stripes, view=first[observed.stripes.view].astype(np.int32))
    message = refusal(
        replace(observed, corners=replace(observed.corners, q=observed.corners.q[first]), stripes=stripes)
    )
    assert "did not turn" in message


def test_what_is_not_determined_is_named(world):
    # Two angles show one difference, which five unknowns of the angle share.
    seen = world.with_noise(world.observe(world.Rig(), angles=2), 0)
    free = {"gain": np.inf, "harmonics": np.inf}
    message = refusal(seen, lambda data: calibrate_observations(data, settings=CalibrationSettings(priors=free)))
    assert "gain" in message or "s1" in message
    named = message.partition("combination of ")[2].partition(":")[0].split(", ")
    assert set(named) == {"gain", "c1", "s1", "c2", "s2"}
    assert "capture placements" in message


@pytest.mark.more
class TestConvergence:
    """Nothing is diagnosed from a solve that did not end at a minimum."""

    def test_too_few_steps_for_a_first_camera(self, observed):
        few = CalibrationSettings(max_steps=1)
        message = refusal(observed, lambda data: calibrate_observations(data, settings=few))
        assert message.startswith("The solve did not converge in 1 step") and "max_steps" in message
        assert "steps per turn" not in message

    def test_too_few_steps_for_a_camera_alone(self, observed):
        quality = calibrate_camera(observed, settings=CalibrationSettings(max_steps=1)).quality
        assert quality.converged is False
        assert quality.verdict.usable is False and quality.verdict.tests == ()
        assert quality.verdict.refused.startswith("The solve did not converge in 1 step")
        assert quality.verdict.advice == () and quality.verdict.good_to is None
        assert quality.unobserved == quality.spectrum == quality.warnings == () and quality.lengths is None
        # The residuals are told: there they show where it hangs.
        assert quality.corner_rms_px > 0.2 and len(quality.per_view) == quality.views

    def test_enough_steps(self, observed):
        assert calibrate_camera(observed).quality.converged is True
        quality = calibrate_observations(observed, settings=CalibrationSettings(judge=False)).quality
        assert quality.converged is True and quality.verdict is None

    def test_only_the_last_solve_counts(self, observed):
        """The rough rounds may stop early: one step each is too few for some, and enough for the last ones."""
        steps = [calibrate_camera(observed, settings=CalibrationSettings(max_steps=n)).quality for n in (2, 3, 6)]
        assert [quality.converged for quality in steps][-1] is True

    def test_a_weak_capture_may_converge(self, world):
        """Two angles say nothing of the table's harmonics; their priors hold them, and the advice says so."""
        seen = world.with_noise(world.observe(world.Rig(), angles=2), 0)
        quality = calibrate_observations(seen).quality
        assert quality.converged is True
        assert quality.unobserved and any("angle errors" in line for line in quality.verdict.advice)
