"""Lines of G-code and their answers: units, dialects, reports, and the exchange with the board."""

import logging
import re
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from scanrig.clock import Clock
from scanrig.controllers.controller import LinkCounts, State
from scanrig.errors import ControllerReset, Fault, FirmwareError, LinkLost, Reason, Refused, RigFault
from scanrig.wire import Link


@dataclass(frozen=True)
class TableUnits:
    """Converts between microsteps of the table and units of a board's axis."""

    microsteps_per_turn: int
    units_per_turn: float
    reverse: bool = False
    """Whether the table's angle grows while the axis counts downwards."""

    @property
    def steps_per_unit(self) -> float:
        """The value that the board's setting $100 must have."""
        return self.microsteps_per_turn / self.units_per_turn

    def units(self, microsteps: float) -> float:
        return (-microsteps if self.reverse else microsteps) / self.steps_per_unit

    def microsteps(self, units: float) -> int:
        return round((-units if self.reverse else units) * self.steps_per_unit)


class Dialect(NamedTuple):
    """The answers of a family of boards, and their meaning."""

    name: str
    alarms: Mapping[int, Fault]
    unhomed: frozenset[int] = frozenset()
    """Alarms that only say that home is not known."""
    listed: bool = True
    """Whether `$$` lists the settings of the axes."""


_ALARMS = {
    1: Fault.LIMIT,
    2: Fault.LIMIT,
    3: Fault.ABORTED,
    6: Fault.HOME_NOT_FOUND,
    7: Fault.HOME_NOT_FOUND,
    8: Fault.HOME_NOT_FOUND,
    9: Fault.HOME_NOT_FOUND,
}
GRBL = Dialect("Grbl", _ALARMS)
GRBL_HAL = Dialect(
    "grblHAL",
    {**_ALARMS, 10: Fault.EMERGENCY_STOP, 12: Fault.LIMIT, 15: Fault.HOME_NOT_FOUND, 18: Fault.HOME_NOT_FOUND},
    unhomed=frozenset({11}),
)
FLUID_NC = Dialect(
    "FluidNC",
    {**_ALARMS, 11: Fault.EMERGENCY_STOP, 12: Fault.LIMIT, 13: Fault.LIMIT},
    unhomed=frozenset({14, 15}),
    listed=False,
)
_KNOWN = ((re.compile("fluidnc", re.IGNORECASE), FLUID_NC), (re.compile("grblhal", re.IGNORECASE), GRBL_HAL))


def dialect_of(greeting: str) -> Dialect:
    """The dialect of a board, by its first line after a reset; GRBL's own where it names none."""
    return next((dialect for sign, dialect in _KNOWN if sign.search(greeting)), GRBL)


STATES: dict[str, State] = {
    "Idle": "idle",
    "Check": "idle",
    "Run": "move",
    "Jog": "move",
    "Hold": "move",
    "Home": "home",
    "Alarm": "fault",
    "Door": "fault",
    "Sleep": "fault",
    "Tool": "fault",
}
"""GRBL's states as a session's. "Alarm" without a number, as after power on, only means that home is not known."""

_REPORT = re.compile(r"<([A-Z][a-z]+)(?::([0-9]{1,3}))?((?:\|[A-Za-z]+:[^|<>]*)*)>")
_NUMBER = re.compile(r"-?[0-9]{1,9}(?:\.[0-9]{0,9})?")
_SETTING = re.compile(rf"\$([0-9]{{1,3}})=({_NUMBER.pattern})")
_AXES = "XYZABC"


@dataclass(frozen=True)
class Report:
    """The answer to `?`."""

    state: str
    """Idle, Run, Hold, Jog, Home, Alarm, Door, Check, Sleep or Tool."""
    part: int
    """The number after the state: Hold:0 stands still, Hold:1 slows down, Alarm:10 is that alarm; 0 if there is none.
    """
    positions: tuple[float, ...] | None
    """Machine coordinates of the axes; None if the board reports others ($10)."""

    @property
    def moving(self) -> bool:
        """Whether the table turns."""
        return self.state in ("Run", "Jog", "Home") or (self.state == "Hold" and self.part != 0)

    def position(self, axis: str) -> float | None:
        """Coordinate of one axis; None if it is not reported."""
        at = _AXES.index(axis)
        return None if self.positions is None or at >= len(self.positions) else self.positions[at]


