"""Targets in a rendered room: named corners where they are, in several sweeps one track; doubles are left out."""

import cv2
import numpy as np
import pytest

from jaxscan.geometry import Charuco
from jaxscan.recalibration import RecalibrationSettings
from jaxscan.recalibration.tracks import named_points, observe_features
from jaxscan.vision import board_texture, feature_eyes, find_targets
from tests.vision.painted_room import PIXELS, Rig, hang, render
from tests.vision.room_capture import Images, stripes_of, true_scanner


RIG = Rig(320, 256, 240.0, (161.3, 126.6))
ANGLES = np.radians(np.arange(-24.0, 25.0, 4.0))
# The far wall is z = 2.1 m; its picture's axes are x and y.
MARKER_M, CENTRE = 0.5, (-0.35, -0.1)
BOARD = Charuco(4, 4, 0.28, 0.22, "DICT_5X5_50")


def marker(number, side=300):
    """A marker on white paper a sixth larger on each side."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    return np.pad(cv2.aruco.generateImageMarker(dictionary, number, side), side // 6, constant_values=255)


def room():
    return [np.full((PIXELS, PIXELS), 120, np.float32) for _ in range(6)]


def sweep_of(walls, seed=1, angles=ANGLES):
    rng = np.random.default_rng(seed)
    return Images([render(RIG, walls, angle, rng) for angle in angles], angles)


def observe(sources, stripes, board=None, **settings):
    settings = RecalibrationSettings(features=False, **settings)
    return observe_features(sources, stripes, true_scanner(RIG), feature_eyes(), settings, board)


@pytest.fixture(scope="module")
def marked():
    walls = room()
    hang(walls[5], marker(7), CENTRE, MARKER_M * 4 / 3)
    return sweep_of(walls)


@pytest.mark.more
def test_a_marker_becomes_four_named_tracks(marked):
    tracks, notes = observe([marked], [stripes_of(ANGLES)])
    assert notes == ()
    assert sorted(tracks.name) == [f"marker 7 corner {k}" for k in range(4)]
    found = named_points(tracks, 0, [stripes_of(ANGLES)], true_scanner(RIG))
    corner = [found[f"marker 7 corner {k}"][0] for k in range(4)]
    sides = [np.linalg.norm(corner[k] - corner[k - 1]) for k in range(4)]
    # A texel is 4 mm and a pixel 9 mm there.
    assert sides == pytest.approx([MARKER_M] * 4, abs=3e-3)
    pose = np.asarray(true_scanner(RIG).scanner_from_camera())
    middle = pose[:3, :3].T @ (np.mean(corner, axis=0) - pose[:3, 3])
    assert middle == pytest.approx([*CENTRE, 2.1], abs=8e-3)


def test_one_marker_in_two_sweeps_is_one_track(marked):
    stripes = [stripes_of(ANGLES, "a"), stripes_of(ANGLES, "b", station=1)]
    tracks, _ = observe([marked, marked], stripes)
    assert len(tracks.name) == 4
    assert set(tracks.sweep[tracks.track == 0]) == {0, 1}
    first, second = (named_points(tracks, k, stripes, true_scanner(RIG)) for k in (0, 1))
    for name, (point, _) in first.items():
        assert point == pytest.approx(second[name][0], abs=1e-9)


def test_a_marker_that_hangs_twice_is_left_out_with_a_note():
    walls = room()
    hang(walls[5], marker(7), CENTRE, MARKER_M * 4 / 3)
    hang(walls[5], marker(7), (0.45, -0.1), MARKER_M * 4 / 3)
    hang(walls[5], marker(3), (0.0, 0.6), MARKER_M * 4 / 3)
    tracks, notes = observe([sweep_of(walls)], [stripes_of(ANGLES)])
    assert {name.split(" corner")[0] for name in tracks.name} == {"marker 3"}
    assert len(notes) == 1
    assert "marker 7" in notes[0]


def test_a_marker_in_two_corners_of_the_room_is_left_out_too():
    """No image shows both."""
    here, there = room(), room()
    hang(here[5], marker(7), (-0.8, -0.1), MARKER_M * 4 / 3)
    hang(there[5], marker(7), (0.8, -0.1), MARKER_M * 4 / 3)
    rng = np.random.default_rng(3)
    images = [render(RIG, here if k % 2 else there, angle, rng) for k, angle in enumerate(ANGLES)]
    tracks, notes = observe([Images(images, ANGLES)], [stripes_of(ANGLES)])
    assert tracks is None
    assert "marker 7" in notes[0]


@pytest.mark.more
def test_a_board_left_standing_has_numbered_corners():
    walls = room()
    hang(walls[5], np.pad(board_texture(BOARD, 60), 30, constant_values=255), (-0.1, 0.1), 1.12 * 300 / 240)
    stripes = [stripes_of(ANGLES)]
    tracks, _ = observe([sweep_of(walls)], stripes, BOARD)
    assert set(tracks.name) <= {f"board corner {k}" for k in range(9)}
    assert len(tracks.name) >= 7
    found = named_points(tracks, 0, stripes, true_scanner(RIG))
    known = BOARD.corners()
    names = sorted(found, key=lambda name: int(name.rsplit(" ", 1)[1]))
    first, last = (int(names[k].rsplit(" ", 1)[1]) for k in (0, -1))
    length = np.linalg.norm(found[names[-1]][0] - found[names[0]][0])
    # The board hangs on texels of 4 mm.
    assert length == pytest.approx(np.linalg.norm(known[last] - known[first]), abs=6e-3)


def test_a_room_without_targets_has_none():
    rng = np.random.default_rng(5)
    grey = (100 + 20 * rng.standard_normal((200, 240))).clip(0, 255).astype(np.uint8)
    assert feature_eyes().find_dictionary([grey, grey]) is None
    assert find_targets(grey, None, "DICT_4X4_50").name == ()
    assert find_targets(grey, BOARD, None).name == ()
    assert find_targets(np.zeros((3, 3), np.uint8), BOARD, "DICT_4X4_50").name == ()
