"""Resuming a sweep: files verified, changes refused, records taken again."""

import json
import shutil

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scanrig.cameras import CameraIdentity
from scanrig.cameras.simulated import SyntheticScene
from scanrig.errors import CameraError, SessionError

from jaxscan.files.capture import open_capture, verify_capture

from .desk import After, Desk, events, journal


def interrupted(folder, steps=6, **tables):
    desk = Desk(**tables)
    result = desk.sweep(folder, should_stop=After(steps))
    assert (result.status, result.records) == ("interrupted", steps)
    return desk


@pytest.fixture(scope="module")
def six(tmp_path_factory):
    """A capture that was interrupted after six of ten steps. Copy, do not change."""
    folder = tmp_path_factory.mktemp("six") / "room"
    interrupted(folder)
    return folder


@pytest.fixture
def room(six, tmp_path):
    return shutil.copytree(six, tmp_path / "room")


def test_an_interrupted_sweep_is_sealed_and_goes_on(tmp_path):
    desk = interrupted(tmp_path / "room")
    assert not desk.table.contactor and verify_capture(tmp_path / "room") == []
    assert journal(tmp_path / "room")[-1]["status"] == "interrupted"
    again = Desk()
    result = again.sweep(tmp_path / "room", resume=True)
    assert (result.status, result.records, result.taken) == ("complete", 10, 4)
    # The last one again, to compare; the four that were missing; the first, to close the pass.
    assert again.controller.shots == [288 * 5, 288 * 6, 288 * 7, 288 * 8, 288 * 9, 0]
    assert events(tmp_path / "room", "compared")[0]["record"] == 5
    assert verify_capture(tmp_path / "room") == []
    np.testing.assert_allclose(open_capture(tmp_path / "room").angles, np.radians(np.arange(10) * 3.6))


def test_a_complete_capture_says_so_and_nothing_moves(tmp_path):
    Desk().sweep(tmp_path / "room")
    before = (tmp_path / "room" / "frames.jsonl").read_bytes()
    desk = Desk()
    result = desk.sweep(tmp_path / "room", resume=True)
    assert result.status == "complete" and "is complete already, 10 records" in result.message and result.taken == 0
    assert desk.controller.log == [] and (tmp_path / "room" / "frames.jsonl").read_bytes() == before


def test_where_nothing_is_resuming_begins(tmp_path):
    desk = Desk()
    assert desk.sweep(tmp_path / "room", resume=True).records == 10
    assert any("no capture to resume" in sentence for sentence in desk.said)


def test_resuming_between_the_last_step_and_the_end_only_closes(room):
    desk = Desk()
    result = desk.sweep(room, resume=True, should_stop=After(4))
    assert (result.status, result.records) == ("interrupted", 10)
    again = Desk()
    result = again.sweep(room, resume=True)
    assert (result.status, result.taken) == ("complete", 0)


# 21 power loss


def require_resumed(room):
    lines = (room / "frames.jsonl").read_bytes().split(b"\n")
    kept = sum(b'"i"' in line and line.endswith(b"}}") for line in lines)
    result = Desk().sweep(room, resume=True)
    assert (result.status, result.records) == ("complete", 10)
    # Records with a whole line were not taken again.
    assert result.taken == 10 - kept
    assert verify_capture(room) == [] and len(open_capture(room)) == 10


def test_21_what_a_crash_left_half_written_is_removed(room):
    (room / "on" / ".part-0123456789ab.zst").write_bytes(b"half")
    (room / ".part-ba9876543210.toml").write_bytes(b"half")
    Desk().sweep(room, resume=True)
    assert not list(room.rglob(".part-*"))


# 22 silent corruption


