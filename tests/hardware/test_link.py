"""Ports and links: the problem of a port is named, only typed errors are raised, transcripts are replayed."""

import errno
import os
import pty
from dataclasses import replace

import pytest
import serial
from scanrig.clock import Clock, rfc3339
from scanrig.controllers import ControllerTable, open_controller
from scanrig.controllers.jxs.controller import connect
from scanrig.errors import FirmwareError, LinkLost, PortError
from scanrig.wire import (
    PortInfo,
    by_id_names,
    choose_port,
    describe,
    find_again,
    find_ports,
    identify,
    open_serial,
    port_error,
)
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from .fake import ManualClock


UNO = PortInfo("/dev/ttyACM0", "/dev/serial/by-id/usb-Arduino_Uno_5573-if00", "Arduino Uno", "2341:0043", "5573")
OTHER_UNO = PortInfo("/dev/ttyACM1", "", "Arduino Uno", "2341:0043", "9999")
MODEM = PortInfo("/dev/ttyUSB0", "", "Some modem", "12d1:1001", "")
BUILT_IN = PortInfo("/dev/ttyS0", "", "n/a", "", "")


@pytest.fixture
def terminal():
    """A pseudo terminal without anybody behind it: its master's descriptor and its path."""
    master, slave = pty.openpty()
    path = os.ttyname(slave)
    os.close(slave)
    yield master, path
    os.close(master)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("nothing", r"there is no port .*/nothing; .*port"),
        (".", "is a folder, expected a serial port"),
        ("notes.txt", "is no serial port"),
    ],
)
def test_what_is_no_port(tmp_path, name, said):
    (tmp_path / "notes.txt").write_text("hello")
    with pytest.raises(PortError, match=said):
        open_serial(str(tmp_path / name))
    assert (tmp_path / "notes.txt").read_text() == "hello"


def test_no_rights_and_how_to_get_them(monkeypatch):
    def refuse(self):
        raise serial.SerialException(errno.EACCES, "could not open port /dev/ttyACM0: Permission denied")

    monkeypatch.setattr(serial.Serial, "open", refuse)
    with pytest.raises(PortError, match=r"no permission to use /dev/ttyACM0: .*usermod -a -G dialout"):
        open_serial("/dev/ttyACM0")


def test_a_port_that_is_taken(terminal):
    first = open_serial(terminal[1])
    with pytest.raises(PortError, match="is taken: another program has it open"):
        open_serial(terminal[1])
    first.close()
    open_serial(terminal[1]).close()


def test_the_errors_are_all_distinct(tmp_path):
    problems = [errno.ENOENT, errno.EACCES, errno.EBUSY, errno.ENOTTY, errno.EIO]
    says = {str(port_error("/dev/ttyACM0", OSError(code, "x"))) for code in problems}
    assert len(says) == len(problems) and any("is taken" in text for text in says)
    assert all("\n" not in text for text in says)


def test_bytes_go_through(terminal):
    master, path = terminal
    link = open_serial(path)
    link.write(b"\x00\n\r\x11\x13\xff")
    assert os.read(master, 100) == b"\x00\n\r\x11\x13\xff"
    os.write(master, b"=1 ok\r\n\x00\x1b")
    assert link.read(1.0) == b"=1 ok\r\n\x00\x1b"
    link.close()


@pytest.mark.parametrize("kind", ["jaxscan", "grbl"])
def test_a_controller_of_each_type_is_opened_at_its_port(terminal, kind):
    table = ControllerTable(type=kind, port=terminal[1], allow_laser_without_watchdog=True)
    controller = open_controller(table, 28800)
    assert controller.name == terminal[1]
    controller.link.close()


def test_reading_nothing_takes_its_time(terminal):
    link = open_serial(terminal[1])
    clock = Clock()
    before = clock.now()
    assert link.read(0.1) == b""
    assert 0.1 <= clock.now() - before < 1.0
    link.close()


@pytest.mark.parametrize("call", ["tcflush", "tcsetattr"])
def test_a_port_that_goes_away_while_it_is_opened(terminal, monkeypatch, call):
    termios = pytest.importorskip("termios")

    def gone(*args):
        raise termios.error(errno.EIO, "Input/output error")

    monkeypatch.setattr(termios, call, gone)
    with pytest.raises(PortError, match=r"cannot open /dev/\S+ \(Input/output error\)"):
        open_serial(terminal[1])


