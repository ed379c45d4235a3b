"""Commands, state and waiting within a session; finds faults, resets and a lost link in the answers."""

from collections.abc import Callable
from typing import TypeVar

from scanrig.clock import Clock
from scanrig.controllers.jxs.answers import integer, read_fault, read_status
from scanrig.controllers.jxs.exchange import Exchange
from scanrig.controllers.jxs.protocol import Event
from scanrig.controllers.status import Firmware, Status
from scanrig.errors import ControllerReset, Fault, LinkLost, Reason, Refused, RigFault, RigTimeout


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
            timeout_s: how long to wait.
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
