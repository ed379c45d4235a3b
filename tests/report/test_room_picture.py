"""The marked picture of a room: it fills its canvas, and its words are true and do not overlap."""

import dataclasses
from itertools import combinations

import numpy as np
import pytest

from jaxscan.measurement import measure_room
from jaxscan.reconstruction import Stations
from jaxscan.report import dimension_text, room_picture
from jaxscan.report.clouds.picture import BACKGROUND, room_of

from ..measurement.rooms import AT, HEIGHT
from .made_room import ELEVATION, made_room, only


@pytest.fixture(scope="module")
def drawn(cloud, box):
    return room_picture(cloud, box)


def test_it_fills_its_canvas(drawn):
    height, width = drawn.rgb.shape[:2]
    inked = np.abs(drawn.rgb.astype(int) - BACKGROUND.astype(int)).max(-1) > 12
    rows, columns = np.flatnonzero(inked.any(1)), np.flatnonzero(inked.any(0))
    free = np.array([columns[0], width - 1 - columns[-1], rows[0], height - 1 - rows[-1]])
    assert (free >= 4).all() and (free < 0.04 * width).all(), free
    # The room itself, not only what is written beside it: its walls are the only grey areas.
    grey = (np.ptp(drawn.rgb, axis=-1) < 3) & (drawn.rgb.max(-1) > 90) & inked
    wide, high = (np.ptp(np.flatnonzero(grey.sum(axis) > 8)) for axis in (0, 1))
    assert wide > 0.8 * width and high > 0.6 * height


def test_dimensions_are_those_of_measure_room(drawn, box):
    words = [label.words for label in drawn.labels]
    for side in (box.length, box.width, box.height):
        assert words.count(f"{side.value_m:.4f} m ± {1e3 * side.sigma_m:.2f} mm") == 1
        assert dimension_text(side) in words
    assert "0°" in words
    assert any("hole in the floor" in text for text in words)


@pytest.mark.more
@pytest.mark.parametrize("width", [1600, 800])
def test_words_are_on_the_picture_and_do_not_overlap(cloud, box, width):
    drawn = room_picture(cloud, box, width=width)
    assert drawn.rgb.shape[1] == width
    height, width = drawn.rgb.shape[:2]
    for label in drawn.labels:
        left, top, right, bottom = label.box
        assert 0 <= left < right <= width and 0 <= top < bottom <= height, label
    for one, other in combinations(drawn.labels, 2):
        apart = (one.box[0] >= other.box[2], other.box[0] >= one.box[2])
        assert any(apart) or one.box[1] >= other.box[3] or other.box[1] >= one.box[3], (one, other)


def test_the_hole_is_where_the_rays_do_not_reach(cloud, box):
    """The lowest ray meets the floor this far from the axis; the points scatter by a millimetre."""
    room = room_of(cloud, box)
    assert room.hole_m == pytest.approx(AT[2] / np.tan(np.radians(ELEVATION)), abs=0.01)
    np.testing.assert_allclose(room.stations, [[[0, 0, 0], [1, 0, 0]]], atol=1e-9)
    np.testing.assert_allclose(room.foot(np.zeros(3)), [0, 0, -AT[2]], atol=2e-3)
    assert room.axes[2].high - room.axes[2].low == pytest.approx(HEIGHT, abs=2e-3)


def test_what_is_not_known_is_not_written(cloud):
    """A cloud that was not turned has no angle 0; without dimensions none are written."""
    words = [label.words for label in room_picture(dataclasses.replace(cloud, angle=np.zeros(len(cloud.angle)))).labels]
    assert "0°" not in words and not any("hole" in text or "table" in text or "±" in text for text in words)
    assert "1 m on the floor, in the middle" in words


def test_no_point(cloud):
    assert room_picture(only(cloud, np.zeros_like(cloud.valid))).labels == ()


def test_one_point(cloud):
    one = np.zeros_like(cloud.valid)
    one[3, 4] = True
    assert room_picture(only(cloud, one)).rgb.shape[1] == 1600


@pytest.mark.more
def test_a_room_on_a_map_looks_the_same():
    """Pictures are drawn in single precision, of which 5 400 000 m leave half a metre."""
    local = made_room()
    place = np.array([356_000.0, 5_400_000.0, 300.0])
    pose = np.eye(4)
    pose[:3, 3] = place
    stations = Stations(np.zeros(len(local.valid), np.int32), pose[None], np.zeros((1, 6, 6)))
    xyz = np.where(local.valid[..., None], local.xyz.astype(np.float64) + place, 0.0)
    there = dataclasses.replace(local, xyz=xyz, stations=stations)
    pictures = [room_picture(one, measure_room(one)).rgb.astype(int) for one in (local, there)]
    assert pictures[0].shape == pictures[1].shape
    assert np.mean(np.abs(pictures[0] - pictures[1]).max(-1) > 8) < 0.01
