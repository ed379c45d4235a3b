"""Stop-and-wait over a link (PROTOCOL.md, section 1): each line is repeated until answered, and carried out once."""

from collections import deque

from scanrig.clock import Clock
from scanrig.controllers.controller import LinkCounts
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
    read_refusal,
)
from scanrig.errors import ControllerReset, LinkLost, Refused
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

MOST_EVENTS = 1000
"""Events that are kept until somebody looks at them; of more, the oldest are dropped."""


class Exchange:
    """Sends commands, receives answers and events, and counts gaps. Knows lines, not their meaning."""

    def __init__(self, link: Link, clock: Clock, *, timeout_s: float, tries: int):
        """The link counts as lost after `tries * timeout_s` without an answer."""
        self.link, self.clock = link, clock
        self.timeout_s, self.tries = timeout_s, tries
        self.counts = LinkCounts()
        self.events: deque[Event] = deque(maxlen=MOST_EVENTS)
        self.odd_lines: deque[bytes] = deque(maxlen=KEPT_RAW)
        """The last lines that are not of this protocol; they show a person which device is on the port."""
        self.boot: int | None = None
        self.restarted: ControllerReset | None = None
        """The error to raise if the controller was reset since; else None."""
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
        """Send a command and repeat it until it is answered; returns the fields of the answer.

        Raises:
            Refused: the controller refused the command.
            LinkLost: no answer after `tries` times the longest wait, or the port failed.
        """
        self.seq = seq = self.seq % LAST_SEQUENCE + 1
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
        try:
            self.link.write(start + line)
        except LinkLost:
            self.counts.unanswered += 1
            raise
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
        try:
            data = self.link.read(timeout_s)
        except LinkLost:
            self.counts.unanswered += 1
            raise
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

    def _file(self, event: Event) -> None:
        self.counts.events += 1
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
