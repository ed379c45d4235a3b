"""A calibration and its observations are bound by digests, and a value changed by hand is noticed."""

import json

import pytest

from jaxscan.errors import CalibrationError
from jaxscan.files.calibration import calibration_notes, load_calibration, load_scanner, save_calibration
from jaxscan.geometry import Chessboard

from .test_calibration import make_calibration, make_observations


@pytest.fixture
def path(tmp_path):
    save_calibration(make_calibration(observations=make_observations()), tmp_path / "c.json")
    return tmp_path / "c.json"


def changed(path, change):
    data = json.loads(path.read_text())
    change(data)
    path.write_text(json.dumps(data))


def test_observations_of_another_calibration_are_refused(path, tmp_path):
    load_calibration(path)
    (tmp_path / "other").mkdir()
    board = Chessboard(columns=4, rows=3, square=0.03)
    save_calibration(make_calibration(observations=make_observations(board)), tmp_path / "other" / "c.json")
    data = path.with_suffix(".npz").read_bytes()
    at = len(data) // 2
    foreign = (tmp_path / "other" / "c.npz").read_bytes()
    flipped = data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :]
    for other in (foreign, data[:at], b"", b"no archive", flipped):
        path.with_suffix(".npz").write_bytes(other)
        ours = r"the observations beside c\.json belong to another"
        message = ours if other is foreign else "(the observations are damaged|not a readable)"
        with pytest.raises(CalibrationError, match=rf"c\.npz: {message}") as caught:
            load_calibration(path)
        assert "\n" not in str(caught.value)
        # A reconstruction needs the JSON alone.
        load_scanner(path)
        assert calibration_notes(path) == []
    path.with_suffix(".npz").unlink()
    assert load_calibration(path).observations is None


def test_a_value_changed_by_hand_is_noted(path):
    assert calibration_notes(path) == []
    # The same values, set in another way.
    changed(path, lambda data: None)
    assert calibration_notes(path) == []

    def longer(data):
        data["camera"]["fx"] *= 1.01

    changed(path, longer)
    (note,) = calibration_notes(path)
    assert "have changed since jaxscan calibrate wrote it" in note
    load_scanner(path)
    # As the note says.
    changed(path, lambda data: data.pop("digests"))
    assert calibration_notes(path) == []


@pytest.mark.parametrize("kept", [{}, {"values": None, "observations": None}])
def test_older_files_without_digests_stay_readable(path, kept):
    changed(path, lambda data: data.update(digests=kept))
    assert load_calibration(path).observations is not None and calibration_notes(path) == []
