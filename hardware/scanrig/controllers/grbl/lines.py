"""Stop-and-wait with a GRBL board: a line is sent and answered by "ok" or "error:n"; single bytes work at any time."""

import logging
import re
from collections import deque
from collections.abc import Callable

from scanrig.clock import Clock
from scanrig.controllers.grbl.report import ALARMS, Report, read_report
from scanrig.controllers.status import LinkCounts
from scanrig.errors import ControllerReset, Fault, LinkLost, Reason, Refused, RigFault
from scanrig.wire import Link


log = logging.getLogger(__name__)

RESET = b"\x18"
HOLD = b"!"
QUERY = b"?"

ANSWER_S = 1.0
"""The longest wait for an answer to what is done at once."""
TRIES = 3
"""A line that is not answered, or not understood, may have come damaged; all lines of this host may be sent again."""
POLL_S = 0.05
_STILL = 3
QUIET_S = 0.15
"""Silence after which no late answer is expected any more."""
BOOT_S = 2.5
"""A board that is reset when its port is opened needs this long."""

_KEPT = 4
_LONGEST = 256
_ERROR = re.compile(r"error:(\d+)")
_ALARM = re.compile(r"ALARM:(\d+)")
_SAID_UNASKED = re.compile(r"\[.*\]|\$.*=.*|>.*:.*")
_REFUSALS = {2: Reason.NOT_UNDERSTOOD, 5: Reason.NO_SUCH_PART, 8: Reason.BUSY, 9: Reason.IN_FAULT, 11: Reason.TOO_LONG}


