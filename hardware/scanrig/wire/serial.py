"""A serial port as a link, opened for exclusive use."""

import errno
from pathlib import Path

import serial

from scanrig.clock import Clock, SystemClock
from scanrig.errors import LinkLost, PortError
from scanrig.wire.ports import describe, find_ports


try:
    from termios import error as _TerminalError
except ImportError:  # Windows has no termios; its ports do not raise this error.
    _TerminalError = OSError  # type: ignore[assignment, misc]

POLL_S = 0.02
WRITE_TIMEOUT_S = 1.0


class SerialLink:
    """A serial port as a Link. Every failure of the port is a LinkLost."""

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
        """The bytes received, as soon as there are any; b"" after timeout_s. Raises LinkLost."""
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
            raise LinkLost(lost(self.name, problem)) from problem

    def _require_open(self) -> None:
        if not self._port.is_open:
            raise LinkLost(f"{self.name} is closed") from OSError(errno.EBADF, "closed")

    def close(self) -> None:
        """Close the port."""
        try:
            self._port.close()
        except OSError:
            # A port that went away cannot be closed and need not be.
            return


def lost(name: str, problem: OSError) -> str:
    """The message about a port that stopped working."""
    return f"{name} went away ({reason(problem)}); check cable and power"


def open_serial(port: str, baud: int = 250_000, clock: Clock | None = None) -> SerialLink:
    """Open a serial port for exclusive use, with DTR and RTS off.

    Args:
        port: its path, preferably the one under /dev/serial/by-id, which stays the same when it is plugged in again.
        baud: bits per second.
        clock: for the waits of reading.

    Returns:
        The open link.

    Raises:
        PortError: it is missing, in use, no serial port, or there is no permission; the message says how to mend it.
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
        # A port that goes away during setup raises termios.error through pyserial, which is no OSError.
        raise port_error(port, problem) from problem
    return SerialLink(device, clock or SystemClock())


def port_error(port: str, problem: Exception) -> PortError:
    """The error for a failure to open, with its remedy."""
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
            f"no permission to use {port}: add yourself to its group "
            "('sudo usermod -a -G dialout $USER' on most systems), then log in again"
        )
    elif code in (errno.EBUSY, errno.EAGAIN, errno.EWOULDBLOCK) or "exclusively lock" in str(problem):
        says = f"{port} is taken: another program has it open; end that one first"
    elif code == errno.ENOTTY or "Could not configure" in str(problem):
        says = f"{port} is no serial port ({reason(problem)}){there}"
    else:
        says = f"cannot open {port} ({reason(problem)}){there}"
    return PortError(says, candidates)


def reason(problem: Exception) -> str:
    """The system's own message, in one line, without pyserial's additions."""
    strerror = getattr(problem, "strerror", None)
    if isinstance(problem, _TerminalError) and len(problem.args) > 1:
        strerror = str(problem.args[1])
    return " ".join((strerror or str(problem) or type(problem).__name__).split())
