"""Captures of linear stages and of scanners that stand still; their calibrations are in `test_calibration_by_hand`."""

import json

import numpy as np
import pytest

import jaxscan
from jaxscan.errors import CaptureError

from .conftest import LASER, header, refused


def moved_by(folder, carries, kind="sweep", rest=LASER):
    folder.header(kind=kind, rest=rest)
    text = (folder.path / "capture.toml").read_text()
    (folder.path / "capture.toml").write_text(text.replace('"scanner"', f'"{carries}"'))


def edited(folder, index, **changes):
    """The line of a record, with keys changed or (None) taken away."""
    record = json.loads(folder.lines[index]) | changes
    folder.lines[index] = json.dumps({key: value for key, value in record.items() if value is not None})
    (folder.path / "frames.jsonl").write_text("\n".join(folder.lines) + "\n")


def test_positions_of_a_linear_stage(folder):
    moved_by(folder, "linear")
    for i in range(3):
        folder.record(i)
        edited(folder, i, angle_deg=None, position_m=0.25 * i)
    sweep = jaxscan.open_capture(folder.path)
    assert sweep.carries == "linear" and sweep.notes == ()
    np.testing.assert_array_equal(sweep.angles, [0.0, 0.25, 0.5])


def test_a_scanner_that_stands_still_has_no_angles(folder):
    moved_by(folder, "nothing")
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
    moved_by(folder, carries)
    folder.record(0, angle_deg=1.0)
    edited(folder, 0, **changes)
    refused(CaptureError, lambda: jaxscan.open_capture(folder.path), message)


def test_a_written_linear_sweep(tmp_path):
    frame = np.zeros((4, 6), np.uint8)
    with jaxscan.create_capture(tmp_path / "c", header(turntable={"carries": "linear"})) as writer:
        writer.append(position_m=0.1, on=frame)
        with pytest.raises(CaptureError, match="a sweep needs position_m and a laser-on image"):
            writer.append(angle_deg=3.0, on=frame)
        writer.append(position_m=0.2, on=frame)
    np.testing.assert_array_equal(jaxscan.open_capture(tmp_path / "c").angles, [0.1, 0.2])