def test_the_other_end_goes_away():
    master, slave = pty.openpty()
    link = open_serial(os.ttyname(slave))
    os.close(slave)
    os.close(master)
    with pytest.raises(LinkLost, match="went away"):
        for _ in range(50):
            link.write(b"?")
            link.read(0.01)
    link.close()
    link.close()


def test_a_closed_link_is_lost_not_a_crash(terminal):
    link = open_serial(terminal[1])
    link.close()
    with pytest.raises(LinkLost):
        link.write(b"?")
    with pytest.raises(LinkLost):
        link.read(0.0)


@pytest.mark.slow
def test_silence_on_a_real_port(terminal):
    clock = Clock()
    before = clock.now()
    controller = connect(terminal[1])
    with pytest.raises(FirmwareError, match=r"found silence, needed a scanner controller that speaks JXS/1"):
        controller.hello()
    assert clock.now() - before < 8.0


def test_the_only_board_is_chosen():
    assert choose_port("auto", [MODEM, UNO, BUILT_IN]) == UNO.by_id
    assert choose_port("", [BUILT_IN, MODEM]) == MODEM.device
    assert choose_port("9999", [UNO, OTHER_UNO]) == OTHER_UNO.device
    assert choose_port("/dev/ttyACM7", []) == "/dev/ttyACM7"


def test_no_board_and_several_boards_are_named():
    with pytest.raises(PortError, match="no serial port was found at all"):
        choose_port("auto", [])
    with pytest.raises(PortError, match=r"ports found: /dev/ttyS0$"):
        choose_port("auto", [BUILT_IN])
    with pytest.raises(PortError, match=r"2 ports could be the controller, name one: .*5573.*9999"):
        choose_port("auto", [UNO, OTHER_UNO])
    with pytest.raises(PortError, match="no port with serial number '1234'"):
        choose_port("1234", [UNO])


def test_a_board_is_found_again_under_another_number():
    moved = PortInfo("/dev/ttyACM3", UNO.by_id, UNO.description, UNO.vid_pid, UNO.serial_number)
    assert find_again(UNO, [OTHER_UNO, moved]) == "/dev/ttyACM3"
    assert find_again(MODEM, []) == MODEM.device


@pytest.mark.parametrize("there", [[], [OTHER_UNO], [replace(OTHER_UNO, device=UNO.device, by_id=UNO.by_id)]])
def test_another_board_at_the_old_path_is_not_taken_for_the_one_that_was_there(there):
    with pytest.raises(PortError, match=r"5573.* is not there any more") as error:
        find_again(UNO, there)
    assert all(describe(info) in str(error.value) for info in there)


def test_a_board_cannot_steer_a_terminal_by_its_name(monkeypatch):
    port = ListPortInfo("/dev/ttyUSB7")
    port.vid, port.pid, port.description, port.serial_number = (
        0x1234,
        0x5678,
        "Uno\x1b[2J\n\x9bx",
        "1\r\x07" + "2" * 500,
    )
    monkeypatch.setattr(list_ports, "comports", lambda: [port])
    (info,) = find_ports()
    assert describe(info).isprintable() and len(describe(info)) < 300
    with pytest.raises(PortError) as error:
        choose_port("1234")
    assert str(error.value).isprintable()


def test_ports_are_described_by_what_does_not_change(tmp_path):
    assert describe(UNO) == f"{UNO.by_id} (Arduino Uno, 2341:0043, 5573)"
    (tmp_path / "ttyACM0").touch()
    (tmp_path / "by-id").mkdir()
    (tmp_path / "by-id" / "usb-Uno").symlink_to(tmp_path / "ttyACM0")
    assert by_id_names(tmp_path / "by-id") == {str(tmp_path / "ttyACM0"): str(tmp_path / "by-id" / "usb-Uno")}
    assert by_id_names(tmp_path / "none") == {}


def test_the_ports_of_this_computer_are_listed():
    assert all(info.device and "\n" not in describe(info) for info in find_ports())


def test_a_pseudo_terminal_is_known_by_its_path(terminal):
    assert find_again(identify(terminal[1])) == terminal[1]


def test_clocks():
    clock = ManualClock()
    clock.sleep(1.5)
    clock.sleep(-1.0)
    assert clock.now() == 1.5 and clock.utc() == "2000-01-01T00:00:01.500000Z"
    system = Clock()
    before = system.now()
    system.sleep(0.01)
    assert system.now() - before >= 0.01
    assert len(system.utc()) == len(rfc3339(clock.start)) and system.utc().endswith("Z")
