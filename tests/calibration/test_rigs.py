"""Rigs of every kind: the largest that the observations determine is solved, and the truth is found.

Seeds are fixed. An error beyond 4.5 of its own sigmas in one of some 20 parameters has a chance of 1e-4.
"""

from dataclasses import replace

import numpy as np
import pytest

from jaxscan.api.calibration import solve_again
from jaxscan.calibration import CalibrationSettings, KnownParts, calibrate_observations
from jaxscan.errors import CalibrationError
from jaxscan.files import load_calibration, save_calibration
from jaxscan.geometry import LaserSheet, LinearStage, Pinhole, Still, Turntable


QUICK = CalibrationSettings(judge=False)
FAR = 4.5


@pytest.fixture(scope="module")
def seen(world):
    """Noisy observations of one rig of a kind."""

    def make(carries="scanner", *, placements=3, seed=0, **changes):
        rig = world.Rig(carries="scanner" if carries == "nothing" else carries, gain=1.0005)
        observations = world.with_noise(world.observe(rig, placements=placements, seed=2), seed)
        return replace(rig, carries=carries), replace(observations, carries=carries, **changes)

    return make


def assert_found(calibration, rig, world):
    """Every parameter within its sigmas, and as well known as a rig like this is."""
    error = world.errors(calibration.scanner, rig)
    sigma = np.sqrt(np.diag(calibration.covariance))
    assert len(error) == len(sigma) == len(calibration.order)
    free = sigma > 0
    assert (np.abs(error[free]) < FAR * sigma[free]).all(), dict(zip(calibration.order, error / sigma, strict=True))
    return dict(zip(calibration.order, sigma.tolist(), strict=True))


def assert_stored(calibration, tmp_path):
    """It is the same from its file, and the same when it is solved again."""
    save_calibration(calibration, tmp_path / "c.json")
    again = load_calibration(tmp_path / "c.json")
    assert again.order == calibration.order
    if calibration.scanner is not None:
        assert type(again.scanner.turntable) is type(calibration.scanner.turntable)
        assert again.scanner.laser_names == calibration.scanner.laser_names
    assert solve_again(again).reproduced is True


@pytest.mark.more
def test_a_linear_stage(world, seen, tmp_path):
    rig, observations = seen("linear")
    calibration = calibrate_observations(observations)
    assert calibration.missing == () and isinstance(calibration.scanner.turntable, LinearStage)
    sigma = assert_found(calibration, rig, world)
    # 0.1 px at 1200 px over 0.16 m of travel at 1 m.
    assert sigma["travel.t1"] < 1e-3 and sigma["gain"] < 1e-3 and sigma["laser.laser.d"] < 1e-3
    lengths = calibration.quality.lasers()[0].lengths
    assert [length.name for length in lengths] == ["wall", "along the stripe", "across the sweep"]
    assert all(0 < length.sigma_mm < 5 for length in lengths)
    assert_stored(calibration, tmp_path)


def test_a_profile_scanner(world, seen, tmp_path):
    rig, observations = seen("nothing", placements=0)
    calibration = calibrate_observations(observations)
    assert calibration.missing == () and isinstance(calibration.scanner.turntable, Still)
    sigma = assert_found(calibration, rig, world)
    assert sigma["laser.laser.d"] < 1e-3 and not any("axis" in name for name in sigma)
    assert [length.name for length in calibration.quality.lasers()[0].lengths] == ["along the stripe"]
    assert_stored(calibration, tmp_path)


def test_a_camera_and_an_axis(world, seen, tmp_path):
    rig, observations = seen(laser_names=())
    stripes = type(observations.stripes)(
        *(None if value is None else np.asarray(value)[:0] for value in vars(observations.stripes).values())
    )
    calibration = calibrate_observations(replace(observations, stripes=stripes))
    (missing,) = calibration.missing
    assert missing.startswith("no sheet: the header lists no [[laser]]")
    assert calibration.scanner.laser_names == () and isinstance(calibration.scanner.turntable, Turntable)
    without = replace(rig, normals=(), distances=())
    assert assert_found(calibration, without, world)["axis.p1"] < 2e-3
    assert_stored(calibration, tmp_path)


@pytest.mark.more
def test_one_of_two_lasers_that_no_board_shows_is_left_out(world):
    rig = world.Rig(normals=((0.990, -0.010, 0.140), (-0.990, 0.0, 0.140)), distances=(0.2, 0.2))
    observations = world.with_noise(world.observe(rig, placements=3), 0)
    stripes = observations.stripes
    dark = replace(stripes, valid=stripes.valid & (stripes.laser == 0)[:, None])
    calibration = calibrate_observations(replace(observations, stripes=dark), settings=QUICK)
    (missing,) = calibration.missing
    assert missing.startswith("no sheet of laser 'laser1'")
    assert calibration.scanner.laser_names == ("laser",) == calibration.observations.laser_names
    assert_found(calibration, replace(rig, normals=rig.normals[:1], distances=rig.distances[:1]), world)


