"""The folder and the disk: permission to write, and a full disk."""

import errno
import json
import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scanrig import recording
from scanrig.clock import Clock
from scanrig.errors import SessionError
from scanrig.recording import LOCK_NAME, Ledger, folder_lock

from jaxscan.errors import CaptureError
from jaxscan.files import recording as captures
from jaxscan.files.capture import CaptureHeader, open_capture, verify_capture

from .desk import Desk, journal


def require_safe_and_whole(folder, desk, records):
    assert not desk.table.laser and not desk.table.contactor
    assert len(open_capture(folder)) == records and verify_capture(folder) == []
    assert not list(folder.rglob(".part-*"))


# 20 disk full


def test_20_too_little_space_is_said_before_anything_moves(tmp_path, monkeypatch):
    monkeypatch.setattr(recording, "free_bytes", lambda folder: 100_000)
    desk = Desk()
    result = desk.sweep(tmp_path / "room")
    # 20 frames of 128 x 96 px and a tenth more.
    assert result.status == "disk full" and "needs 0.3 MB" in result.message and "then resume" in result.message
    assert desk.controller.shots == [] and not (tmp_path / "room").exists()


def test_20_space_that_goes_while_the_sweep_runs(tmp_path, monkeypatch):
    desk, free = Desk(), [10**9]
    monkeypatch.setattr(recording, "free_bytes", lambda folder: free[0])
    desk.controller.before_shot[4] = lambda controller: free.__setitem__(0, 40_000)
    result = desk.sweep(tmp_path / "room")
    assert (result.status, result.records) == ("disk full", 4)
    assert "make room, then resume the capture" in result.message
    require_safe_and_whole(tmp_path / "room", desk, 4)
    assert journal(tmp_path / "room")[-1]["status"] == "disk full"
    free[0] = 10**9
    assert Desk().sweep(tmp_path / "room", resume=True).status == "complete"


@pytest.fixture
def small_disk(tmp_path):
    """A real file system of 1 MB."""
    place = tmp_path / "disk"
    place.mkdir()
    if (
        os.geteuid() != 0
        or subprocess.run(
            ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(place)], capture_output=True
        ).returncode
    ):
        pytest.skip("a small file system needs the right to mount one")
    yield place
    subprocess.run(["umount", str(place)], check=True)


def test_20_a_real_disk_that_fills_up(small_disk, monkeypatch):
    """The check of free space is given a false value, so that the disk itself must refuse."""
    desk = Desk(sweep={"steps": 100, "turn_deg": 360.0})
    monkeypatch.setattr(recording, "free_bytes", lambda folder: 10**12)
    result = desk.sweep(small_disk / "room")
    assert result.status == "disk full" and 10 < result.records < 100
    require_safe_and_whole(small_disk / "room", desk, result.records)
    # Room is made where something else was; here, by a bigger disk.
    subprocess.run(["mount", "-o", "remount,size=16m", str(small_disk)], check=True)
    monkeypatch.undo()
    again = Desk(sweep={"steps": 100, "turn_deg": 360.0})
    assert again.sweep(small_disk / "room", resume=True).status == "complete"
    require_safe_and_whole(small_disk / "room", again, 100)


def test_20_a_real_disk_that_is_too_small_is_said_first(small_disk):
    desk = Desk(sweep={"steps": 100, "turn_deg": 360.0})
    assert desk.sweep(small_disk / "room").status == "disk full"
    assert desk.controller.shots == []


@pytest.mark.parametrize(
    ("name", "code"),
    [
        ("on/000003.zst", errno.ENOSPC),
        ("off/000003.zst", errno.ENOSPC),
        ("on/000003.zst", errno.EIO),
        ("on/000003.zst", errno.EROFS),
    ],
)
def test_20_a_write_that_fails(tmp_path, monkeypatch, name, code):
    original = captures.write_atomically

    def failing(path, content, **keys):
        if str(path).endswith(name):

            def content(part):
                part.write_bytes(b"the first half")
                raise OSError(code, os.strerror(code))

        original(path, content, **keys)

    desk = Desk()
    monkeypatch.setattr(captures, "write_atomically", failing)
    if code == errno.ENOSPC:
        result = desk.sweep(tmp_path / "room")
        assert (result.status, result.records) == ("disk full", 3) and "No space left" in result.message
    else:
        with pytest.raises(CaptureError, match=os.strerror(code)):
            desk.sweep(tmp_path / "room")
    require_safe_and_whole(tmp_path / "room", desk, 3)
    monkeypatch.undo()
    assert Desk().sweep(tmp_path / "room", resume=True).status == "complete"
    require_safe_and_whole(tmp_path / "room", desk, 10)