@pytest.mark.parametrize("harm", ["flip", "delete", "truncate"])
def test_22_a_damaged_frame_is_found_and_its_record_taken_again(room, harm):
    path = room / "off" / "000002.zst"
    data = bytearray(path.read_bytes())
    if harm == "delete":
        path.unlink()
    else:
        data[len(data) // 2] ^= 4
        path.write_bytes(data if harm == "flip" else data[:-100])
    assert [problem.record for problem in verify_capture(room)] == [2]
    desk = Desk()
    result = desk.sweep(room, resume=True)
    assert (result.status, result.taken) == ("complete", 5)
    assert desk.controller.shots == [288 * 5, 288 * 2, 288 * 6, 288 * 7, 288 * 8, 288 * 9, 0]
    assert verify_capture(room) == []
    assert events(room, "damaged")[0]["record"] == 2


def test_22_damage_in_a_complete_capture_is_repaired(tmp_path):
    Desk().sweep(tmp_path / "room")
    (tmp_path / "room" / "on" / "000007.zst").unlink()
    desk = Desk()
    result = desk.sweep(tmp_path / "room", resume=True)
    assert (result.status, result.taken) == ("complete", 1)
    assert verify_capture(tmp_path / "room") == []


def test_22_a_journal_that_was_changed_is_refused_before_anything_moves(room):
    """Angles have no digest of their own; the seal at the end of each session covers them."""
    text = (room / "frames.jsonl").read_text()
    changed = text.replace('"angle_deg": 3.6', '"angle_deg": 8.6', 1)
    (room / "frames.jsonl").write_text(changed)
    desk = Desk()
    with pytest.raises(SessionError, match="the seal does not fit the lines before it; the capture cannot be continue"):
        desk.sweep(room, resume=True)
    assert desk.controller.log == [] and (room / "frames.jsonl").read_text() == changed
    # The cure that the message names.
    lines = [line for line in changed.splitlines(True) if "journal_sha256" not in line]
    (room / "frames.jsonl").write_text("".join(lines))
    assert Desk().sweep(room, resume=True).status == "complete"
    assert len(open_capture(room)) == 10
    well = Desk()
    well.sweep(room.parent / "other")
    well.sweep(room.parent / "other", resume=True)
    assert not any("seal" in sentence for sentence in well.said)


def test_22_the_damaged_record_was_the_last_one(room):
    (room / "on" / "000005.zst").unlink()
    desk = Desk()
    assert desk.sweep(room, resume=True).taken == 5
    assert desk.controller.shots[0] == 288 * 4


# 26 something changed


@pytest.mark.parametrize(
    ("tables", "said"),
    [
        ({"sweep": {"steps": 12}}, r"sweep.steps: was 10, is 12"),
        ({"sweep": {"turn_deg": 72.0}}, r"sweep.turn_deg: was 36.0, is 72.0"),
        ({"turntable": {"gear": [10, 1]}}, r"turntable.gear\[0\]: was 9, is 10"),
        ({"turntable": {"carries": "object"}}, r'turntable.carries: was "scanner", is "object"'),
        ({"camera": {"exposure_ms": 20.0}}, r"camera.exposure_ms: was 10.0, is 20.0"),
        ({"laser": [{"name": "green"}]}, r'laser\[0\].name: was "laser", is "green"'),
    ],
)
def test_26_a_changed_configuration_is_refused_with_what_changed(room, tables, said):
    before = (room / "frames.jsonl").read_bytes()
    desk = Desk(**tables)
    with pytest.raises(SessionError, match=said):
        desk.sweep(room, resume=True)
    assert desk.controller.log == [] and (room / "frames.jsonl").read_bytes() == before


@pytest.mark.parametrize(
    "tables", [{"checks": {"retakes": 7}}, {"controller": {"port": "/dev/ttyACM3"}}, {"calibration": {"free_views": 3}}]
)
def test_26_what_the_frames_do_not_depend_on_may_change(room, tables):
    assert Desk(**tables).sweep(room, resume=True).status == "complete"


def test_26_another_calibration_is_refused(tmp_path):
    Desk().sweep(tmp_path / "room", should_stop=After(3), calibration_digest="sha256:" + "a" * 64)
    with pytest.raises(SessionError, match=r"calibration: was sha256:a.*is sha256:b"):
        Desk().sweep(tmp_path / "room", resume=True, calibration_digest="sha256:" + "b" * 64)
    done = Desk().sweep(tmp_path / "room", resume=True, calibration_digest="sha256:" + "a" * 64)
    assert done.status == "complete"


def header(*changes):
    """Changes the text of a capture's header."""

    def change(room):
        text = (room / "capture.toml").read_text()
        for old, new in changes:
            assert old in text
            text = text[: text.index(old)] if new is None else text.replace(old, new, 1)
        (room / "capture.toml").write_text(text)

    return change


def acquired(line):
    return header(("[acquisition]\n", f"[acquisition]\n{line}\n"))


def acquired_instead(key):
    """A number in the place of a table."""

    def change(room):
        text = (room / "capture.toml").read_text()
        start = text.index(f"[acquisition.{key}]")
        text = text[:start] + text[text.index("\n[", start) :]
        (room / "capture.toml").write_text(text.replace("[acquisition]\n", f"[acquisition]\n{key} = 3\n", 1))

    return change


def event(**fields):
    def change(room):
        with open(room / "frames.jsonl", "a") as file:
            file.write(json.dumps(fields) + "\n")

    return change


def placed_at(microsteps):
    def change(room):
        lines = [{**one, "microsteps": microsteps} if one.get("i") == 5 else one for one in journal(room)]
        (room / "frames.jsonl").write_text("".join(json.dumps(one) + "\n" for one in lines))

    return change


BOARD = '\n[board]\ntype = "chessboard"\ncolumns = 5\nrows = 4\nsquare_mm = 30.0\n'
HARM = {
    "kind": (
        header(('kind = "sweep"', 'kind = "calibration"'), ("\n[camera]", BOARD + "[camera]")),
        "kind calibration",
    ),
    "elsewhere": (header(("[acquisition", None)), "was not captured by this program"),
    "camera": (header(("[acquisition.camera]", "[[acquisition.camera]]")), "acquisition.camera = "),
    "features": (header(("[acquisition.features]", "[acquisition.features]\nodd = [1]")), "acquisition.features = "),
    "calibration": (acquired("calibration = 3"), "acquisition.calibration = "),
    "terminal": (acquired('calibration = "\\u001b[2J"'), "acquisition.calibration = "),
    "microsteps": (placed_at(1.5), "microsteps of record 5 = "),
    "no microsteps": (placed_at(None), "microsteps of record 5 = "),
    "words for microsteps": (placed_at("x"), "microsteps of record 5 = "),
    "a truth for microsteps": (placed_at(True), "microsteps of record 5 = "),
    "camera's number": (acquired_instead("camera"), "acquisition.camera = "),
    "features' number": (acquired_instead("features"), "acquisition.features = "),
    "nothing suspect": (event(event="suspect"), "which no session writes"),
    "a number suspect": (event(event="suspect", records=3), "which no session writes"),
    "suspect": (event(event="suspect", records=[["a", "b"]]), "which no session writes"),
    "run": (event(event="suspect", records=[[0]]), "which no session writes"),
    "placed": (event(event="placed", placement=None), "which no session writes"),
    "placed nowhere": (event(event="placed"), "which no session writes"),
    "placed in words": (event(event="placed", placement="x"), "which no session writes"),
}


@pytest.mark.timeout(30)
@pytest.mark.parametrize("harm", HARM)
def test_26_what_no_session_of_this_rig_writes_is_one_clear_error(room, harm):
    change, says = HARM[harm]
    change(room)
    desk = Desk()
    with pytest.raises(SessionError, match=says) as refused:
        desk.sweep(room, resume=True)
    assert str(refused.value).isprintable() and desk.controller.shots == []


def test_26_a_camera_that_is_another_or_set_otherwise_is_refused(room):
    desk = Desk()
    desk.camera.device["gain_db"] = 6.0
    with pytest.raises(CameraError, match="gain_db: found 6, expected 0"):
        desk.sweep(room, resume=True)
    desk.camera.identity = CameraIdentity("simulated", "synthetic", "SIM2")
    with pytest.raises(SessionError, match=r'another camera \(serial: was "SIM1", is "SIM2"\)'):
        desk.sweep(room, resume=True)
    assert desk.controller.shots == [] and not desk.table.contactor


@pytest.mark.timeout(30)
def test_26_a_run_of_suspect_records_has_no_end(room):
    """As many numbers as somebody likes to write; of them only those of records mean anything."""
    with open(room / "frames.jsonl", "a") as file:
        file.write(json.dumps({"event": "suspect", "records": [[4, 10**12]]}) + "\n")
    result = Desk().sweep(room, resume=True)
    assert (result.status, result.taken) == ("complete", 6)


def test_26_a_record_may_say_that_it_has_no_placement(room):
    lines = journal(room)
    text = "".join(json.dumps({**one, "placement": None} if "i" in one else one) + "\n" for one in lines[:-1])
    (room / "frames.jsonl").write_text(text)
    assert Desk().sweep(room, resume=True).status == "complete"


# The rig has moved


def test_a_camera_that_was_knocked_in_the_pause_is_refused(room):
    desk = Desk()
    desk.table.moved_px = 4
    with pytest.raises(SessionError, match=r"record 5, taken again, has changed: the line moved \+4"):
        desk.sweep(room, resume=True)
    assert len(open_capture(room)) == 6 and not desk.table.contactor
    assert Desk().sweep(room, resume=True).status == "complete"


def test_lamps_that_were_switched_off_in_the_pause_do_no_harm(room):
    desk = Desk(scene=SyntheticScene(ambient_dn=12.0))
    assert desk.sweep(room, resume=True).status == "complete"


def test_a_controller_that_lived_on_tells_of_steps_that_were_lost_before(tmp_path):
    desk = interrupted(tmp_path / "room")
    desk.table.position -= 50
    result = desk.sweep(tmp_path / "room", resume=True)
    # All six were taken since the last good home, and are taken again in the same session.
    assert (result.status, result.taken, result.suspect) == ("complete", 10, ())
    (event,) = events(tmp_path / "room", "suspect")
    assert event["records"] == [[0, 5]] and event["missed"] == 50


def test_a_controller_that_was_reset_in_the_pause_says_nothing_of_lost_steps(room):
    desk = Desk()
    assert desk.sweep(room, resume=True).status == "complete"
    assert events(room, "suspect") == []


@pytest.mark.more
def test_21_a_journal_torn_at_every_byte_resumes(six, tmp_path):
    """Power is lost while the journal's last lines are written."""
    data = (six / "frames.jsonl").read_bytes()
    start = data.rindex(b'{"i": 5')
    end = len(data)
    # Every byte of the last record, and of the events after it; each cut is a session of its own, so not all at once.
    for cut in range(start, end, 41):
        room = shutil.copytree(six, tmp_path / f"cut{cut}")
        (room / "frames.jsonl").write_bytes(data[:cut])
        require_resumed(room)
        shutil.rmtree(room)


@pytest.mark.slow
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_21_a_journal_torn_anywhere_resumes(six, tmp_path, data):
    journal_bytes = (six / "frames.jsonl").read_bytes()
    cut = data.draw(st.integers(0, len(journal_bytes)))
    room = tmp_path / "room"
    shutil.rmtree(room, ignore_errors=True)
    shutil.copytree(six, room)
    (room / "frames.jsonl").write_bytes(journal_bytes[:cut])
    require_resumed(room)
