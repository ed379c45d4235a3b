"""Stop-and-wait over a link (PROTOCOL.md, section 1): each line is repeated until answered, and carried out once.

Answers become refusals, faults and resets; waits for an end feed the watchdog."""

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from scanrig.clock import Clock
from scanrig.controllers.controller import Firmware, LinkCounts, Status
from scanrig.controllers.jxs.protocol import (
    ABORT,
    LAST_SEQUENCE,
    Damaged,
    Event,
    LineReader,
    Message,
    Nak,
    Refusal,
    Reply,
    command_text,
    encode,
    integer,
    next_sequence,
    read_fault,
    read_refusal,
    read_status,
)
from scanrig.errors import ControllerReset, Fault, LinkLost, Reason, Refused, RigFault, RigTimeout
from scanrig.wire import Link


FIRST_WAIT = 0.25
"""The first wait for an answer, as a fraction of the longest wait; each further wait is twice as long. An answer takes
milliseconds, and two lost lines in a row must not trip the controller's watchdog."""

AFTER_DAMAGE = 0.1
"""How long to wait after a damaged line, which probably was the answer; as a fraction of the longest wait."""

MOST_SENDS = 8
"""A line is sent at most this many times per try, however fast it is refused as damaged."""

KEPT_RAW = 4

MOST_MISSED = 1000
"""Most events that may be lost between two commands: a number farther ahead than this is an older one."""

MOST_NAMES, OTHER = 32, "others"
"""Events are counted by this many names, more than the protocol has; all further names count as one."""

MOST_EVENTS = 1000
"""Events that are kept until somebody looks at them; of more, the oldest are dropped."""


