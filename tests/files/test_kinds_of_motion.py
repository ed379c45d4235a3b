"""Captures and calibrations of linear stages and of scanners that stand still."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

import jaxscan
from jaxscan.errors import CalibrationError, CaptureError


GUIDE = Path(__file__).resolve().parents[2] / "docs" / "captures.md"
LASER = '[[laser]]\nname = "red"\n'


def header(folder, carries, kind="sweep", rest=LASER):
    folder.header(kind=kind, rest=rest)
    text = (folder.path / "capture.toml").read_text()
    (folder.path / "capture.toml").write_text(text.replace('"scanner"', f'"{carries}"'))


def edited(folder, index, **changes):
    """The line of a record, with keys changed or (None) taken away."""
    record = json.loads(folder.lines[index]) | changes
    folder.lines[index] = json.dumps({key: value for key, value in record.items() if value is not None})
    (folder.path / "frames.jsonl").write_text("\n".join(folder.lines) + "\n")


def test_positions_of_a_linear_stage(folder):
    header(folder, "linear")
    for i in range(3):
        folder.record(i)
        edited(folder, i, angle_deg=None, position_m=0.25 * i)
    sweep = jaxscan.open_capture(folder.path)
    assert sweep.carries == "linear" and sweep.notes == ()
    np.testing.assert_array_equal(sweep.angles, [0.0, 0.25, 0.5])


def test_a_scanner_that_stands_still_has_no_angles(folder):
    header(folder, "nothing")
    for i in range(2):
        folder.record(i)
        edited(folder, i, angle_deg=None)
    sweep = jaxscan.open_capture(folder.path)
    assert sweep.carries == "nothing"
    np.testing.assert_array_equal(sweep.angles, [0.0, 0.0])


@pytest.mark.parametrize(
    ("carries", "changes", "message"),
    [
        ("linear", {}, "line 1: position_m: missing beside angle_deg"),
        ("linear", {"angle_deg": None}, "line 1: position_m: found null, but a sweep needs the position"),
        ("linear", {"angle_deg": None, "position_m": "far"}, "line 1: position_m: found"),
        ("linear", {"angle_deg": None, "position_m": 1e9}, "line 1: position_m: found"),
        ("scanner", {"angle_deg": None, "position_m": 0.1}, "line 1: angle_deg: missing beside position_m"),
        ("scanner", {"angle_deg": None}, "line 1: angle_deg: found null, but a sweep needs the angle"),
    ],
)
def test_records_of_another_motion(folder, carries, changes, message):
    header(folder, carries)
    folder.record(0, angle_deg=1.0)
    edited(folder, 0, **changes)
    with pytest.raises(CaptureError) as caught:
        jaxscan.open_capture(folder.path)
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_a_written_linear_sweep(tmp_path):
    head = jaxscan.CaptureHeader(
        kind="sweep",
        camera={"width": 6, "height": 4, "pixel_format": "mono8"},
        turntable={"carries": "linear"},
        laser={"name": "red"},
    )
    frame = np.zeros((4, 6), np.uint8)
    with jaxscan.create_capture(tmp_path / "c", head) as writer:
        writer.append(position_m=0.1, on=frame)
        with pytest.raises(CaptureError, match="a sweep needs a position_m and a laser-on image"):
            writer.append(angle_deg=3.0, on=frame)
        writer.append(position_m=0.2, on=frame)
    np.testing.assert_array_equal(jaxscan.open_capture(tmp_path / "c").angles, [0.1, 0.2])


@pytest.fixture
def by_hand(tmp_path):
    """The calibration of the guide with another motion."""

    def write(turntable, **changes):
        (text,) = re.findall(r"```json\n(.*?)```", GUIDE.read_text(), re.DOTALL)
        data = json.loads(text) | {"turntable": turntable} | changes
        data = {key: value for key, value in data.items() if value is not None}
        (tmp_path / "hand.json").write_text(json.dumps(data))
        return tmp_path / "hand.json"

    return write


def test_a_profile_scanner_by_hand(by_hand, tmp_path):
    scanner = jaxscan.load_scanner(by_hand(None))
    assert isinstance(scanner.turntable, jaxscan.Still)
    point, incidence = scanner.point(np.array([1200.0, 800.0]), 0, np.asarray(0.0))
    assert incidence > 0
    # The design's point of the paper's rig, camera frame.
    np.testing.assert_allclose(point, [0.155163, -0.014657, 2.451674], atol=2e-6)
    jaxscan.save_calibration(jaxscan.load_calibration(by_hand(None)), tmp_path / "again.json")
    assert "turntable" not in json.loads((tmp_path / "again.json").read_text())
    assert isinstance(jaxscan.load_scanner(tmp_path / "again.json").turntable, jaxscan.Still)


def test_a_linear_stage_by_hand(by_hand, tmp_path):
    scanner = jaxscan.load_scanner(by_hand({"carries": "linear", "direction": [0.0, 3.0, 4.0]}))
    stage = scanner.turntable
    assert isinstance(stage, jaxscan.LinearStage)
    np.testing.assert_allclose(stage.direction, [0.0, 0.6, 0.8], atol=1e-15)
    still, moved = (scanner.point(np.array([1200.0, 800.0]), 0, np.asarray(s))[0] for s in (0.0, 0.5))
    np.testing.assert_allclose(moved - still, [0.0, 0.3, 0.4], atol=1e-12)
    # A stage that counts the other way.
    back = jaxscan.load_scanner(by_hand({"carries": "linear", "direction": [0.0, 3.0, 4.0], "gain": -1.0})).turntable
    np.testing.assert_allclose(back.direction, [0.0, -0.6, -0.8], atol=1e-15)
    jaxscan.save_calibration(jaxscan.load_calibration(tmp_path / "hand.json"), tmp_path / "again.json")
    again = jaxscan.load_scanner(tmp_path / "again.json").turntable
    assert np.asarray(again.direction).tobytes() == np.asarray(back.direction).tobytes()


@pytest.mark.parametrize(
    ("turntable", "message"),
    [
        ({"carries": "linear"}, "turntable.direction: missing"),
        ({"carries": "linear", "direction": [0, 0, 0]}, "turntable: direction: found [0.0, 0.0, 0.0]"),
        ({"carries": "linear", "direction": [1, 0, 0], "gain": 0}, "turntable: gain = 0"),
        ({"carries": "linear", "direction": [1, 0, 0], "point_m": [0, 0, 0]}, "turntable.point_m: unknown key"),
        ({"carries": "sideways", "direction": [1, 0, 0], "point_m": [0, 0, 0]}, 'turntable.carries: found "sideways"'),
        ([], "turntable: found"),
    ],
)
def test_motions_that_cannot_be_meant(by_hand, turntable, message):
    with pytest.raises(CalibrationError) as caught:
        jaxscan.load_scanner(by_hand(turntable))
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_parts_that_cannot_reconstruct(by_hand):
    table = {"direction": [0.0, -1.0, 0.0], "point_m": [0.0, 0.0, -0.2]}
    for turntable, words in ((None, "holds a camera alone"), (table, "holds camera and axis")):
        path = by_hand(turntable, lasers=None)
        with pytest.raises(CalibrationError) as caught:
            jaxscan.load_scanner(path)
        assert f"{words}, without a laser sheet, so it cannot reconstruct" in str(caught.value)
        assert jaxscan.load_calibration(path).camera.width == 2048
