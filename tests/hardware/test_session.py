"""A sweep on the simulated desk: records taken, files written, and their order."""

import hashlib
import math

import numpy as np
import pytest
from scanrig.errors import Fault, FirmwareError, LinkLost, RigFault, SessionError
from scanrig.recording import AHEAD

from jaxscan.errors import CaptureError
from jaxscan.files.capture import open_capture, verify_capture

from .desk import Desk, events, journal, records


def test_a_sweep_is_a_capture_of_proven_pairs_at_the_planned_angles(tmp_path):
    desk, seen, progress = Desk(), [], []

    def on_pair(number, angle, on, off):
        # A pair that is handed out is on the disk, with its journal line; later ones may be there too.
        assert [line["i"] for line in journal(tmp_path / "room") if "i" in line][number] == number
        seen.append((number, angle, on, off))

    result = desk.sweep(tmp_path / "room", on_pair=on_pair, progress=lambda *counts: progress.append(counts))
    assert (result.status, result.records, result.planned, result.taken, result.retakes) == ("complete", 10, 10, 10, 0)
    assert result.laser_off and not desk.table.laser and not desk.table.contactor
    capture = open_capture(tmp_path / "room")
    np.testing.assert_allclose(capture.angles, np.radians(np.arange(10) * 3.6), atol=1e-12)
    for number, angle, on, off in seen:
        assert angle == pytest.approx(math.radians(3.6 * number))
        stored = capture.frames(number)
        assert np.array_equal(stored[0], on) and np.array_equal(stored[1], off)
        assert on.astype(int).max() - off.astype(int).max() > 50
    assert progress == [(k, 10) for k in range(1, 11)]
    # Ten steps, and the first again to close the pass.
    assert desk.controller.shots == [*(288 * k for k in range(10)), 0]
    assert verify_capture(tmp_path / "room") == []
    assert sorted(path.name for path in (tmp_path / "room").iterdir()) == ["capture.toml", "frames.jsonl", "off", "on"]


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """A desk after a sweep, and its capture."""
    desk, room = Desk(), tmp_path_factory.mktemp("swept") / "room"
    desk.sweep(room, calibration_digest="sha256:abc")
    return desk, room


def test_a_record_says_how_it_was_taken(swept):
    _, room = swept
    for k, record in enumerate(records(room)):
        assert (record["microsteps"], record["microsteps_per_turn"], record["retakes"]) == (288 * k, 28800, 0)
        assert record["exposure_s"] == 0.01
        assert record["frame_ids"] == [2 * k + 1, 2 * k + 2]
        assert record["time"].startswith("2000-01-01T00:00:")
        assert set(record["statistics"]) == {"lit_lines", "peak_dn", "saturated", "ambient_dn", "unrest"}
        assert 80 < record["statistics"]["peak_dn"] < 140 and record["statistics"]["lit_lines"] > 0.8
        for side in ("on", "off"):
            data = (room / record[side]).read_bytes()
            assert record["sha256"][side] == hashlib.sha256(data).hexdigest()
    times = [record["time_s"] for record in records(room)]
    assert times == sorted(times)


def test_the_journal_holds_the_session(swept):
    _, room = swept
    assert [line["event"] for line in journal(room) if "event" in line] == ["start", "home", "closing", "home", "end"]
    end = journal(room)[-1]
    before = b"".join((room / "frames.jsonl").read_bytes().splitlines(keepends=True)[:-1])
    assert end["status"] == "complete" and end["journal_sha256"] == hashlib.sha256(before).hexdigest()
    first, last = events(room, "home")
    assert (first["was"], "missed" in first) == (-500, False)
    assert (last["was"], last["missed"], last["good"]) == (0, 0, True)
    (closing,) = events(room, "closing")
    assert abs(closing["shift_px"]) < 0.1 and closing["correlation"] > 0.98 and closing["good"]


def test_the_end_holds_the_counters(swept):
    """Each switching wears the laser's switch: ten steps and the closing one; the link's losses show its wiring."""
    desk, room = swept
    end = journal(room)[-1]
    counted = {"damaged": 0, "overruns": 0, "repeated": 0, "laser_cycles": 11, "watchdog_resets": 0}
    assert 0 < end["controller"].pop("up_ms") <= 1000 * desk.clock.now()
    assert end["controller"] == counted
    assert end["link"]["sent"] > 30 and end["link"]["resent"] == 0
    # The question comes when everything is off, and after it nothing that could change that.
    assert desk.controller.log[-2:] == ["make_safe", "counters"]


def test_the_header_says_with_what_it_was_taken(swept):
    desk, room = swept
    header = open_capture(room).header
    said = header.acquisition
    assert said["config_sha256"] == desk.config.digest("sweep")
    assert said["camera"] == {"kind": "simulated", "model": "synthetic", "serial": "SIM1"}
    assert said["features"] == desk.camera.features()
    assert (said["firmware"], said["boot"], said["microsteps_per_turn"]) == ("9.9.9", 7, 28800)
    assert said["calibration"] == "sha256:abc"
    assert (header.plan.steps, header.turntable.carries, header.lasers[0].name) == (10, "scanner", "laser")


