"""The link to a controller: serial ports, and finding them again."""

import contextlib
import errno
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from jaxscan.errors import DependencyError
from scanrig.clock import Clock
from scanrig.errors import LinkLost, PortError


try:
    import serial
    from serial.tools import list_ports
except ImportError as problem:
    raise DependencyError('Serial ports need pyserial: pip install "jaxscan[rig]"') from problem


class Link(Protocol):
    """A two-way stream of bytes; the connection may be lost."""

    @property
    def name(self) -> str:
        """Its name for messages: the port's path."""

    def write(self, data: bytes) -> None:
        """Send all of data. Raises LinkLost."""

    def read(self, timeout_s: float) -> bytes:
        """The bytes received, as soon as there are any; b"" after timeout_s without any. Raises LinkLost."""

    def close(self) -> None:
        """Close the port. Never raises."""


BY_ID = Path("/dev/serial/by-id")

BOARDS = {
    "2341:0043": "Arduino Uno",
    "2341:0001": "Arduino Uno",
    "2a03:0043": "Arduino Uno",
    "1a86:7523": "CH340 (many Uno and Nano boards)",
    "1a86:5523": "CH341",
    "0403:6001": "FT232R (Nano)",
    "10c4:ea60": "CP210x",
}
"""USB numbers under which an ATmega328P board usually appears."""

_LONGEST = 126


@dataclass(frozen=True)
class PortInfo:
    """A serial port that exists."""

    device: str
    by_id: str
    """Its path under /dev/serial/by-id, which stays the same when it is plugged in again; "" if there is none."""
    description: str
    vid_pid: str
    """USB vendor and product, four hexadecimal digits each: `2341:0043`; "" if it is not a USB port."""
    serial_number: str


def find_ports(by_id_folder: Path = BY_ID) -> list[PortInfo]:
    """All serial ports: usual controller boards first, then other USB ports, then the rest, each by path."""
    names = by_id_names(by_id_folder)
    found = []
    for port in list_ports.comports():
        vid_pid = "" if port.vid is None or port.pid is None else f"{port.vid:04x}:{port.pid:04x}"
        found.append(
            PortInfo(
                device=port.device,
                by_id=names.get(str(Path(port.device).resolve()), ""),
                description=BOARDS.get(vid_pid) or printable(port.description or ""),
                vid_pid=vid_pid,
                serial_number=printable(port.serial_number or ""),
            )
        )
    return sorted(found, key=lambda info: (info.vid_pid not in BOARDS, info.vid_pid == "", info.device))


def printable(text: str) -> str:
    """A device's own text without control characters, shortened to one line."""
    return "".join(letter if letter.isprintable() else "?" for letter in text[:_LONGEST])


def by_id_names(folder: Path) -> dict[str, str]:
    """Device path → path under `folder` that links to it."""
    if not folder.is_dir():
        return {}
    return {str(link.resolve()): str(link) for link in sorted(folder.iterdir())}


def describe(info: PortInfo) -> str:
    """A port as messages name it."""
    words = [word for word in (info.description, info.vid_pid, info.serial_number) if word not in ("", "n/a")]
    return (info.by_id or info.device) + (f" ({', '.join(words)})" if words else "")


def choose_port(wanted: str = "", ports: Iterable[PortInfo] | None = None) -> str:
    """The path of the port to open, under /dev/serial/by-id if possible.

    Args:
        wanted: a path, which is used as it is; a USB serial number; "" or "auto" for the only board.

    Raises:
        PortError: no port fits, or several do and a person must choose.
    """
    if "/" in wanted or wanted.upper().startswith("COM"):
        return wanted
    found = list(find_ports() if ports is None else ports)
    if wanted not in ("", "auto"):
        fitting = [info for info in found if info.serial_number == wanted]
        missing = f"no port with serial number '{wanted}'"
    else:
        fitting = [info for info in found if info.vid_pid in BOARDS] or [info for info in found if info.vid_pid]
        missing = "no controller found: no USB serial port is plugged in"
    if len(fitting) == 1:
        return fitting[0].by_id or fitting[0].device
    if not fitting:
        raise PortError(f"{missing}; {_listed(found)}")
    names = ", ".join(map(describe, found))
    raise PortError(f"{len(fitting)} ports could be the controller, name one: {names}")


def _listed(ports: Iterable[PortInfo]) -> str:
    names = ", ".join(map(describe, ports))
    return f"ports found: {names}" if names else "no serial port was found at all"


def identify(path: str, ports: Iterable[PortInfo] | None = None) -> PortInfo:
    """The properties of the port at `path`, by which to find it again; a pseudo terminal has only its path."""
    real = str(Path(path).resolve())
    for info in find_ports() if ports is None else ports:
        if real in (info.device, str(Path(info.device).resolve())):
            return info
    return PortInfo(device=path, by_id="", description="", vid_pid="", serial_number="")