@pytest.fixture
def sealed_folder(tmp_path):
    """A folder that this user may not write to, whoever it is."""
    place = tmp_path / "sealed"
    place.mkdir()
    if os.geteuid() != 0:
        place.chmod(0o555)
        yield place
        place.chmod(0o755)
        return
    if subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "ro,size=1m", "tmpfs", str(place)], capture_output=True
    ).returncode:
        pytest.skip("root may write everywhere, unless it may mount")
    yield place
    subprocess.run(["umount", str(place)], check=True)


@pytest.mark.parametrize("name", [".", "room"])
def test_20_a_folder_that_may_not_be_written_is_said_before_anything_moves(sealed_folder, name):
    desk = Desk()
    with pytest.raises(SessionError, match=r"cannot be (written|created): (Read-only file system|Permission denied)"):
        desk.sweep(sealed_folder / name)
    assert desk.controller.log == []


# 23 two in one folder

# Another program as the file system sees it; importing a session would take longer than the test.
HOLDER = """
import fcntl, json, os, sys, time
file = open(sys.argv[1], "x")
fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
file.write(json.dumps({"pid": os.getpid(), "host": os.uname().nodename}))
file.flush()
print("holds", flush=True)
time.sleep(60)
"""


@pytest.fixture
def holder(tmp_path):
    (tmp_path / "room").mkdir()
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(tmp_path / "room" / LOCK_NAME)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "holds\n"
    yield process
    process.kill()
    process.wait()
    process.stdout.close()


def test_23_two_processes_in_one_folder(tmp_path, holder):
    desk = Desk()
    with pytest.raises(SessionError, match=rf"in use by process {holder.pid} on "):
        desk.sweep(tmp_path / "room")
    assert desk.controller.log == [] and (tmp_path / "room" / LOCK_NAME).exists()
    holder.kill()
    holder.wait()
    # The lock of a dead process on this machine is taken over, and that is noted.
    result = desk.sweep(tmp_path / "room")
    assert result.status == "complete"
    assert any(f"took over the lock of process {holder.pid}" in sentence for sentence in desk.said)
    assert any(line.get("event") == "lock" for line in journal(tmp_path / "room"))
    assert not (tmp_path / "room" / LOCK_NAME).exists()


def test_23_two_in_one_process(tmp_path):
    with folder_lock(tmp_path), pytest.raises(SessionError, match="in use by process"), folder_lock(tmp_path):
        pass
    with folder_lock(tmp_path) as lock:
        assert lock.note == ""


@pytest.mark.parametrize(
    "text", ["", "{", "[]", '{"pid": "x"}', "\x00" * 100, '{"pid": 1, "host": "elsewhere", "start": "then"}']
)
def test_23_a_lock_that_was_left_is_taken_over_but_never_that_of_another_machine(tmp_path, text):
    (tmp_path / LOCK_NAME).write_text(text)
    if "elsewhere" in text:
        with pytest.raises(SessionError, match=r"process 1 on elsewhere; if that one has ended"), folder_lock(tmp_path):
            pass
    else:
        with folder_lock(tmp_path) as lock:
            assert "took over" in lock.note


@pytest.mark.timeout(20)
@pytest.mark.parametrize("there", [True, False])
def test_23_a_link_in_place_of_the_lock_is_not_followed(tmp_path, there):
    folder, target = tmp_path / "room", tmp_path / "letter"
    folder.mkdir()
    if there:
        target.write_text("dear")
    (folder / LOCK_NAME).symlink_to(target)
    with pytest.raises(SessionError, match="cannot be written"), folder_lock(folder):
        pass
    assert target.exists() == there and (not there or target.read_text() == "dear")


def test_23_where_the_file_system_has_no_locks_the_process_decides(tmp_path, monkeypatch):
    import fcntl

    def none(*arguments):
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", none)
    with folder_lock(tmp_path), pytest.raises(SessionError, match=f"process {os.getpid()}"), folder_lock(tmp_path):
        pass
    # Whether it has ended, nobody can know there.
    (tmp_path / LOCK_NAME).write_text(json.dumps({"pid": 1, "host": os.uname().nodename}))
    with pytest.raises(SessionError, match="if that one has ended, delete "), folder_lock(tmp_path):
        pass


