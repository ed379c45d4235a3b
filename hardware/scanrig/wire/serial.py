"""Bytes to and from the controller: a serial port, opened for one program alone."""

import errno
from pathlib import Path

import serial

from scanrig.clock import Clock, SystemClock
from scanrig.errors import LinkLost, PortError
from scanrig.wire.ports import describe, find_ports


try:
    from termios import error as _TerminalError
except ImportError:  # Not on Windows, whose ports raise nothing of the kind.
    _TerminalError = OSError  # type: ignore[assignment, misc]

POLL_S = 0.02
WRITE_TIMEOUT_S = 1.0


class SerialLink:
    """A serial port as a Link. Every trouble of it, of whatever type, is a LinkLost."""

    def __init__(self, port: serial.Serial, clock: Clock):
        self._port = port
        self._clock = clock

    @property
    def name(self) -> str:
        """The port's path."""
        return str(self._port.port)

    def write(self, data: bytes) -> None:
        """Send all of data. Raises LinkLost."""
        self._require_open()
        try:
            self._port.write(data)
        except OSError as problem:
            raise LinkLost(lost(self.name, problem)) from problem

    def read(self, timeout_s: float) -> bytes:
        """What has come, as soon as something has; b"" after timeout_s. Raises LinkLost."""
        self._require_open()
        end = self._clock.now() + timeout_s
        # Trouble of a port is a SerialException, or a bare OSError from in_waiting; the former is one of the latter.
        try:
            while not (first := self._port.read(1)):
                if self._clock.now() >= end:
                    return b""
            waiting = self._port.in_waiting
            return bytes(first + self._port.read(waiting)) if waiting else bytes(first)
        except OSError as problem:
            raise LinkLost(lost(self.name, problem)) from problem

    def _require_open(self) -> None:
        if not self._port.is_open:
            raise LinkLost(f"{self.name} is closed") from OSError(errno.EBADF, "closed")

    def close(self) -> None:
        """Give the port back."""
        try:
            self._port.close()
        except OSError:
            # A port that went away cannot be closed properly, and need not be.
            return


def lost(name: str, problem: OSError) -> str:
    """What to say of a port that stopped working."""
    return f"{name} went away ({reason(problem)}); check cable and power"


def open_serial(port: str, baud: int = 250_000, clock: Clock | None = None) -> SerialLink:
    """Open a serial port for this program alone, asking for neither DTR nor RTS.

    Args:
        port: its path, better the one under /dev/serial/by-id, which does not change from plug to plug.
        baud: bits per second.
        clock: whose seconds reading waits.

    Returns:
        The open link.

    Raises:
        PortError: it is missing, taken, no serial port, or there is no right to use it; each with what to do.
    """
    device = serial.Serial()
    device.port = port
    device.baudrate = baud
    device.timeout = POLL_S
    device.write_timeout = WRITE_TIMEOUT_S
    device.exclusive = True
    device.dtr = False
    device.rts = False
    try:
        device.open()
    except (OSError, ValueError, _TerminalError) as problem:
        # A port that goes away while it is set up is a termios.error, which is no OSError and comes through pyserial.
        raise port_error(port, problem) from problem
    return SerialLink(device, clock or SystemClock())


def port_error(port: str, problem: Exception) -> PortError:
    """A failure to open, sorted by what is to be done about it."""
    candidates = [describe(info) for info in find_ports()]
    there = "; ports found: " + ", ".join(candidates) if candidates else "; no serial port was found at all"
    code = getattr(problem, "errno", None)
    if isinstance(problem, _TerminalError) and problem.args:
        code = problem.args[0]
    path = Path(port)
    if path.is_dir():
        says = f"{port} is a folder, expected a serial port{there}"
    elif code == errno.ENOENT or (code is None and not path.exists()):
        says = f"there is no port {port}{there}"
    elif code in (errno.EACCES, errno.EPERM):
        says = (
            f"no right to use {port}: add yourself to its group ('sudo usermod -a -G dialout $USER' on most systems), "
            "then log in again"
        )
    elif code in (errno.EBUSY, errno.EAGAIN, errno.EWOULDBLOCK) or "exclusively lock" in str(problem):
        says = f"{port} is taken: another program has it open; end that one first"
    elif code == errno.ENOTTY or "Could not configure" in str(problem):
        says = f"{port} is no serial port ({reason(problem)}){there}"
    else:
        says = f"cannot open {port} ({reason(problem)}){there}"
    return PortError(says, candidates)


def reason(problem: Exception) -> str:
    """The system's own words, in one line, without pyserial's around them."""
    strerror = getattr(problem, "strerror", None)
    if isinstance(problem, _TerminalError) and len(problem.args) > 1:
        strerror = str(problem.args[1])
    return " ".join((strerror or str(problem) or type(problem).__name__).split())
