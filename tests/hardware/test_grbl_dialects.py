"""Boards that speak dialects of GRBL: what they answer is shown as it came, and each state has its own cure."""

import pytest
from scanrig.controllers.controller import GrblTable, Settings
from scanrig.controllers.grbl import GrblController
from scanrig.controllers.grbl.lines import (
    FLUID_NC,
    GRBL,
    GRBL_HAL,
    GrblLines,
    TableUnits,
    dialect_of,
    read_report,
    read_settings,
)
from scanrig.errors import Fault, FirmwareError, RigError, RigFault

from .grbl_rig import GrblBoard


def controller(board, **table):
    lines = GrblLines(board, board.clock, greeting="Grbl", reopen=lambda: board)
    return GrblController(lines, GrblTable(**table), TableUnits(28_800, 360.0))


@pytest.mark.parametrize(
    ("greeting", "dialect", "version"),
    [
        ("Grbl 1.1h ['$' for help]", GRBL, "1.1h"),
        ("GrblHAL 1.1f ['$' or '$HELP' for help]", GRBL_HAL, "1.1f"),
        ("Grbl 3.7 [FluidNC v3.7.12 (wifi) '$' for help]", FLUID_NC, "v3.7.12"),
    ],
)
def test_the_dialect_is_known_by_the_greeting(greeting, dialect, version):
    assert dialect_of(greeting) is dialect
    firmware = controller(GrblBoard(greeting)).hello()
    assert (firmware.proto, firmware.version) == (dialect.name, version)


@pytest.mark.parametrize(
    "line",
    [
        "<Alarm:10|MPos:0.000,0.000,0.000|Bf:100,1024|FS:0,0|Pn:E>",
        "<Tool|MPos:0.000,0.000,0.000|Bf:100,1024|FS:0,0>",
        "<Idle|MPos:0.000,0.000,0.000|Bf:100,1024|FS:0,0|A:|Sc:|MPG:0|H:1,7|T:0|TLR:0|FW:grblHAL>",
    ],
)
def test_reports_of_grblhal(line):
    assert read_report(line).positions == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("greeting", "report", "words"),
    [
        ("Grbl 0.9j ['$' for help]", "<Idle,MPos:0.000,0.000,0.000,WPos:0.0,0.0,0.0>", "as of GRBL 1.1"),
        ("GrblHAL 1.1f ['$']", "<Queue|MPos:0.000,0.000,0.000>", "of grblHAL, which is not understood here"),
        ("", "<Alarm:11|MPos:0.000,0.000,0.000>", "greets with 'Grbl' after a reset"),
    ],
)
def test_an_answer_that_is_not_understood_is_shown(greeting, report, words):
    board = GrblBoard(greeting, report, s22=0.0)
    with pytest.raises(FirmwareError) as caught:
        controller(board).hello()
    assert words in str(caught.value) and repr(report[:60]) in str(caught.value)
    # No waiting for what has come.
    assert board.clock.time_s < 10


def test_a_stop_that_is_pressed_is_said():
    report = "<Alarm:10|MPos:0.000,0.000,0.000|FS:0,0|Pn:E>"
    with pytest.raises(RigFault, match=r"emergency stop \(grblHAL says ALARM:10\); release it") as caught:
        controller(GrblBoard("GrblHAL 1.1f ['$']", report)).hello()
    assert caught.value.fault is Fault.EMERGENCY_STOP


@pytest.mark.parametrize(
    ("state", "fault", "words"),
    [
        ("Tool", Fault.TOOL_CHANGE, "end the change at the board"),
        ("Sleep", Fault.ASLEEP, "clear the fault, which wakes it"),
        ("Hold:0", Fault.HELD, "feed hold button"),
        ("Door:1", Fault.EMERGENCY_STOP, "its safety door"),
        ("Alarm:1", Fault.LIMIT, "look for an obstacle"),
        ("Alarm:17", Fault.UNKNOWN, "grblHAL says ALARM:17"),
    ],
)
def test_each_state_has_its_own_cure(state, fault, words):
    board = GrblBoard("GrblHAL 1.1f ['$']")
    one = controller(board)
    one.hello()
    board.report = f"<{state}|MPos:1.000,0.000,0.000|FS:0,0>"
    assert one.stat().fault is fault
    with pytest.raises(RigFault) as caught:
        one.poll()
    assert caught.value.fault is fault and words in str(caught.value)


@pytest.mark.parametrize(("greeting", "state"), [("GrblHAL 1.1f", "Alarm:11"), ("Grbl 3.7 [FluidNC v3.7]", "Alarm:14")])
def test_a_board_that_is_not_homed_is_in_no_fault(greeting, state):
    one = controller(GrblBoard(greeting, f"<{state}|MPos:0.000,0.000,0.000|FS:0,0>"))
    one.hello()
    status = one.stat()
    assert status.fault is None and status.state == "idle" and not status.homed


def test_homing_is_a_bit_of_a_mask_in_grblhal():
    one = controller(GrblBoard("GrblHAL 1.1f ['$']", s22=5.0, s10=511.0, s70=11.0))
    one.hello()
    one.configure(Settings(speed=8000, lasers=1))
    wrong = controller(GrblBoard("GrblHAL 1.1f ['$']", s22=4.0))
    wrong.hello()
    with pytest.raises(FirmwareError, match=r"found \$22=4.0; expected \$22=1"):
        wrong.configure(Settings(speed=8000, lasers=1))


def test_settings_that_a_board_does_not_list_are_named_where_they_are():
    board = GrblBoard("Grbl 3.7 [FluidNC v3.7.12 '$']")
    board.to_host = lambda data: b"" if data.startswith(b"$") else data
    one = controller(board)
    one.hello()
    with pytest.raises(FirmwareError) as caught:
        one.configure(Settings(speed=8000, lasers=1))
    message = str(caught.value)
    assert "FluidNC does not list its axes" in message and "config.yaml" in message
    assert "steps_per_mm = 80" in message and "check_settings = false" in message
    assert "\n" not in message
    still = controller(board, check_settings=False)
    still.hello()
    still.configure(Settings(speed=8000, lasers=1))


def test_a_device_that_answers_otherwise_is_quoted():
    board = GrblBoard()
    board.to_host = lambda data: b"what?\r\n"
    lines = GrblLines(board, board.clock, greeting="Grbl", reopen=lambda: board)
    with pytest.raises(RigError, match=r"no answer from grbl to 'G4 P0'.*it sent 'what\?'"):
        lines.ask("G4 P0")


@pytest.mark.parametrize("said", ["nan", "inf", "1e400", "9" * 400, "1.2.3", "", "٣"])
def test_a_report_of_no_place_is_no_report(said):
    assert read_report(f"<Idle|MPos:{said},0.000,0.000|FS:0,0>") is None
    assert read_settings([f"$100={said}"]) == {}


def test_a_report_is_read():
    report = read_report("<Idle|MPos:-12.345,0.,3|FS:0,0>")
    assert report is not None and report.positions == (-12.345, 0.0, 3.0)
    assert read_settings(["$100=80.000", "$10=1"]) == {100: 80.0, 10: 1.0}