class Exchange:
    """Sends commands, receives answers and events, and counts gaps. Knows lines, not their meaning.

    Attributes:
        events: events received and not looked at yet.
        counts: of lines sent, resent and damaged.
        seq: number of the last line sent.
        boot: boot number in the last answer to HELLO.
        restarted: the error to raise if the controller was reset since; else None.
        odd_lines: the last lines that are not of this protocol; they tell a person which device is on the port.
    """

    def __init__(self, link: Link, clock: Clock, *, timeout_s: float, tries: int):
        self.link = link
        self.clock = clock
        self.timeout_s = timeout_s
        self.tries = tries
        self.counts = LinkCounts()
        self.events: deque[Event] = deque(maxlen=MOST_EVENTS)
        self.odd_lines: deque[bytes] = deque(maxlen=KEPT_RAW)
        self.boot: int | None = None
        self.restarted: ControllerReset | None = None
        self.seq = 0
        self._reader = LineReader()
        self._half_line = False
        self._last_event: int | None = None
        self._event_when_asked: int | None = None
        self._hello: int | None = None

    def attach(self, link: Link) -> None:
        """Continue over another link; lines and events of the old one are discarded."""
        self.link = link
        self.forget()

    def forget(self) -> None:
        """Discard events and half lines; gaps in the events' numbers are ignored until HELLO is answered."""
        self.events.clear()
        self._reader = LineReader()
        self._half_line = True
        self._last_event = None

    def ask(self, verb: str, *, tries: int | None = None, **args: int) -> dict[str, str]:
        """Send a command and repeat it until it is answered.

        Args:
            verb, args: the command.
            tries: replaces the usual number of tries.

        Returns:
            The fields of the answer.

        Raises:
            Refused: the controller refused the command.
            LinkLost: no answer after `tries` times the longest wait, or the port failed.
        """
        self.seq = seq = next_sequence(self.seq)
        line = encode(seq, verb, **args)
        self._hello = seq if verb == "HELLO" else None
        self._event_when_asked = self._last_event
        tries = tries or self.tries
        start = self.clock.now()
        give_up = start + tries * self.timeout_s
        wait = FIRST_WAIT * self.timeout_s
        sends = 0
        while sends < tries * MOST_SENDS and (sends == 0 or self.clock.now() < give_up):
            self._send(line, again=sends > 0)
            sends += 1
            answer = self._answer(seq, wait)
            self.counts.unanswered += answer is None
            wait = min(2 * wait, self.timeout_s)
            if isinstance(answer, Refusal):
                raise Refused(read_refusal(answer.code, verb), command_text(verb, **args), f"error {answer.code}")
            if isinstance(answer, Reply):
                return answer.fields
        raise LinkLost(
            f"no answer from {self.link.name} to '{command_text(verb, **args)}', sent {sends} times in "
            f"{self.clock.now() - start:.1f} s; check cable and power"
        )

    def listen(self, timeout_s: float) -> None:
        """Wait for events; return as soon as anything came."""
        for message in self._receive(timeout_s):
            if not isinstance(message, Event | Damaged):
                self.counts.strays += 1

    def abort(self) -> None:
        """Send the abort byte, which works outside of lines."""
        self.link.write(ABORT)

    def note_last_event(self, number: int) -> None:
        """Take the number of events from the answer just received; events that have not come by now are lost."""
        if self._last_event is None or self._event_when_asked is None:
            return
        if number < self._event_when_asked and not _went_round(self._event_when_asked, number):
            # It counts from the beginning again without a HELLO: it was reset.
            self.restarted = self.restarted or ControllerReset(self.boot, None)
        # A repeated answer has the contents of the first one; newer events may have come before it.
        missed = (number - self._last_event) % LAST_SEQUENCE
        if missed < MOST_MISSED:
            self.counts.events_missed += missed
            self._last_event = number

    def _send(self, line: bytes, again: bool) -> None:
        start = b"\n" if again or self._half_line else b""
        # An interrupt during the write leaves half a line; the next line must end it first.
        self._half_line = True
        with self._failures():
            self.link.write(start + line)
        self._half_line = False
        self.counts.sent += 1
        self.counts.resent += again

    def _answer(self, seq: int, wait_s: float) -> Reply | Refusal | None:
        """The answer to seq; None when it is time to send again."""
        deadline = self.clock.now() + wait_s
        while True:
            answer: Reply | Refusal | None = None
            resend = False
            for message in self._receive(max(deadline - self.clock.now(), 0.0)):
                match message:
                    case Reply() | Refusal() if message.seq == seq:
                        answer = message
                    case Reply() | Refusal():
                        self.counts.strays += 1
                    case Nak():
                        self.counts.naks += 1
                        resend = True
                    case Damaged():
                        deadline = min(deadline, self.clock.now() + AFTER_DAMAGE * self.timeout_s)
            if answer or resend or self.clock.now() >= deadline:
                return answer

    def _receive(self, timeout_s: float) -> list[Message]:
        """The messages of one read; events are filed and counted."""
        with self._failures():
            data = self.link.read(timeout_s)
        messages = self._reader.feed(data)
        for message in messages:
            if not isinstance(message, Damaged):
                self.counts.unanswered = 0
            if isinstance(message, Event):
                self._file(message)
            elif isinstance(message, Reply) and message.seq == self._hello:
                # A session begins: earlier events belong to another one, and events count from 1 again.
                self.events.clear()
                self._last_event = 0
            elif isinstance(message, Damaged):
                self.counts.damaged += 1
                self.odd_lines.append(message.raw)
        return messages

    @contextmanager
    def _failures(self) -> Iterator[None]:
        """Counts a port that fails."""
        try:
            yield
        except LinkLost:
            self.counts.unanswered += 1
            raise

    def _file(self, event: Event) -> None:
        self.counts.events += 1
        by_name = self.counts.events_by_name
        name = event.name if event.name in by_name or len(by_name) < MOST_NAMES else OTHER
        by_name[name] = by_name.get(name, 0) + 1
        if event.name == "BOOT":
            boot = event.fields.get("boot", "")
            now = int(boot) if boot.isdecimal() and len(boot) <= 10 else None
            if self.boot is not None and now != self.boot:
                self.restarted = ControllerReset(self.boot, now)
        elif self._last_event is not None:
            self.counts.events_missed += (event.number - self._last_event - 1) % LAST_SEQUENCE
            self._last_event = event.number
        self.events.append(event)


def _went_round(before: int, after: int) -> bool:
    """Whether an event's number is smaller than an earlier one's because 65535 is followed by 1."""
    return (after - before) % LAST_SEQUENCE < MOST_MISSED


POLL_S = 0.1
"""Time between two polls while something runs: well below the controller's watchdog, 500 ms by default."""

T = TypeVar("T")


