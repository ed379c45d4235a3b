"""Captures of boards whose codes are no levels of a sensor."""

import cv2
import numpy as np
import pytest

from jaxscan.files.capture import Capture, common_board, open_capture
from jaxscan.observation import Eyes, look_at_boards
from jaxscan.vision import find_corners, refit_corners, to_grey


def _doubts(tiny, monkeypatch, change):
    capture, plain = open_capture(tiny.boards), Capture.frames
    with monkeypatch.context() as patch:
        patch.setattr(Capture, "frames", lambda self, index: tuple(map(change, plain(self, index))))
        seen = look_at_boards(
            [capture], common_board([capture], single_lasers=True), Eyes(to_grey, find_corners, refit_corners)
        )
    return seen.doubts([capture])


def _gamma(image):
    return None if image is None else np.rint(255.0 * (image / 255.0) ** (1 / 2.2)).astype(np.uint8)


def _jpeg(image):
    if image is None:
        return None
    return cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 90])[1], cv2.IMREAD_UNCHANGED)


@pytest.mark.more
def test_boards_say_gamma_and_jpeg_once_with_their_capture(tiny, monkeypatch):
    assert _doubts(tiny, monkeypatch, lambda image: image) == ()
    (doubt,) = _doubts(tiny, monkeypatch, _gamma)
    assert doubt.startswith(f"{tiny.boards}: the noise falls") and "gamma" in doubt
    (doubt,) = _doubts(tiny, monkeypatch, _jpeg)
    assert "JPEG" in doubt and "PNG" in doubt