def read_report(line: str) -> Report | None:
    """The state report in a line; None if it is no report, or damaged."""
    match = _REPORT.fullmatch(line)
    if match is None or match[1] not in STATES:
        return None
    fields = dict(field.split(":", 1) for field in match[3].split("|")[1:])
    words = fields["MPos"].split(",") if "MPos" in fields else []
    if not all(map(_NUMBER.fullmatch, words)):
        return None
    return Report(match[1], int(match[2] or 0), tuple(map(float, words)) if words else None)


def read_settings(lines: list[str]) -> dict[int, float]:
    """The settings among the lines of the answer to `$$`."""
    return {int(match[1]): float(match[2]) for line in lines if (match := _SETTING.fullmatch(line))}


log = logging.getLogger(__name__)

RESET = b"\x18"
HOLD = b"!"
QUERY = b"?"

ANSWER_S = 1.0
"""Longest wait for the answer to a command that is carried out at once."""
TRIES = 3
"""A line without an answer, or with an error, may have arrived damaged. Every line of this host is safe to resend."""
POLL_S = 0.05
_STILL = 3
QUIET_S = 0.15
"""After this much silence no late answer is expected."""
BOOT_S = 2.5
"""Time that a board needs if opening its port resets it."""

_KEPT = 4
_LONGEST = 256
_ERROR = re.compile(r"error:(\d+)")
_ALARM = re.compile(r"ALARM:(\d+)")
_SAID_UNASKED = re.compile(r"\[.*\]|\$.*=.*|>.*:.*")
_REFUSALS = {
    2: Reason.NOT_UNDERSTOOD,
    5: Reason.NO_SUCH_PART,
    8: Reason.BUSY,
    9: Reason.IN_FAULT,
    11: Reason.TOO_LONG,
    79: Reason.IN_FAULT,
}