@pytest.mark.more
@pytest.mark.parametrize(
    ("only", "has", "lacks"),
    [
        ("camera", "fx", "laser.laser.d"),
        ("profile", "laser.laser.d", "axis.d1"),
        ("axis", "axis.d1", "laser.laser.d"),
    ],
)
def test_a_smaller_rig_on_purpose(seen, only, has, lacks):
    calibration = calibrate_observations(seen()[1], settings=replace(QUICK, only=only))
    assert has in calibration.order and lacks not in calibration.order and calibration.missing == ()


@pytest.mark.more
class TestKnownParts:
    def camera(self, rig):
        return Pinhole(*rig.focal, *rig.centre, np.array(rig.lens), *rig.size)

    def sheet(self, rig):
        return LaserSheet.from_plane(rig.normal(), rig.distances[0])

    def axis(self, rig):
        return Turntable.from_axis(rig.direction(), rig.foot(), gain=rig.gain)

    def test_a_camera_that_is_held(self, world, seen, tmp_path):
        rig, observations = seen()
        known = KnownParts(camera=self.camera(rig))
        calibration = calibrate_observations(observations, settings=QUICK, known=known)
        sigma = assert_found(calibration, rig, world)
        assert sigma["fx"] == sigma["k1"] == 0 and sigma["laser.laser.d"] > 0 and sigma["axis.d1"] > 0
        assert float(calibration.camera.fx) == rig.focal[0]
        # A camera that need not be found leaves the sheet better known.
        free = calibrate_observations(observations, settings=QUICK)
        assert sigma["laser.laser.d"] < np.sqrt(np.diag(free.covariance))[free.order.index("laser.laser.d")]
        assert_stored(calibration, tmp_path)

    def test_two_views_suffice_where_the_camera_is_known(self, world):
        rig = world.Rig()
        observations = world.with_noise(world.observe(rig, free=2, placements=0), 0)
        known = KnownParts(camera=self.camera(rig))
        settings = replace(QUICK, free=tuple(block for block in QUICK.free if block not in ("warp", "pitch")))
        calibration = calibrate_observations(observations, settings=settings, known=known)
        assert "laser.laser.d" in calibration.order and "no axis" in calibration.missing[0]
        assert_found(calibration, replace(rig, carries="nothing"), world)

    def test_a_camera_that_is_refined_ends_where_none_was_given(self, world, seen):
        rig, observations = seen()
        off = replace(self.camera(rig), fx=np.asarray(1150.0), fy=np.asarray(1150.0), distortion=np.zeros(5))
        known = KnownParts(camera=off, refine=("camera",))
        refined = calibrate_observations(observations, settings=QUICK, known=known)
        free = calibrate_observations(observations, settings=QUICK)
        sigma = np.sqrt(np.diag(free.covariance))
        assert abs(float(refined.camera.fx) - float(free.camera.fx)) < 1e-3 * sigma[0]
        assert sigma[0] > 0 and np.diag(refined.covariance)[0] > 0

    def test_sheet_and_axis_that_are_held(self, world, seen, tmp_path):
        rig, observations = seen(placements=0)
        known = KnownParts(sheets=(self.sheet(rig),), motion=self.axis(rig))
        calibration = calibrate_observations(observations, settings=QUICK, known=known)
        assert calibration.missing == ()
        sigma = assert_found(calibration, rig, world)
        assert sigma["laser.laser.d"] == sigma["axis.d1"] == sigma["gain"] == 0 and sigma["fx"] > 0
        np.testing.assert_allclose(calibration.scanner.laser(0).normal, rig.normal(), atol=1e-12)
        assert_stored(calibration, tmp_path)

    def test_parts_of_another_rig_are_refused(self, world, seen):
        rig, observations = seen()
        small = Pinhole(600.0, 600.0, 320.0, 240.0, np.zeros(5), 640, 480)
        for known, words in (
            (KnownParts(camera=small), "640 x 480 px, the capture of 1280 x 1024 px"),
            (KnownParts(sheets=(self.sheet(rig),) * 2), "2 known sheets were given for 1 lasers"),
            (KnownParts(motion=LinearStage.from_direction([1.0, 0.0, 0.0])), 'carries = "linear"'),
        ):
            with pytest.raises(CalibrationError) as caught:
                calibrate_observations(observations, settings=QUICK, known=known)
            assert words in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.more
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda angle: 1000 * angle, "times the commanded travel: check that position_m is in metres"),
        (lambda angle: 0 * angle + np.arange(len(angle)), "times the commanded travel"),
    ],
)
def test_positions_that_contradict_the_boards(seen, change, words):
    observations = seen("linear")[1]
    corners = replace(observations.corners, angle=change(np.asarray(observations.corners.angle)))
    with pytest.raises(CalibrationError) as caught:
        calibrate_observations(replace(observations, corners=corners), settings=QUICK)
    assert words in str(caught.value) and "\n" not in str(caught.value)
