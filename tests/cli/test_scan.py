"""`jaxscan scan` as a person types it, on a simulated rig: output, files, questions and exit codes."""

import json
import os
import pty
import shlex
import shutil
import signal
import sys
import time
import tty

import numpy as np
import pytest
from scanrig.errors import CameraLost, Fault, PortError

from jaxscan import api
from jaxscan.cli.boards import Lines
from jaxscan.files.capture import open_capture

from ..hardware.desk import Desk


CONFIG = """
[controller]
port = "paper"
[turntable]
full_steps = 200
microsteps = 16
gear = [9, 1]
[camera]
kind = "simulated"
width = 128
height = 96
[sweep]
steps = 10
turn_deg = 36.0
"""


class Paper:
    """The desk behind the names under which the command line opens a rig."""

    def __init__(self, monkeypatch):
        self.desk = Desk()
        self.opened, self.closed = [], []
        controller, camera = self.desk.controller, self.desk.camera

        class Opened(type(controller)):
            def __enter__(self):
                return self

            def __exit__(inner, *_):
                self.closed.append("controller")
                inner.make_safe()

        controller.__class__ = Opened

        def connect(port, baud, clock):
            self.opened.append(port)
            if port == "nowhere":
                raise PortError("there is no port nowhere; no serial port was found at all")
            return controller

        monkeypatch.setattr("scanrig.controllers.jxs.connect", connect)
        monkeypatch.setattr("scanrig.cameras.open_camera", lambda settings, say: kept(camera))


def kept(camera):
    """A camera that is opened more than once."""
    camera.close = lambda: None
    return camera