def find_again(known: PortInfo, ports: Iterable[PortInfo] | None = None) -> str:
    """The present path of a known port, even if its number changed: by USB ids and serial number, else by its path.

    Raises:
        PortError: no port has its serial number; the port at its old path belongs to another board.
    """
    if not known.serial_number:
        return known.by_id or known.device
    found = list(find_ports() if ports is None else ports)
    for info in found:
        if (info.vid_pid, info.serial_number) == (known.vid_pid, known.serial_number):
            return info.device
    raise PortError(f"{describe(known)} is not there any more; {_listed(found)}")


try:
    from termios import error as _TerminalError
except ImportError:  # Windows has no termios; its ports do not raise this error.
    _TerminalError = OSError  # type: ignore[assignment, misc]

_POLL_S = 0.02
_WRITE_TIMEOUT_S = 1.0


class SerialLink:
    """A serial port as a Link. Every failure of the port is a LinkLost."""

    def __init__(self, port: serial.Serial, clock: Clock):
        self._port = port
        self._clock = clock

    @property
    def name(self) -> str:
        return str(self._port.port)

    def write(self, data: bytes) -> None:
        self._require_open()
        try:
            self._port.write(data)
        except OSError as problem:
            raise self._lost(problem) from problem

    def read(self, timeout_s: float) -> bytes:
        self._require_open()
        end = self._clock.now() + timeout_s
        # A port raises SerialException, which is an OSError, or a plain OSError from in_waiting.
        try:
            while not (first := self._port.read(1)):
                if self._clock.now() >= end:
                    return b""
            waiting = self._port.in_waiting
            return bytes(first + self._port.read(waiting)) if waiting else bytes(first)
        except OSError as problem:
            raise self._lost(problem) from problem

    def close(self) -> None:
        # A port that went away cannot be closed and need not be.
        with contextlib.suppress(OSError):
            self._port.close()

    def _require_open(self) -> None:
        if not self._port.is_open:
            raise LinkLost(f"{self.name} is closed") from OSError(errno.EBADF, "closed")

    def _lost(self, problem: OSError) -> LinkLost:
        return LinkLost(f"{self.name} went away ({reason(problem)}); check cable and power")


def open_port(wanted: str, baud: int, clock: Clock | None = None) -> tuple[SerialLink, Callable[[], SerialLink]]:
    """Open the port of a board; `wanted` as for `choose_port`.

    Returns:
        The open link, and a function that finds the same board again, even under another port number, and opens it.

    Raises:
        PortError: no port, several, port missing or in use, or no permission.
    """
    path = choose_port(wanted)
    link = open_serial(path, baud, clock)
    known = identify(path)
    return link, lambda: open_serial(find_again(known), baud, clock)


def open_serial(port: str, baud: int = 250_000, clock: Clock | None = None) -> SerialLink:
    """Open a serial port for exclusive use, with DTR and RTS off. Raises PortError, which says how to mend it."""
    device = serial.Serial()
    device.port = port
    device.baudrate = baud
    device.timeout = _POLL_S
    device.write_timeout = _WRITE_TIMEOUT_S
    device.exclusive = True
    device.dtr = False
    device.rts = False
    try:
        device.open()
    except (OSError, ValueError, _TerminalError) as problem:
        # A port that goes away during setup raises termios.error through pyserial, which is no OSError.
        raise port_error(port, problem) from problem
    return SerialLink(device, clock or Clock())


def port_error(port: str, problem: Exception) -> PortError:
    """The error for a failure to open, with its remedy."""
    there = f"; {_listed(find_ports())}"
    code = problem.args[0] if isinstance(problem, _TerminalError) and problem.args else getattr(problem, "errno", None)
    path = Path(port)
    if path.is_dir():
        return PortError(f"{port} is a folder, expected a serial port{there}")
    if code == errno.ENOENT or (code is None and not path.exists()):
        return PortError(f"there is no port {port}{there}")
    if code in (errno.EACCES, errno.EPERM):
        return PortError(
            f"no permission to use {port}: add yourself to its group "
            "('sudo usermod -a -G dialout $USER' on most systems), then log in again"
        )
    if code in (errno.EBUSY, errno.EAGAIN, errno.EWOULDBLOCK) or "exclusively lock" in str(problem):
        return PortError(f"{port} is taken: another program has it open; end that one first")
    if code == errno.ENOTTY or "Could not configure" in str(problem):
        return PortError(f"{port} is no serial port ({reason(problem)}){there}")
    return PortError(f"cannot open {port} ({reason(problem)}){there}")


def reason(problem: Exception) -> str:
    """The system's own message, in one line, without pyserial's additions."""
    strerror = getattr(problem, "strerror", None)
    if isinstance(problem, _TerminalError) and len(problem.args) > 1:
        strerror = str(problem.args[1])
    return " ".join((strerror or str(problem) or type(problem).__name__).split())
