"""The second look at a capture, on the pictures of the tiny rig."""

import json
import shutil

import numpy as np
import pytest

import jaxscan
from jaxscan.vision import encode_zstd, find_corners
from jaxscan.vision.zstd import decode_zstd

from .conftest import unsealed


pytestmark = pytest.mark.more


@pytest.fixture(scope="module")
def spoilt(tiny, tmp_path_factory):
    """The tiny rig's boards, one of which is half hidden in its last picture."""
    boards = unsealed(shutil.copytree(tiny.boards, tmp_path_factory.mktemp("spoilt") / "boards"))
    record = json.loads((boards / "frames.jsonl").read_text().splitlines()[-1])
    capture = jaxscan.open_capture(boards)
    off = decode_zstd((boards / record["off"]).read_bytes())
    middle = int(np.median(find_corners(off, capture.board).q[:, 0]))
    for kind in ("on", "off"):
        image = decode_zstd((boards / record[kind]).read_bytes()).copy()
        image[:, :middle] = 60
        (boards / record[kind]).write_bytes(encode_zstd(image))
    return jaxscan.open_capture(boards)


def test_a_board_that_was_missed_is_found_by_what_is_known_of_it(spoilt):
    seen = []
    result = jaxscan.calibrate(spoilt, progress=lambda done, total: seen.append((done, total)))
    brought = result.quality.redetected
    assert brought.kept
    assert brought.views_gained == 1 and result.quality.views == 21
    # Half of the 35 corners are hidden.
    assert 6 <= brought.corners_gained < 30
    # The gained points agree with the rest.
    assert brought.corner_rms_whitened_after < 1.05 * brought.corner_rms_whitened_before
    assert seen[-1][0] == seen[-1][1] > 0 and seen == sorted(seen)


def test_the_second_look_can_be_left_out(spoilt):
    result = jaxscan.calibrate(spoilt, redetect=False)
    assert result.quality.redetected is None
    assert result.quality.views == 20


@pytest.mark.slow
def test_the_camera_alone_is_looked_at_twice_too(tiny):
    result = jaxscan.calibrate(jaxscan.open_capture(tiny.boards), only_camera=True)
    brought = result.quality.redetected
    assert brought.views_gained == 0 and brought.stripe_points_gained == 0
