"""Stop-and-wait over a link: a line is sent until it is answered, and carried out once (PROTOCOL.md, section 1)."""

from collections import deque

from scanrig.clock import Clock
from scanrig.controllers.jxs.answers import read_refusal
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
    next_sequence,
)
from scanrig.controllers.status import LinkCounts
from scanrig.errors import ControllerReset, LinkLost, Refused
from scanrig.wire.link import Link


FIRST_WAIT = 0.25
"""The first wait for an answer, as a part of the longest. An answer takes milliseconds, and two lines that go missing
one after the other must not starve the controller's link watchdog; every further wait is twice as long."""

AFTER_DAMAGE = 0.1
"""How long to go on waiting after a damaged line, as a part of the longest wait: it probably was the answer."""

MOST_SENDS = 8
"""A line is sent at most this many times as often as there are tries, however fast it is refused as damaged."""

KEPT_RAW = 4

MOST_MISSED = 1000
"""More events than this are never lost between two questions: a number that far ahead is an older one."""


class Exchange:
    """Questions and answers, events and their gaps. Knows lines, not what they mean.

    Attributes:
        events: what came and was not looked at yet.
        counts: what the line did.
        seq: the number of the last line that was sent.
        boot: of the controller that answered HELLO last.
        restarted: set where the controller was reset since.
        odd_lines: the last lines that were none of this protocol's, to tell a person what is on the port.
    """

    def __init__(self, link: Link, clock: Clock, *, timeout_s: float, tries: int):
        self.link = link
        self.clock = clock
        self.timeout_s = timeout_s
        self.tries = tries
        self.counts = LinkCounts()
        self.events: deque[Event] = deque()
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
        """Go on over another link; what had come over the old one is forgotten."""
        self.link = link
        self.forget()

    def forget(self) -> None:
        """Forget events and half lines; gaps in the events' numbers mean nothing until HELLO is answered."""
        self.events.clear()
        self._reader = LineReader()
        self._half_line = True
        self._last_event = None

    def ask(self, verb: str, *, tries: int | None = None, **args: int) -> dict[str, str]:
        """Send a command until it is answered.

        Args:
            verb, args: the command.
            tries: instead of the usual ones.

        Returns:
            The fields of the answer.

        Raises:
            Refused: the controller answered that it will not.
            LinkLost: no answer after `tries` times the longest wait, or the link broke.
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
        """Wait for whatever comes unasked; return as soon as anything did."""
        for message in self._receive(timeout_s):
            if not isinstance(message, Event | Damaged):
                self.counts.strays += 1

    def abort(self) -> None:
        """Send the byte that works outside of lines."""
        self.link.write(ABORT)

    def note_last_event(self, number: int) -> None:
        """The answer just received says how many events there were; what has not come by now never will."""
        if self._last_event is None or self._event_when_asked is None:
            return
        if number < self._event_when_asked and not _went_round(self._event_when_asked, number):
            # It counts anew, and nobody here asked it to.
            self.restarted = self.restarted or ControllerReset(self.boot, None)
        # An answer that was repeated is as old as the first time it was sent; events may have overtaken it.
        missed = (number - self._last_event) % LAST_SEQUENCE
        if missed < MOST_MISSED:
            self.counts.events_missed += missed
            self._last_event = number

    def _send(self, line: bytes, again: bool) -> None:
        start = b"\n" if again or self._half_line else b""
        # An interrupt between here and the end of writing leaves half a line behind, which the next one must end.
        self._half_line = True
        self.link.write(start + line)
        self._half_line = False
        self.counts.sent += 1
        self.counts.resent += again

    def _answer(self, seq: int, wait_s: float) -> Reply | Refusal | None:
        """The answer to seq; None where it is time to send again."""
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
        messages = self._reader.feed(self.link.read(timeout_s))
        for message in messages:
            if isinstance(message, Event):
                self._file(message)
            elif isinstance(message, Reply) and message.seq == self._hello:
                # A session begins here: what came before belongs to another, and events count from 1 again.
                self.events.clear()
                self._last_event = 0
            elif isinstance(message, Damaged):
                self.counts.damaged += 1
                self.odd_lines.append(message.raw)
        return messages

    def _file(self, event: Event) -> None:
        self.counts.events += 1
        by_name = self.counts.events_by_name
        by_name[event.name] = by_name.get(event.name, 0) + 1
        if event.name == "BOOT":
            boot = event.fields.get("boot", "")
            now = int(boot) if boot.isdecimal() else None
            if self.boot is not None and now != self.boot:
                self.restarted = ControllerReset(self.boot, now)
        elif self._last_event is not None:
            self.counts.events_missed += (event.number - self._last_event - 1) % LAST_SEQUENCE
            self._last_event = event.number
        self.events.append(event)


def _went_round(before: int, after: int) -> bool:
    """Whether an event's number is smaller than an earlier one's because after 65535 comes 1."""
    return (after - before) % LAST_SEQUENCE < MOST_MISSED
