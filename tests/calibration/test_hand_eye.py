"""A camera on a hand whose poses are given: its place on the hand, and how the poses scatter."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from jaxscan.calibration import CalibrationSettings, KnownParts, calibrate_observations
from jaxscan.errors import CalibrationError
from jaxscan.geometry import motion_of
from jaxscan.observation.first_look import Look, to_observations
from jaxscan.observation.records import SeenRecord


QUICK = CalibrationSettings(judge=False)
SCATTER = np.array([2e-4, 3e-4])
"""Of the given poses, by place [m] and by angle [rad]."""


def pose(rotation, place):
    return np.vstack([np.column_stack([rotation, place]), [0, 0, 0, 1]])


@pytest.fixture(scope="module")
def seen(world):
    """Observations of one board that stands, from all sides; and T_hand_cam."""
    rig, random = world.Rig(), np.random.default_rng(11)
    turned = lambda vector: world.rodrigues(np.asarray(vector, float))
    hand_cam = pose(turned([0.9, -0.4, 0.7]), [0.06, -0.03, 0.11])
    base_board = pose(turned([2.0, 0.3, -0.5]), [0.5, 0.8, 0.1])
    corners = rig.board.corners()
    views, q, given = world.observe(rig, free=24, placements=0, seed=2), [], []
    while len(q) < 24:
        turn = turned(random.normal(size=3) * [0.35, 0.35, 0.8])
        middle = np.array([random.uniform(-0.12, 0.12), random.uniform(-0.1, 0.1), random.uniform(0.7, 1.1)])
        board = pose(turn, middle - turn @ corners.mean(0))
        pixels = world.project(rig, corners @ turn.T + board[:3, 3])
        if ((pixels > 5) & (pixels < np.array(rig.size) - 6)).all():
            noise = SCATTER.repeat(3) * random.normal(size=6)
            off = pose(turned(noise[3:]), noise[:3])
            q.append(pixels)
            given.append(base_board @ np.linalg.inv(board) @ np.linalg.inv(hand_cam) @ off)
    count = len(q)
    corner = replace(
        views.corners, q=np.array(q), angle=np.arange(count, dtype=float), placement=np.zeros(count, np.int32)
    )
    stripes = type(views.stripes)(
        *(None if value is None else np.asarray(value)[:0] for value in vars(views.stripes).values())
    )
    observed = replace(views, corners=corner, stripes=stripes, laser_names=(), carries="poses", poses=np.array(given))
    return world.with_noise(observed, 4), hand_cam


def test_place_and_scatter_are_found_within_their_sigmas(seen):
    observed, hand_cam = seen
    found = calibrate_observations(observed, settings=QUICK)
    motion = found.scanner.turntable
    sigma = dict(zip(found.order, np.sqrt(np.diag(found.covariance)), strict=True))
    sigma = np.array([sigma[name] for name in motion.blocks[0].parameters])
    # A camera known to a pixel of 1200 is known to a milliradian and, from a metre away, to a millimetre.
    assert (sigma < 1e-3).all()
    true = motion_of("poses", translation_m=np.zeros(3), rotation=np.zeros(3))
    true = replace(true, hand_cam=hand_cam)
    assert (np.abs(motion.departure(true)) < 4.5 * sigma).all()
    # Errors of the camera that differ from view to view count in: more than is there, and not twice as much.
    assert (0.8 * SCATTER < motion.scatter).all() and (motion.scatter < 2.0 * SCATTER).all()


def test_a_camera_that_is_known_to_sit_there_is_held(seen):
    observed, hand_cam = seen
    known = replace(motion_of("poses", translation_m=np.zeros(3), rotation=np.zeros(3)), hand_cam=hand_cam)
    found = calibrate_observations(observed, settings=QUICK, known=KnownParts(motion=known))
    np.testing.assert_allclose(found.scanner.turntable.hand_cam, hand_cam, atol=1e-12)
    assert not found.covariance[-6:].any() and (found.scanner.turntable.scatter > 0.5 * SCATTER).all()


def test_poses_of_other_pictures_are_refused(seen):
    observed, _ = seen
    with pytest.raises(CalibrationError, match="The given poses miss the boards by"):
        calibrate_observations(replace(observed, poses=np.roll(observed.poses, 1, axis=0)), settings=QUICK)


def test_poses_of_a_hand_that_carries_the_board_are_told(seen):
    observed, _ = seen
    with pytest.raises(CalibrationError, match=r"if the hand carried the board .* give the inverse of every pose"):
        calibrate_observations(replace(observed, poses=np.linalg.inv(observed.poses)), settings=QUICK)


@pytest.mark.parametrize("size", [0.5, 1.04])
def test_a_board_of_another_size_is_told_by_the_poses(seen, size):
    observed, _ = seen
    poses = np.array(observed.poses)
    poses[:, :3, 3] *= size
    with pytest.raises(CalibrationError, match=f"a board that is {size:g}[0-9]* times as large") as told:
        calibrate_observations(replace(observed, poses=poses), settings=QUICK)
    assert abs(float(str(told.value).split(" times as large")[0].split()[-1]) / size - 1) < 0.01


def test_a_hand_that_turns_about_one_axis_alone_is_refused(world):
    turns = [world.rodrigues(np.array([0.0, 0.0, angle])) for angle in (0.0, 0.2, 0.5, 0.9)]
    poses = np.array([pose(turn, [0.0, 0.0, 0.8]) for turn in turns])
    kind = type(motion_of("poses", translation_m=np.zeros(3), rotation=np.zeros(3)))
    with pytest.raises(ValueError, match="turned about one direction alone"):
        kind.of_boards(np.stack([poses[:-1], poses[1:]]), np.linalg.inv(poses[:-1]) @ poses[1:])


def test_two_captures_keep_their_own_poses(seen):
    observed, _ = seen
    corners = observed.corners
    two = []
    for half in (slice(0, 10), slice(10, 24)):
        about = dict.fromkeys(("path", "records", "pixel_format", "response", "bits", "compression", "frames"), len)
        size, poses = (observed.width, observed.height), np.asarray(observed.poses)[half]
        two.append(SimpleNamespace(**about, image_size=size, lasers=(), up="-v", carries="poses", poses=poses))
    views = []
    for at in reversed(range(24)):
        capture, own = (0, at) if at < 10 else (1, at - 10)
        record = SimpleNamespace(i=own, angle=float(own), placement=3)
        found = np.asarray(corners.q)[at], np.asarray(corners.sigma)[at], np.asarray(corners.valid)[at]
        views.append(SeenRecord(capture, record, corners=found))
    joined = to_observations(two, Look(observed.board, views, None, None))
    np.testing.assert_array_equal(joined.poses, observed.poses)
    np.testing.assert_array_equal(joined.corners.angle, np.arange(24)[::-1])
    assert len(set(np.asarray(joined.corners.placement))) == 2