def test_23_never_two_at_once_however_they_race(tmp_path):
    """Threads, whose locks are as strange to each other as those of processes."""
    (tmp_path / LOCK_NAME).write_text("")
    start, refused = threading.Barrier(4), []

    def race():
        start.wait(timeout=30)
        mine = 0
        while mine < 10:
            try:
                with folder_lock(tmp_path):
                    (tmp_path / "inside").touch(exist_ok=False)
                    mine += 1
                    (tmp_path / "inside").unlink()
            except SessionError as problem:
                assert "in use by" in str(problem)
                refused.append(problem)

    with ThreadPoolExecutor(4) as pool:
        for run in [pool.submit(race) for _ in range(4)]:
            run.result(timeout=60)
    assert refused and not (tmp_path / "inside").exists()


@pytest.mark.skipif(os.name != "posix", reason="folders are waited for on POSIX alone")
def test_a_new_capture_and_the_folders_above_it_are_on_the_disk(tmp_path, monkeypatch):
    synced, fsync = set(), os.fsync

    def noted(handle):
        synced.add(os.fstat(handle).st_ino)
        fsync(handle)

    monkeypatch.setattr(os, "fsync", noted)
    room = tmp_path / "a" / "b" / "room"
    assert Desk().sweep(room).status == "complete"
    for folder in (room, room.parent, room.parent.parent, tmp_path):
        assert folder.stat().st_ino in synced, folder


def test_the_end_of_a_scan_with_very_many_counts_is_readable(tmp_path):
    """A controller that sends ever new names of events must not make the journal unreadable."""
    ledger = Ledger(tmp_path / "room", Clock())
    header = {"kind": "sweep", "camera": {"width": 6, "height": 4, "pixel_format": "mono8"}, "laser": {"name": "red"}}
    ledger.create(CaptureHeader.model_validate(header))
    frame = np.zeros((4, 6), np.uint8)
    ledger.add(0, frame, frame, {"angle_deg": 0.0})
    counts = {f"EVENT{number:0100d}": number for number in range(600)}
    ledger.note("many", counts=counts, kept=1)
    assert ledger.end("complete", records=1, link={"sent": 7, "events_by_name": counts}, problem="x" * 70_000) == ""
    capture = open_capture(tmp_path / "room")
    assert len(capture) == 1 and capture.notes == ()
    *_, many, end = journal(tmp_path / "room")
    assert (many["kept"], many["counts"]) == (1, f"left out: {len(json.dumps({'counts': counts}))} bytes")
    assert (end["status"], end["records"], end["link"][:9], end["problem"][:9]) == (
        "complete",
        1,
        "left out:",
        "left out:",
    )


def test_what_a_killed_session_left_is_removed_and_nothing_else(tmp_path):
    desk = Desk()
    desk.controller.before_shot[4] = lambda controller: (_ for _ in ()).throw(KeyboardInterrupt)
    with pytest.raises(KeyboardInterrupt):
        desk.sweep(tmp_path / "room")
    room = tmp_path / "room"
    (room / "on" / ".part-0123456789ab.zst").write_bytes(b"half")
    (room / ".part-x").mkdir()
    (room / "off" / ".part-precious").write_text("not the session's")
    assert Desk().sweep(room, resume=True).status == "complete"
    assert sorted(path.name for path in room.rglob(".part-*")) == [".part-precious", ".part-x"]


@pytest.mark.parametrize("name", ["on", "off", "frames.jsonl", "capture.toml"])
def test_nothing_is_written_through_a_link_out_of_the_capture(tmp_path, name):
    desk = Desk()
    desk.controller.before_shot[4] = lambda controller: (_ for _ in ()).throw(KeyboardInterrupt)
    with pytest.raises(KeyboardInterrupt):
        desk.sweep(tmp_path / "room")
    outside = tmp_path / "outside"
    (tmp_path / "room" / name).rename(outside)
    (tmp_path / "room" / name).symlink_to(outside)
    if outside.is_dir():
        (outside / ".part-precious").write_text("not the session's")
    before = {path: path.stat() for path in (outside, *outside.glob("*"))}
    again = Desk()
    with pytest.raises(CaptureError, match="found a link"):
        again.sweep(tmp_path / "room", resume=True)
    assert {path: path.stat() for path in (outside, *outside.glob("*"))} == before
    assert again.controller.shots == [] and not again.table.contactor
