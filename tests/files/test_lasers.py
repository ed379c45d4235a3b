"""Several lasers lit in one record: fine in a sweep, not in a calibration."""

import pytest

from jaxscan.api import observe_boards
from jaxscan.errors import CalibrationError, CaptureError
from jaxscan.files.capture import open_capture

from .conftest import BOARD, LASER


def test_a_calibration_needs_one_laser_per_record(folder, monkeypatch):
    folder.header(kind="calibration", rest=LASER + '[[laser]]\nname = "green"\n' + BOARD)
    folder.record(0, lasers=["green"])
    folder.record(1, on=None)
    folder.record(2)
    capture = open_capture(folder.path)
    with pytest.raises(CaptureError, match=r"record 2: several lasers are lit at once \(red, green\)") as caught:
        observe_boards([capture])
    assert "\n" not in str(caught.value)
    # Corners alone do not ask for lasers.
    monkeypatch.setattr("jaxscan.vision.find_corners", lambda image, board: None)
    with pytest.raises(CalibrationError, match="found in none of 3 records"):
        observe_boards([capture], with_stripes=False)