def test_each_pass_is_closed_and_begins_at_home(tmp_path):
    desk = Desk(sweep={"steps": 4, "turn_deg": 360.0, "turns": 3})
    result = desk.sweep(tmp_path / "room")
    assert result.status == "complete" and result.records == 12
    turn = [0, 7200, 14400, 21600, 0]
    assert desk.controller.shots == turn * 3
    assert [event["record"] for event in events(tmp_path / "room", "closing")] == [0, 4, 8]


def test_downwards_home_is_looked_for_from_above(tmp_path):
    desk = Desk(sweep={"steps": 4, "turn_deg": -180.0})
    positions = []
    home = desk.controller.home
    desk.controller.home = lambda *a: (positions.append(desk.table.position), home(*a))[1]
    assert desk.sweep(tmp_path / "room").status == "complete"
    assert desk.controller.shots == [0, -3600, -7200, -10800, 0]
    assert positions[1] > 0


def test_an_existing_capture_is_not_touched_without_resume(tmp_path):
    Desk().sweep(tmp_path / "room")
    before = (tmp_path / "room" / "frames.jsonl").read_bytes()
    desk = Desk()
    with pytest.raises(SessionError, match=r"holds a capture already; resume it, or choose another folder"):
        desk.sweep(tmp_path / "room")
    assert (tmp_path / "room" / "frames.jsonl").read_bytes() == before and desk.controller.log == []


def test_a_folder_with_anything_else_is_not_touched(tmp_path):
    (tmp_path / "room").mkdir()
    (tmp_path / "room" / "thesis.txt").write_text("all of it")
    desk = Desk()
    with pytest.raises(CaptureError, match="exists and is not empty"):
        desk.sweep(tmp_path / "room", resume=True)
    assert [path.name for path in (tmp_path / "room").iterdir()] == ["thesis.txt"]
    assert desk.controller.log[-2:] == ["make_safe", "counters"]


def test_a_folder_that_cannot_be_written_is_one_clear_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(SessionError, match=r"file/room: cannot be created: Not a directory"):
        Desk().sweep(tmp_path / "file" / "room")


def test_without_a_rig_no_folder_is_left(tmp_path):
    desk = Desk()
    desk.controller.estop = True
    result = desk.sweep(tmp_path / "room")
    assert result.status == "e-stop" and "release" in result.message and not (tmp_path / "room").exists()


@pytest.mark.parametrize("trigger", ["hardware", "software", "free"])
def test_with_every_trigger_pairs_are_good_and_handed_out_with_the_laser_off(tmp_path, trigger):
    desk, lit = Desk(camera={"trigger": trigger}), []
    result = desk.sweep(tmp_path / "room", on_pair=lambda *pair: lit.append(desk.table.laser))
    assert (result.status, result.records, result.retakes) == ("complete", 10, 0)
    assert lit == [False] * 10 and bool(desk.controller.shots) is (trigger == "hardware")
    capture = open_capture(tmp_path / "room")
    np.testing.assert_allclose(capture.angles, np.radians(np.arange(10) * 3.6), atol=1e-12)
    for k in range(10):
        on, off = capture.frames(k)
        assert on.astype(int).max() - off.astype(int).max() > 50


def test_what_a_viewer_raises_ends_the_session_safely_and_loses_nothing(tmp_path):
    desk = Desk()

    def on_pair(number, angle, on, off):
        if number == 3:
            raise RuntimeError("the window was closed")

    with pytest.raises(RuntimeError, match="window"):
        desk.sweep(tmp_path / "room", on_pair=on_pair)
    # The pairs that were in flight are stored too.
    assert 4 <= len(open_capture(tmp_path / "room")) <= 4 + AHEAD and not desk.table.contactor
    assert journal(tmp_path / "room")[-1]["status"] == "failed"
    assert Desk().sweep(tmp_path / "room", resume=True).status == "complete"
    assert len(open_capture(tmp_path / "room")) == 10


def test_a_laser_that_cannot_be_confirmed_off_is_reported(tmp_path):
    desk = Desk()
    desk.controller.never_safe = True
    result = desk.sweep(tmp_path / "room")
    assert not result.laser_off and "switch its supply off by hand" in result.message
    assert any("switch its supply off by hand" in sentence for sentence in desk.said)
    assert journal(tmp_path / "room")[-1]["laser_off"] is False
    # With the error, too.
    desk.table.dead = True
    with pytest.raises(Exception, match=r"laser is dark.*switch its supply off by hand"):
        desk.sweep(tmp_path / "other")


@pytest.mark.parametrize("problem", [LinkLost("gone"), FirmwareError("lacks 'las'"), RigFault(Fault.EMERGENCY_STOP, 0)])
def test_counters_that_cannot_be_asked_for_are_left_out(tmp_path, problem):
    desk = Desk()

    def fails():
        raise problem

    desk.controller.counters = fails
    assert desk.sweep(tmp_path / "room").status == "complete"
    end = journal(tmp_path / "room")[-1]
    assert "controller" not in end and "link" in end and end["laser_off"] is True


def test_a_controller_that_is_gone_is_not_asked_what_it_counted(tmp_path):
    desk = Desk()
    desk.controller.before_shot[3] = lambda controller: controller.lose_link(attempts=1000)
    with pytest.raises(LinkLost):
        desk.sweep(tmp_path / "room")
    end = journal(tmp_path / "room")[-1]
    assert (end["status"], end["laser_off"]) == ("failed", False) and "controller" not in end and "link" in end
    assert "counters" not in desk.controller.log
