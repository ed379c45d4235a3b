"""Being asked to end: once, twice, and in the worst moments."""

import os
import select
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from scanrig.recording import AHEAD
from scanrig.session.interrupts import Interrupts

from jaxscan.files.capture import open_capture, verify_capture

from .desk import After, Desk, journal


ROOT = Path(__file__).parents[2]


def interrupt(controller=None):
    raise KeyboardInterrupt


def test_10_the_first_signal_is_a_mark_with_an_answer_and_the_second_an_interrupt(capfd):
    before = signal.getsignal(signal.SIGTERM)
    with Interrupts() as interrupts:
        assert not interrupts()
        os.kill(os.getpid(), signal.SIGTERM)
        assert interrupts() and interrupts.received == ["SIGTERM"]
        assert capfd.readouterr().err == "jaxscan: ends after this step; Ctrl-C again ends at once\n"
        with pytest.raises(KeyboardInterrupt, match="SIGTERM, then SIGINT"):
            os.kill(os.getpid(), signal.SIGINT)
        # Whoever is switching the laser off is not disturbed any more.
        for name in ("SIGINT", "SIGHUP", "SIGTERM"):
            os.kill(os.getpid(), getattr(signal, name))
        assert len(interrupts.received) == 5 and capfd.readouterr().err == ""
    assert signal.getsignal(signal.SIGTERM) is before


def test_10_one_signal_in_mid_step_finishes_the_step(tmp_path):
    desk = Desk()
    with Interrupts() as interrupts:
        desk.controller.before_shot[4] = lambda controller: os.kill(os.getpid(), signal.SIGINT)
        result = desk.sweep(tmp_path / "room", should_stop=interrupts)
    assert (result.status, result.records, result.laser_off) == ("interrupted", 4, True)
    assert "4 of 10 records" in result.message and "can be resumed" in result.message
    assert "abort" not in desk.controller.log and not desk.table.contactor
    assert journal(tmp_path / "room")[-1]["status"] == "interrupted"


def test_10_a_signal_while_a_large_capture_is_verified(tmp_path, monkeypatch):
    folder = tmp_path / "room"
    Desk(sweep={"steps": 12}).sweep(folder, should_stop=After(6))
    before = (folder / "frames.jsonl").read_bytes()
    monkeypatch.setattr("jaxscan.files.capture.seals._BLOCK", 2)
    desk = Desk(sweep={"steps": 12})
    with pytest.raises(KeyboardInterrupt, match="SIGTERM"), Interrupts() as interrupts:
        desk.sweep(folder, resume=True, should_stop=lambda: os.kill(os.getpid(), signal.SIGTERM) or interrupts())
    assert interrupts.received == ["SIGTERM"]
    assert desk.controller.log == [] and (folder / "frames.jsonl").read_bytes() == before


@pytest.mark.parametrize(
    "at", ["before the shot", "while the frames come", "while the pair is stored", "in the viewer"]
)
def test_10_an_abort_switches_off_before_anything_else(tmp_path, monkeypatch, at):
    desk = Desk()
    options = {}
    if at == "before the shot":
        desk.controller.before_shot[4] = interrupt
    elif at == "while the frames come":
        original = desk.camera.next
        desk.camera.next = lambda wait_s: interrupt() if len(desk.controller.shots) == 4 else original(wait_s)
    elif at == "while the pair is stored":
        from jaxscan.files.recording import CaptureWriter

        flush, flushes = CaptureWriter.flush, []

        def flushing(writer):
            flushes.append(1)
            if len(flushes) == 6:
                raise KeyboardInterrupt
            flush(writer)

        monkeypatch.setattr(CaptureWriter, "flush", flushing)
    else:
        options["on_pair"] = lambda number, *_: interrupt() if number == 3 else None
    with pytest.raises(KeyboardInterrupt):
        desk.sweep(tmp_path / "room", **options)
    monkeypatch.undo()
    log = desk.controller.log
    # The byte that needs no answer, then the confirmation.
    assert log.index("abort") < log.index("make_safe")
    assert "shot" not in log[log.index("abort") :]
    assert not desk.table.laser and not desk.table.contactor
    assert journal(tmp_path / "room")[-1]["status"] == "aborted"
    # Pairs that were in flight are stored when everything is off.
    most = 4 + AHEAD if at == "in the viewer" else 4
    assert verify_capture(tmp_path / "room") == [] and 3 <= len(open_capture(tmp_path / "room")) <= most
    again = Desk()
    assert again.sweep(tmp_path / "room", resume=True).status == "complete"
    assert len(open_capture(tmp_path / "room")) == 10


def test_10_an_interrupt_while_the_laser_is_switched_off(tmp_path):
    desk = Desk()
    make_safe, calls = desk.controller.make_safe, []

    def disturbed():
        calls.append(1)
        if len(calls) == 1:
            raise KeyboardInterrupt
        return make_safe()

    desk.controller.make_safe = disturbed
    result = desk.sweep(tmp_path / "room")
    assert result.laser_off and desk.controller.log[-3:] == ["abort", "make_safe", "counters"]
    assert not desk.table.contactor


HUNG_UP = """
import sys, time
from pathlib import Path
from scanrig.recording import AHEAD
from scanrig.session import Interrupts
from tests.hardware.desk import Desk
import fcntl, termios
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
desk = Desk()
with Interrupts() as interrupts:
    def wait(controller):
        print("in the fourth step", flush=True)
        limit = time.monotonic() + 20
        while not interrupts() and time.monotonic() < limit:
            time.sleep(0.01)
    def stored(number, *_):
        print("record", number, flush=True)
        print("record", number, file=sys.stderr, flush=True)
    desk.controller.before_shot[4] = wait
    result = desk.sweep(Path(sys.argv[1]), on_pair=stored, should_stop=interrupts)
print(result.message, flush=True)
sys.exit(0 if interrupts.received == ["SIGHUP"] else 3)
"""


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="needs pseudo terminals")
def test_10_a_terminal_that_is_closed_ends_after_the_step_though_nothing_can_be_printed(tmp_path):
    master, slave = os.openpty()
    child = subprocess.Popen(
        [sys.executable, "-c", HUNG_UP, str(tmp_path / "room")],
        stdin=slave,
        stdout=slave,
        stderr=slave,
        start_new_session=True,
        cwd=ROOT,
    )
    os.close(slave)
    said = b""
    try:
        # With the end of the line: the terminal gives out the words first, and a print cut off there fails.
        while b"in the fourth step\r\n" not in said:
            assert select.select([master], [], [], 60)[0], said
            said += os.read(master, 4096)
    finally:
        os.close(master)
    assert child.wait(60) == 0
    assert journal(tmp_path / "room")[-1]["status"] == "interrupted"
    assert len(open_capture(tmp_path / "room")) == 4