class GrblLines:
    """A link to a board, as lines.

    Attributes:
        counts: what the line did.
        alarm: the number of the alarm that it is in; None: none.
        resets: how often the board began anew without being asked to.
        greeting: what it said of itself when it began.
        expected_greeting: how that has to begin.
        broken: whether the port itself failed, so that it must be opened again.
        odd: the last lines that were none of GRBL's.
    """

    def __init__(self, link: Link, clock: Clock, *, greeting: str, reopen: Callable[[], Link]):
        self.link, self.clock = link, clock
        self.counts = LinkCounts()
        self.alarm: int | None = None
        self.resets = 0
        self.greeting = ""
        self.broken = False
        self.odd: deque[str] = deque(maxlen=_KEPT)
        self.expected_greeting, self._reopen = greeting, reopen
        self._rest = b""
        self._expected = False
        """Whether a greeting is on its way that was asked for."""
        self._told_reset = 0

    def ask(self, command: str) -> list[str]:
        """Send a line that is carried out at once, until it is answered.

        Returns:
            What it said before "ok".

        Raises:
            Refused: the board answered an error each time.
            RigFault: it is in an alarm, and answers nothing.
            ControllerReset: it began anew meanwhile.
            LinkLost: no answer.
        """
        error = ""
        for attempt in range(TRIES):
            if attempt:
                self.drain()
                self.counts.resent += 1
            self.send(command)
            said, error = self._answer()
            if error == "ok":
                return said
            if not error and self.alarm is not None:
                break
        number = int(match[1]) if (match := _ERROR.fullmatch(error)) else None
        if number is None and self.alarm is not None:
            # After a limit was hit, GRBL answers nothing until it is reset.
            raise RigFault(ALARMS.get(self.alarm, Fault.UNKNOWN), None, f"ALARM:{self.alarm}")
        if number is None:
            raise LinkLost(f"no answer from {self.link.name} to '{command}', sent {TRIES} times; check cable and power")
        raise Refused(_REFUSALS.get(number, Reason.UNKNOWN), command, error)

    def ask_long(self, command: str, timeout_s: float) -> bool:
        """Send a line that is answered when its motion is over; GRBL says nothing while it looks for home.

        Returns:
            Whether it ended, by an answer, an alarm, or rest that is reported where the answer was lost.

        Raises:
            Refused: the board answered an error.
            ControllerReset, LinkLost: as of `ask`.
        """
        self.send(command)
        give_up = self.clock.now() + timeout_s
        idle = 0
        while idle < _STILL and self.clock.now() < give_up:
            self.write(QUERY)
            for line in self.read(ANSWER_S):
                if match := _ERROR.fullmatch(line):
                    raise Refused(_REFUSALS.get(int(match[1]), Reason.UNKNOWN), command, line)
                if line == "ok" or _ALARM.fullmatch(line):
                    return True
                report = read_report(line)
                idle += report is not None and report.state == "Idle"
        return idle >= _STILL

    def send(self, command: str) -> None:
        """Send a line without waiting for its answer."""
        self.write(command.encode("ascii") + b"\n")
        self.counts.sent += 1

    def write(self, data: bytes) -> None:
        """Send bytes. Raises LinkLost."""
        try:
            self.link.write(data)
        except LinkLost:
            self.broken = True
            raise

    def report(self) -> Report:
        """Ask for the state.

        Raises:
            ControllerReset: it began anew.
            LinkLost: no answer.
        """
        for _ in range(TRIES):
            self.write(QUERY)
            give_up = self.clock.now() + ANSWER_S
            while (left := give_up - self.clock.now()) > 0:
                reports = [report for line in self.read(left) if (report := read_report(line))]
                if reports:
                    return reports[-1]
        raise LinkLost(f"no answer from {self.link.name} to '?'; check cable and power")

    def reset(self) -> None:
        """Soft reset: laser off, motion stopped, everything that waits forgotten; the place is kept if it was at rest.

        Raises:
            LinkLost: it does not say that it has begun anew.
        """
        for _ in range(TRIES):
            self.abort()
            if self.await_greeting(ANSWER_S):
                return
        self._expected = False
        raise LinkLost(f"{self.link.name} does not answer a reset; check cable and power")

    def abort(self) -> None:
        """The byte of a soft reset, without waiting for what it does."""
        self._expected = True
        self.write(RESET)

    def await_greeting(self, timeout_s: float) -> bool:
        """Whether it begins anew within a time."""
        self.greeting = ""
        give_up = self.clock.now() + timeout_s
        while not self.greeting and (left := give_up - self.clock.now()) > 0:
            self.read(left, tell_reset=False)
        if self.greeting:
            self._expected = False
        return bool(self.greeting)

    def read(self, timeout_s: float, *, tell_reset: bool = True) -> list[str]:
        """Lines that came, as soon as something came; greetings and alarms are taken note of.

        Raises:
            ControllerReset: the board began anew, and nobody had asked it to.
            LinkLost: the port failed.
        """
        try:
            data = self.link.read(max(timeout_s, 0.0))
        except LinkLost:
            self.broken = True
            raise
        *lines, rest = (self._rest + data.replace(b"\r", b"")).split(b"\n")
        self._rest = rest[:_LONGEST]
        texts = [line.decode("ascii", "replace") for line in lines if line]
        for text in texts:
            self._note(text)
        if tell_reset:
            self.raise_reset()
        return texts

    def raise_reset(self) -> None:
        """Raise a reset that was noticed and not told yet."""
        if self.resets > self._told_reset:
            raise ControllerReset(self._told_reset, self.resets)

    def forget_reset(self) -> None:
        """A reset that was noticed is known now."""
        self._told_reset = self.resets

    def drain(self) -> None:
        """Let late answers come, and forget them."""
        while self.read(QUIET_S):
            continue

    def open_again(self) -> None:
        """Open the port again where it failed. Raises PortError."""
        if self.broken:
            self.link.close()
            self.link = self._reopen()
            self._rest, self.broken = b"", False

    def _note(self, text: str) -> None:
        if text.startswith(self.expected_greeting):
            self.greeting = text
            if not self._expected:
                self.resets += 1
                self.alarm = None
            self._expected = False
        elif match := _ALARM.fullmatch(text):
            self.alarm = int(match[1])
        elif text.startswith("ALARM"):
            self.alarm = 0
        elif not (text == "ok" or _ERROR.fullmatch(text) or read_report(text) or _SAID_UNASKED.fullmatch(text)):
            self.counts.damaged += 1
            self.odd.append(text)
            log.info("%s: a line that is none of GRBL's: %r", self.link.name, text[:80])

    def _answer(self) -> tuple[list[str], str]:
        """What was said before the answer, and the answer: "ok", "error:n", or "" where none came."""
        said: list[str] = []
        give_up = self.clock.now() + ANSWER_S
        while (left := give_up - self.clock.now()) > 0:
            for line in self.read(left):
                if line == "ok" or _ERROR.fullmatch(line):
                    return said, line
                said.append(line)
        return said, ""