class Conversation:
    """An exchange that turns refusals, events and silence into RigFault, ControllerReset and LinkLost.

    Attributes:
        firmware: the firmware that answered HELLO last.
        enabled: whether the motor driver was switched on; if it is off now, the controller was reset.
        broken: whether the port itself failed, so that it must be opened again.
    """

    def __init__(self, wire: Exchange, clock: Clock):
        self.wire = wire
        self.firmware: Firmware | None = None
        self.enabled = False
        self.broken = False
        self._clock = clock
        self._begun = 0

    def ask(self, verb: str, **args: int) -> dict[str, str]:
        """The fields of a command's answer.

        Raises:
            Refused: the controller refused the command.
            RigFault: it refused because it is in a fault.
            ControllerReset: it was reset and knows no session.
            LinkLost: no answer.
        """
        self.raise_reset()
        try:
            return self.wire.ask(verb, **args)
        except LinkLost as problem:
            # A port that fails must be opened again. A silent one is kept open, since opening it resets an Uno.
            self.broken = problem.__cause__ is not None
            raise
        except Refused as refusal:
            if refusal.reason is Reason.NO_SESSION and self.firmware is not None:
                self._note_reset()
                self.raise_reset()
            if refusal.reason is Reason.IN_FAULT:
                self.poll()
            raise

    def stat(self) -> Status:
        """Ask for the state.

        Raises:
            ControllerReset: it has been reset since HELLO.
        """
        says = self.ask("STAT")
        status = read_status(says)
        self.wire.note_last_event(integer(says, "ev"))
        if self.enabled and not status.enabled:
            if status.state == "fault":
                self.enabled = False
            else:
                # The host did not switch the driver off, so there was a reset whose event was lost.
                self._note_reset()
        self.raise_reset()
        return status

    def poll(self) -> Status:
        """Ask for the state, and raise its fault if it is in one."""
        status = self.stat()
        if status.state == "fault":
            raise RigFault(status.fault or Fault.UNKNOWN, status.position)
        return status

    def clear(self) -> None:
        """Leave a fault.

        Raises:
            Refused: the emergency stop is still pressed.
            RigFault: another fault came at the same moment and was not reported yet.
        """
        try:
            self.ask("CLEAR")
        except Refused:
            if not self.stat().estop:
                self.poll()
            raise
        self.wire.events.clear()
        # The emergency stop switches the driver off; that does not mean a reset.
        self.enabled = read_status(self.ask("STAT")).enabled

    def begin(self, verb: str, **args: int) -> None:
        """Send a command whose end is an event."""
        # Events of earlier commands must not count as the end of this one.
        kept = [event for event in self.wire.events if event.name == "FAULT"]
        self.wire.events.clear()
        self.wire.events.extend(kept)
        self.ask(verb, **args)
        self._begun = self.wire.seq

    def is_end(self, event: Event, name: str) -> bool:
        """Whether an event ends the command that was begun last, not an earlier one."""
        return event.name == name and event.fields.get("seq") == str(self._begun)

    def wait(self, action: str, timeout_s: float, told: Callable[[Event], T | None], idle: Callable[[Status], T]) -> T:
        """Wait for an event, and poll meanwhile: the event may be lost, and the watchdog must be fed.

        Args:
            action: the action that is to end, for the message.
            told: reads the result from the event; None for any other event.
            idle: reads the result from the state once nothing runs any more.

        Returns:
            The result of `told` or `idle`.

        Raises:
            RigFault, ControllerReset: a fault or a reset ended it.
            RigTimeout: it did not end in time and was stopped.
        """
        give_up = self._clock.now() + timeout_s
        next_poll = self._clock.now() + POLL_S
        while True:
            done = self._look_at_events(told)
            if done is not None:
                return done
            self.raise_reset()
            now = self._clock.now()
            if now >= give_up:
                self.ask("STOP")
                raise RigTimeout(f"{action} did not end within {timeout_s:.1f} s; it was stopped")
            if now < next_poll:
                self._listen(next_poll - now)
                continue
            status = self.poll()
            next_poll = self._clock.now() + POLL_S
            if status.state == "idle":
                done = self._look_at_events(told)
                return idle(status) if done is None else done

    def raise_reset(self) -> None:
        """Raise ControllerReset if a reset was noticed since HELLO."""
        if self.wire.restarted is not None:
            self.enabled = False
            raise self.wire.restarted

    def _note_reset(self) -> None:
        if self.wire.restarted is None:
            self.wire.restarted = ControllerReset(self.wire.boot, None)

    def _listen(self, timeout_s: float) -> None:
        try:
            self.wire.listen(timeout_s)
        except LinkLost:
            self.broken = True
            raise

    def _look_at_events(self, told: Callable[[Event], T | None]) -> T | None:
        while self.wire.events:
            event = self.wire.events.popleft()
            if event.name == "FAULT":
                raise RigFault(read_fault(integer(event.fields, "f")), integer(event.fields, "pos"))
            done = told(event)
            if done is not None:
                return done
        return None
