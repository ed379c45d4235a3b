"""Commands, state and waiting within a session: what an answer means for what the controller was known to be."""

from collections.abc import Callable
from typing import TypeVar

from scanrig.clock import Clock
from scanrig.controllers.jxs.answers import integer, read_fault, read_status
from scanrig.controllers.jxs.exchange import Exchange
from scanrig.controllers.jxs.protocol import Event
from scanrig.controllers.status import Firmware, Status
from scanrig.errors import ControllerReset, Fault, LinkLost, Reason, Refused, RigFault, RigTimeout


POLL_S = 0.1
"""Between two questions while something runs: well under the controller's link watchdog, 500 ms by default."""

T = TypeVar("T")


class Conversation:
    """An exchange whose refusals, events and silences are turned into faults, resets and a lost link.

    Attributes:
        firmware: who answered HELLO last.
        enabled: whether the motor driver was switched on; if it is off all the same, there was a reset.
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
            Refused: the controller will not.
            RigFault: because it is in a fault.
            ControllerReset: because it has been reset and knows of no session.
            LinkLost: no answer.
        """
        self.raise_reset()
        try:
            return self.wire.ask(verb, **args)
        except LinkLost as problem:
            # A port that fails must be opened again; one that is silent must not yet: opening it resets an Uno.
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
                # Nobody switched the driver off, so it is the state after a reset whose event was lost.
                self._note_reset()
        self.raise_reset()
        return status

    def poll(self) -> Status:
        """Ask for the state, and raise the fault that it is in."""
        status = self.stat()
        if status.state == "fault":
            raise RigFault(status.fault or Fault.UNKNOWN, status.position)
        return status

    def clear(self) -> None:
        """Leave a fault.

        Raises:
            Refused: the emergency stop is still pressed.
            RigFault: another fault came at the same moment, of which nobody has been told yet.
        """
        try:
            self.ask("CLEAR")
        except Refused:
            if not self.stat().estop:
                self.poll()
            raise
        self.wire.events.clear()
        # The emergency stop has switched the driver off; that is no sign of a reset.
        self.enabled = read_status(self.ask("STAT")).enabled

    def begin(self, verb: str, **args: int) -> None:
        """A command whose end is an event."""
        # What is left of earlier commands must not be taken for the end of this one.
        kept = [event for event in self.wire.events if event.name == "FAULT"]
        self.wire.events.clear()
        self.wire.events.extend(kept)
        self.ask(verb, **args)
        self._begun = self.wire.seq

    def is_end(self, event: Event, name: str) -> bool:
        """Whether an event is the end of what was begun last, and not of what was begun earlier."""
        return event.name == name and event.fields.get("seq") == str(self._begun)

    def wait(self, what: str, timeout_s: float, told: Callable[[Event], T | None], idle: Callable[[Status], T]) -> T:
        """Wait for an event, and ask for the state meanwhile: the event may be lost, and the link must stay alive.

        Args:
            what: what is waited for, for the message.
            timeout_s: how long.
            told: what the event says; None for any other event.
            idle: what the state says once nothing runs any more.

        Returns:
            What `told` or `idle` said.

        Raises:
            RigFault, ControllerReset: the end that it took instead.
            RigTimeout: it did not end; it was stopped.
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
                raise RigTimeout(f"{what} did not end within {timeout_s:.1f} s; it was stopped")
            if now < next_poll:
                self._listen(next_poll - now)
                continue
            status = self.poll()
            next_poll = self._clock.now() + POLL_S
            if status.state == "idle":
                done = self._look_at_events(told)
                return idle(status) if done is None else done

    def raise_reset(self) -> None:
        """Raise a reset that was noticed, until HELLO."""
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