class GrblLines:
    """Sends lines to a board and receives its lines."""

    def __init__(self, link: Link, clock: Clock, *, greeting: str, reopen: Callable[[], Link]):
        """`greeting`: how the board's first line after a reset has to begin."""
        self.link, self.clock = link, clock
        self.counts = LinkCounts()
        self.alarm: int | None = None
        self.resets = 0
        self.greeting, self.dialect = "", GRBL
        """Its first line after a reset, and the dialect that it names."""
        self.broken = False
        """Whether the port itself failed, so that it must be opened again."""
        self.odd: deque[str] = deque(maxlen=_KEPT)
        self.heard = ""
        self.expected_greeting, self._reopen = greeting, reopen
        self._rest = b""
        self._expected = False
        """Whether this host requested a reset whose greeting has not come yet."""
        self.raised_reset = 0
        """Of these resets, those that were raised or are to be ignored."""
        self._unread = ""
        """The last report that was not understood."""

    def ask(self, command: str) -> list[str]:
        """Send a line that is carried out at once, and repeat it until it is answered.

        Returns:
            The lines before "ok".

        Raises:
            Refused: the board answered with an error each time.
            RigFault: the board is in an alarm and does not answer.
            ControllerReset: the board was reset meanwhile.
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
            fault = self.dialect.alarms.get(self.alarm, Fault.UNKNOWN)
            raise RigFault(fault, None, f"{self.dialect.name} says ALARM:{self.alarm}")
        if number is None:
            raise LinkLost(
                f"no answer from {self.link.name} to '{command}', sent {TRIES} times{self._instead()}; check cable and "
                "power"
            )
        raise Refused(_REFUSALS.get(number, Reason.UNKNOWN), command, error)

    def ask_long(self, command: str, timeout_s: float) -> bool:
        """Send a line that is answered when its motion is over; GRBL is silent during homing. Raises as `ask`.

        Returns:
            Whether it ended: by an answer, by an alarm, or, if the answer was lost, by reports of standstill.
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
        self.write(command.encode("ascii") + b"\n")
        self.counts.sent += 1

    def write(self, data: bytes) -> None:
        """Send bytes; raises LinkLost."""
        try:
            self.link.write(data)
        except LinkLost:
            self._lose()
            raise

    def report(self) -> Report:
        """Ask for the state.

        Raises:
            ControllerReset: the board was reset.
            FirmwareError: it answers, each time in a form that is not known.
            LinkLost: no answer.
        """
        for _ in range(TRIES):
            self._unread = ""
            self.write(QUERY)
            give_up = self.clock.now() + ANSWER_S
            while not self._unread and (left := give_up - self.clock.now()) > 0:
                reports = [report for line in self.read(left) if (report := read_report(line))]
                if reports:
                    return reports[-1]
            self.counts.unanswered += 1
        if self._unread:
            raise FirmwareError(
                f"{self.link.name}: found {self._unread[:60]!r} of {self.dialect.name}, which is not understood here; "
                f"expected <...|MPos:...> as of GRBL 1.1, with one of {', '.join(STATES)}"
            )
        raise LinkLost(f"no answer from {self.link.name} to '?'{self._instead()}; check cable and power")

    def _instead(self) -> str:
        return f"; it sent {self.odd[-1][:60]!r}" if self.odd else ""

    def reset(self) -> None:
        """Soft reset: laser off, motion stopped, queue emptied; the position is kept if the table stood still."""
        for _ in range(TRIES):
            self.abort()
            if self.await_greeting(ANSWER_S):
                return
        self._expected = False
        raise LinkLost(f"{self.link.name} does not answer a reset; check cable and power")

    def abort(self) -> None:
        """Send the soft-reset byte without waiting for its effect."""
        self._expected = True
        self.write(RESET)

    def await_greeting(self, timeout_s: float) -> bool:
        """Whether the board's greeting comes in time."""
        self.greeting = ""
        give_up = self.clock.now() + timeout_s
        while not self.greeting and (left := give_up - self.clock.now()) > 0:
            self.read(left, raise_resets=False)
        if self.greeting:
            self._expected = False
        return bool(self.greeting)

    def read(self, timeout_s: float, *, raise_resets: bool = True) -> list[str]:
        """The lines received, as soon as there are any; greetings and alarms are noted. Raises as `report`."""
        try:
            data = self.link.read(max(timeout_s, 0.0))
        except LinkLost:
            self._lose()
            raise
        *lines, rest = (self._rest + data.replace(b"\r", b"")).split(b"\n")
        self._rest = rest[:_LONGEST]
        texts = [line.decode("ascii", "replace") for line in lines if line]
        if texts:
            self.counts.unanswered = 0
        for text in texts:
            self._note(text)
        if raise_resets:
            self.raise_reset()
        return texts

    def raise_reset(self) -> None:
        if self.resets > self.raised_reset:
            raise ControllerReset(self.raised_reset, self.resets)

    def drain(self) -> None:
        """Read late answers and discard them."""
        while self.read(QUIET_S):
            continue

    def open_again(self) -> None:
        """Open the port again if it failed. Raises PortError."""
        if self.broken:
            self.link.close()
            self.link = self._reopen()
            self._rest, self.broken = b"", False

    def _lose(self) -> None:
        self.broken = True
        self.counts.unanswered += 1

    def _note(self, text: str) -> None:
        self.heard = text
        if text.startswith(self.expected_greeting):
            self.greeting, self.dialect = text, dialect_of(text)
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
            if text.startswith("<") and text.endswith(">"):
                self._unread = text
            log.info("%s: a line that is none of GRBL's: %r", self.link.name, text[:80])

    def _answer(self) -> tuple[list[str], str]:
        """The lines before the answer, and the answer: "ok", "error:n", or "" if none came."""
        said: list[str] = []
        give_up = self.clock.now() + ANSWER_S
        while (left := give_up - self.clock.now()) > 0:
            for line in self.read(left):
                if line == "ok" or _ERROR.fullmatch(line):
                    return said, line
                said.append(line)
        self.counts.unanswered += 1
        return said, ""