@pytest.fixture
def paper(monkeypatch):
    """Ctrl-C is heard as in a shell, also where the tests were started with it ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield Paper(monkeypatch)
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(CONFIG)
    return path


def test_a_sweep(run, paper, config, tmp_path):
    ran = run("scan", config, "-o", tmp_path / "room", "--json", tmp_path / "scan.json")
    assert ran.code == 0, ran.err
    lines = ran.out.splitlines()
    assert lines[0] == f"10 steps of 3.6°: 20 images of 128 x 96 to {tmp_path / 'room'}"
    assert "28800 microsteps per turn" in lines[1]
    assert lines[-2].endswith("room: complete, 10 records.")
    assert lines[-1].startswith("next: jaxscan reconstruct")
    assert len(open_capture(tmp_path / "room")) == 10
    result = json.loads((tmp_path / "scan.json").read_text())
    assert (result["format"], result["status"], result["records"]) == ("jaxscan-scan/1", "complete", 10)
    assert result["laser_off"] is True
    assert not paper.desk.table.laser and not paper.desk.table.contactor and paper.closed == ["controller"]


def test_steps_that_are_not_whole_are_noted(run, paper, config, tmp_path):
    config.write_text(CONFIG.replace("gear = [9, 1]", "gear = [5, 1]").replace("36.0", "360.0").replace("10", "3600"))
    paper.desk.config = None
    ran = run("scan", config, "-o", tmp_path / "file" / "room", "--port", "nowhere")
    assert ran.code == 1
    assert "note: A step of 0.1 deg is 4.4444 microsteps" in ran.out


def test_another_port(refused_after_plan, paper, config, tmp_path):
    assert "there is no port nowhere" in refused_after_plan(
        "scan", config, "-o", tmp_path / "room", "--port", "nowhere"
    )
    assert paper.opened == ["nowhere"] and not (tmp_path / "room").exists()


def test_a_laser_that_nothing_switches_off_has_to_be_allowed(refused_after_plan, config, tmp_path):
    config.write_text(CONFIG.replace('port = "paper"', 'type = "grbl"'))
    says = refused_after_plan("scan", config, "-o", tmp_path / "room")
    assert "leaves the laser on" in says and "allow_laser_without_watchdog = true under [controller]" in says
    assert not (tmp_path / "room").exists()


@pytest.fixture
def refused_after_plan(run):
    def call(*words):
        ran = run(*words)
        assert ran.code == 1, ran
        last = ran.err.splitlines()[-1]
        assert last.startswith("jaxscan: ") and "Traceback" not in ran.err
        return last

    return call


@pytest.mark.parametrize(
    "words, says",
    [
        (["--cloud", "room.ply"], "--cloud: found without --calibration"),
        (["--place-command", "true"], "--place-command: found without --boards"),
        (["--boards", "-c", "calibration.json"], "--calibration: found with --boards"),
        (["--boards"], "has no [board] table"),
        (["-c", "missing.json"], "missing.json"),
    ],
)
def test_options_that_do_not_go_together(refused_after_plan, paper, config, tmp_path, words, says):
    assert says in refused_after_plan("scan", config, "-o", tmp_path / "room", *words)
    assert paper.opened == []


def test_a_camera_that_is_not_there(refused_after_plan, paper, config, tmp_path, monkeypatch):
    def lost(settings, say):
        raise CameraLost("no camera 127.0.0.1; see that it has power and its cable")

    monkeypatch.setattr("scanrig.cameras.open_camera", lost)
    assert "no camera 127.0.0.1" in refused_after_plan("scan", config, "-o", tmp_path / "room")
    assert paper.closed == ["controller"]


def test_ctrl_c_ends_after_the_step_and_resume_goes_on(run, paper, config, tmp_path):
    paper.desk.controller.before_shot[4] = lambda controller: os.kill(os.getpid(), signal.SIGINT)
    ran = run("scan", config, "-o", tmp_path / "room")
    assert ran.code == 130
    assert "interrupted with 4 of 10 records; it can be resumed" in ran.out
    assert ran.out.endswith(f"go on with: jaxscan scan {config} -o {tmp_path / 'room'} --resume\n")
    assert ran.err.endswith("jaxscan: interrupted\n")
    assert not paper.desk.table.laser and not paper.desk.table.contactor
    assert "holds a capture already; add --resume" in run("scan", config, "-o", tmp_path / "room").err
    ran = run("scan", config, "-o", tmp_path / "room", "--resume")
    assert ran.code == 0, ran.err
    assert len(open_capture(tmp_path / "room")) == 10


def test_ctrl_c_while_the_camera_is_not_free_ends_at_once(run, paper, config, tmp_path, monkeypatch):
    def waits(settings, say):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(5)

    monkeypatch.setattr("scanrig.cameras.open_camera", waits)
    ran = run("scan", config, "-o", tmp_path / "room")
    assert ran.code == 130 and ran.err.endswith("jaxscan: interrupted\n")
    assert paper.closed == ["controller"]


def test_two_ctrl_c_end_at_once(run, paper, config, tmp_path):
    def twice(controller):
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGTERM)

    paper.desk.controller.before_shot[3] = twice
    ran = run("scan", config, "-o", tmp_path / "room")
    assert ran.code == 130
    assert not paper.desk.table.laser and not paper.desk.table.contactor
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_the_emergency_stop_is_an_error_and_what_goes_on_is_said_with_what_was_asked_for(run, paper, config, tmp_path):
    def press(controller):
        controller.estop = True
        controller.fall_into(Fault.EMERGENCY_STOP)

    paper.desk.controller.before_shot[3] = press
    words = ("scan", config, "-o", tmp_path / "a room", "--port", "/dev/ttyACM1")
    ran = run(*words)
    assert ran.code == 1
    finding, command = ran.err.splitlines()[-1].split("; go on with: jaxscan ")
    assert finding == f"jaxscan: {tmp_path / 'a room'}: e-stop"
    assert shlex.split(command) == [*map(str, words), "--resume"]


def test_retakes_are_said(run, paper, config, tmp_path):
    paper.desk.camera.faults[5] = "incomplete"
    ran = run("scan", config, "-o", tmp_path / "room", "--json", tmp_path / "scan.json")
    assert ran.code == 0, ran.err
    assert "step 2 is taken again" in ran.err
    assert json.loads((tmp_path / "scan.json").read_text())["retakes"] == 1


class Replay(Desk):
    """A rig that sees the pictures of a capture."""

    def __init__(self, folder):
        capture = open_capture(folder)
        self.pairs = [capture.frames(n) for n in range(len(capture))]
        turn = float(np.degrees(capture.angles[1])) * len(capture)
        width, height = capture.image_size
        super().__init__(
            camera={"width": width, "height": height}, sweep={"steps": len(capture), "turn_deg": round(turn, 6)}
        )

    def see(self, position, lit):
        on, off = self.pairs[round(position / 28800 * len(self.pairs)) % len(self.pairs)]
        return on if lit else off


@pytest.mark.more
def test_the_cloud_is_there_when_the_scan_ends(run, paper, tiny, tmp_path, monkeypatch):
    desk = Replay(tiny.sweep)
    paper.desk.controller.table = desk.table
    paper.desk.controller.camera = desk.camera
    monkeypatch.setattr("scanrig.cameras.open_camera", lambda settings, say: kept(desk.camera))
    config = tmp_path / "rig.toml"
    steps, turn = desk.config.sweep.steps, desk.config.sweep.turn_deg
    text = CONFIG.replace("width = 128", "width = 320").replace("height = 96", "height = 256")
    config.write_text(text.replace("steps = 10", f"steps = {steps}").replace("36.0", str(turn)))
    paper.desk.controller.before_shot[30] = lambda controller: os.kill(os.getpid(), signal.SIGINT)
    room, cloud = tmp_path / "room", tmp_path / "room.ply"
    calibration = tmp_path / "changed.json"
    content = json.loads(tiny.calibration.read_text())
    content["provenance"]["remark"] = "by hand"
    calibration.write_text(json.dumps(content))
    words = ("scan", config, "-o", room, "-c", calibration, "--cloud", cloud)
    ran = run(*words)
    assert (ran.code, cloud.exists()) == (130, False)
    ran = run(*words, "--resume", "--json", tmp_path / "scan.json")
    assert ran.code == 0, ran.err
    result = json.loads((tmp_path / "scan.json").read_text())
    (note,) = (note for note in result["notes"] if "have changed since jaxscan calibrate wrote it" in note)
    assert f"note: {note}\n" in ran.out
    assert result["live"] is True and result["taken"] == steps - 30
    assert f"next: jaxscan measure room {cloud} -c {calibration}" in ran.out
    # The file is that of `jaxscan reconstruct`, byte for byte.
    again = tmp_path / "again.ply"
    ran = run("reconstruct", room, "-c", calibration, "-o", again, "--no-cache")
    assert ran.code == 0, ran.err
    one, other = api.load_cloud(cloud), api.load_cloud(again)
    assert result["points"] == int(np.count_nonzero(one.valid)) > 5000
    np.testing.assert_array_equal(one.rgb, other.rgb)
    # Without the cache points are computed together with stripes: one compiled function, other last places.
    np.testing.assert_allclose(one.xyz, other.xyz, rtol=1e-5, atol=1e-6)
    ran = run("reconstruct", room, "-c", calibration, "-o", again)
    assert again.read_bytes() == cloud.read_bytes()
    shutil.rmtree(room)


class Typed:
    """Standard input, typed in advance."""

    def __init__(self, monkeypatch, text):
        reading, writing = os.pipe()
        os.write(writing, text.encode())
        os.close(writing)
        self.file = os.fdopen(reading)
        monkeypatch.setattr(sys, "stdin", self.file)


@pytest.fixture
def typed(monkeypatch):
    made = []

    def type_in(text):
        made.append(Typed(monkeypatch, text))

    yield type_in
    for one in made:
        one.file.close()


BOARD = """
[board]
type = "chessboard"
columns = 7
rows = 5
square_mm = 80.0
[calibration]
free_views = 3
placements = 1
angles_deg = [-5.0, 0.0, 5.0]
"""


@pytest.fixture
def board_rig(paper, tiny, tmp_path, monkeypatch):
    """The camera sees boards that were rendered, one after another, and `None` as no board."""
    capture = open_capture(tiny.boards)
    pairs = [capture.frames(n) for n in range(12)]
    blank = open_capture(tiny.sweep).frames(0)
    desk = Desk(camera={"width": 320, "height": 256})
    desk.showing = pairs[0]
    desk.see = lambda position, lit: desk.showing[0 if lit else 1]
    controller = paper.desk.controller
    controller.table, controller.camera = desk.table, desk.camera
    monkeypatch.setattr("scanrig.cameras.open_camera", lambda settings, say: kept(desk.camera))
    looks = []

    def trigger(ms=None):
        # Each look through the camera finds the next board.
        desk.showing = looks.pop(0) if looks else desk.showing
        desk.camera.expose(desk.table.position, desk.table.shines)

    controller.trigger = trigger
    desk.looks, desk.pairs, desk.blank = looks, pairs, blank
    text = CONFIG.replace("width = 128", "width = 320").replace("height = 96", "height = 256")
    desk.path = tmp_path / "rig.toml"
    desk.path.write_text(text + BOARD)
    return desk


def test_boards_are_asked_for_and_looked_at(run, paper, board_rig, typed, tmp_path):
    board_rig.looks[:] = [board_rig.blank, board_rig.pairs[0], board_rig.pairs[1], board_rig.pairs[2]]
    # The first Enter finds no board; an unknown answer is asked again; the last pose but one is enough.
    typed("\n\nwhat\n\ns\n\n")
    ran = run("scan", board_rig.path, "-o", tmp_path / "boards", "--boards")
    assert ran.code == 0, ran.err + ran.out
    assert ran.out.startswith("3 poses of the board, then 1 places where it stands")
    assert "hold the board still, wholly in the picture, with the laser's line across it" in ran.out
    assert "Not taken: no board found" in ran.out and "'what' is none of these" in ran.out
    assert ran.out.count("board found, 35 corners") == 2 + 3
    assert "at -5.0°: board found" in ran.out and "Pose 3 of 3" in ran.out and "Standing place 1 of 1" in ran.out
    assert "next: jaxscan calibrate" in ran.out
    assert "retake" not in ran.err and "fault" not in ran.err
    assert len(open_capture(tmp_path / "boards")) == 5
    assert not board_rig.table.contactor


def test_enough_of_all(run, paper, board_rig, typed, tmp_path):
    typed("\nq\n")
    ran = run("scan", board_rig.path, "-o", tmp_path / "boards", "--boards")
    assert ran.code == 0, ran.err
    assert len(open_capture(tmp_path / "boards")) == 1


def test_enough_before_there_is_anything(run, paper, board_rig, typed, tmp_path):
    typed("q\n")
    ran = run("scan", board_rig.path, "-o", tmp_path / "boards", "--boards")
    assert ran.code == 1 and "--boards --resume" in ran.err.splitlines()[-1]
    assert "complete" not in ran.out and "next: jaxscan calibrate" not in ran.out


def test_input_that_ends_is_no_consent(run, paper, board_rig, typed, tmp_path):
    typed("\n")
    ran = run("scan", board_rig.path, "-o", tmp_path / "boards", "--boards")
    assert ran.code == 1 and "--boards --resume" in ran.err.splitlines()[-1]
    assert "interrupted with 1 of 6 records" in ran.out


def test_a_command_places_the_board(run, paper, board_rig, tmp_path):
    log = tmp_path / "placed"
    command = f"sh -c 'echo $1 >> {log}' sh"
    ran = run("scan", board_rig.path, "-o", tmp_path / "boards", "--boards", "--place-command", command)
    assert ran.code == 0, ran.err
    assert log.read_text().split() == ["0", "1", "2", "3", "none"]
    assert len(open_capture(tmp_path / "boards")) == 6


@pytest.mark.parametrize(
    "command, says",
    [
        ("sh -c 'echo too heavy >&2; exit 3'", "sh 0 ended with 3: too heavy"),
        ("/no/such/robot", "No such file"),
        ("'", "expected a command"),
        ("", "found nothing"),
    ],
)
def test_a_command_that_fails(refused_after_plan, paper, board_rig, tmp_path, command, says):
    words = ("scan", board_rig.path, "-o", tmp_path / "boards", "--boards", "--place-command", command)
    assert says in refused_after_plan(*words)
    assert not board_rig.table.contactor


def test_an_enter_of_impatience_answers_no_later_question():
    host, terminal = pty.openpty()
    tty.setraw(terminal)
    lines = Lines(terminal)
    os.write(host, b"\n\nq\n")
    lines.forget()
    os.write(host, b"s\n")
    assert lines.next(lambda: False) == "s"
    os.close(host)
    os.close(terminal)


def test_lines_of_a_pipe_are_all_heard():
    out, into = os.pipe()
    lines = Lines(out)
    os.write(into, b"\n\nq\n")
    lines.forget()
    assert [lines.next(lambda: False) for _ in range(3)] == ["", "", "q"]
    os.close(into)
    lines.forget()
    assert lines.next(lambda: False) is None and lines.ended
    os.close(out)
