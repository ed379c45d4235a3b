"""The controller's verbs: what a session asks of turntable, laser and trigger, and how it gets all of it made safe."""

import logging
import secrets
from collections.abc import Callable
from types import TracebackType
from typing import TypeVar

from scanrig.clock import Clock, SystemClock
from scanrig.errors import ControllerReset, FirmwareError, LinkLost, PortError, Refused, RigError, RigFault, RigTimeout
from scanrig.exchange import Exchange
from scanrig.greeting import Silence, greet, what_is_there
from scanrig.link import Link
from scanrig.protocol import PROTOCOL, Event
from scanrig.safety import UNCONFIRMED, make_safe
from scanrig.settings import Settings
from scanrig.status import (
    Counters,
    Firmware,
    LinkCounts,
    Reconnection,
    ShotDone,
    Status,
    integer,
    read_counters,
    read_status,
)


log = logging.getLogger(__name__)

POLL_S = 0.1
"""Between two questions while something runs: well under the controller's link watchdog, 500 ms by default."""

T = TypeVar("T")


class Controller:
    """A session with the rig's controller over a link.

    As a context manager it makes everything safe on the way out, whatever the way is.
    """

    def __init__(
        self,
        link: Link,
        clock: Clock | None = None,
        *,
        timeout_s: float = 0.25,
        tries: int = 8,
        reopen: Callable[[], Link] | None = None,
        session: int | None = None,
    ):
        """Nothing is sent yet.

        Args:
            link: to the controller.
            clock: for every wait.
            timeout_s: the longest wait for one answer.
            tries: the link is lost after this many times timeout_s without an answer.
            reopen: opens the port again for `reconnect`, wherever it is now.
            session: the number of this session, 1 … 2³¹−1; by default a random one.
        """
        self._clock = clock or SystemClock()
        self._wire = Exchange(link, self._clock, timeout_s=timeout_s, tries=tries)
        self._reopen = reopen
        self._session = session or secrets.randbelow(2**31 - 1) + 1
        self._firmware: Firmware | None = None
        self._settings: Settings | None = None
        self._enabled = False
        self._begun = 0
        self._broken = False
        self._closed = False

    # Session

    @property
    def link_counts(self) -> LinkCounts:
        """What the line did so far."""
        return self._wire.counts

    @property
    def link(self) -> Link:
        """What is below, at present."""
        return self._wire.link

    @property
    def settings(self) -> Settings | None:
        """What was configured last."""
        return self._settings

    @property
    def name(self) -> str:
        """The port, as a person calls it."""
        return self._wire.link.name

    def hello(self) -> Firmware:
        """Begin a session. An Uno that has just been reset by opening its port is given the time it needs.

        Returns:
            What firmware it is; a changed `boot` means that position and settings are gone.

        Raises:
            FirmwareError: silence, another device, or another protocol; with what was found and what is needed.
            LinkLost: the port went away.
        """
        try:
            return self._greet()
        except Silence as problem:
            raise FirmwareError(
                f"{self.name}: found {what_is_there(self._wire)}, needed a scanner controller that speaks "
                f"JXS/{PROTOCOL} at 250000 baud; check the port, its power and its firmware"
            ) from problem

    def configure(self, settings: Settings) -> None:
        """Set all settings and read them back.

        Raises:
            FirmwareError: the controller did not take what it was given.
        """
        groups = settings.wire()
        for group in groups.values():
            self._ask("SET", **group)
        says = self._ask("CFG") | self._ask("CFG", shot=1)
        wanted = {key: value for group in groups.values() for key, value in group.items()}
        differing = [
            f"{key}={says.get(key, 'nothing')} instead of {value}"
            for key, value in wanted.items()
            if says.get(key) != str(value)
        ]
        if differing:
            raise FirmwareError(f"{self.name}: settings read back as {', '.join(differing)}")
        self._settings = settings

    def reconnect(self, timeout_s: float = 60.0) -> Reconnection:
        """Find the controller again after LinkLost or ControllerReset, with longer and longer pauses.

        A link fault is cleared and the settings are sent again. If it is still the same boot, its position is good;
        otherwise it must be enabled, armed and homed anew. The contactor is open in either case.

        Args:
            timeout_s: when to give up.

        Returns:
            Whether it is the same boot, whether it must be homed, and its state.

        Raises:
            LinkLost: it did not come back in time.
            FirmwareError: something else is there now.
        """
        before = self._firmware
        give_up = self._clock.now() + timeout_s
        pause = 0.1
        while True:
            try:
                if self._broken:
                    self._open_again()
                firmware = self._greet()
                if self.stat().fault == 2:
                    self.clear()
                if self._settings is not None:
                    self.configure(self._settings)
                status = self.stat()
                break
            except (Silence, LinkLost, PortError) as problem:
                self._broken = True
                if self._clock.now() + pause > give_up:
                    raise LinkLost(f"{self.name} did not come back within {timeout_s:.0f} s: {problem}") from problem
            self._clock.sleep(pause)
            pause = min(2 * pause, 2.0)
        self._enabled = status.enabled
        same = before is not None and before.boot == firmware.boot
        return Reconnection(same, not status.homed, status)

    # Motion

    def enable(self, on: bool) -> None:
        """Switch the motor driver on or off; off forgets home."""
        self._ask("EN", on=on)
        self._enabled = on

    def home(self, max_steps: int, timeout_s: float = 120.0) -> int:
        """Look for the home switch and call its edge 0.

        Args:
            max_steps: how many microsteps to look for it.
            timeout_s: how long.

        Returns:
            What the counter said at the edge: 0 where the table was homed before and lost no step.

        Raises:
            RigFault: the switch was not found, is stuck, or something stopped the motion.
            RigTimeout: it did not arrive.
        """
        self._drop_old_events()
        self._ask("HOME", max=max_steps)
        self._begun = self._wire.seq
        return self._wait(
            "homing",
            timeout_s,
            lambda event: integer(event.fields, "was") if self._is_end(event, "HOMED") else None,
            lambda status: integer(self._ask("CNT"), "was"),
        )

    def move(self, to: int, timeout_s: float = 120.0) -> int:
        """Turn to a position and wait for it.

        Args:
            to: microsteps from home.
            timeout_s: how long to wait.

        Returns:
            The position reached.

        Raises:
            Refused: driver off, or beyond a soft limit.
            RigFault: something stopped the motion.
            RigTimeout: it did not arrive.
        """
        self._drop_old_events()
        self._ask("MOVE", to=to)
        self._begun = self._wire.seq
        return self._wait(
            f"moving to {to}",
            timeout_s,
            lambda event: integer(event.fields, "pos") if self._is_end(event, "DONE") else None,
            lambda status: status.position,
        )

    def stop(self) -> None:
        """Laser off, motor slowed down; the table stays homed."""
        self._ask("STOP")

    # Light

    def arm(self, on: bool) -> None:
        """Close or open the contactor in the laser's supply."""
        self._ask("ARM", on=on)

    def laser(self, on: bool, ms: int | None = None) -> None:
        """Switch the laser on for a while, renew that, or switch it off.

        Args:
            on: on or off.
            ms: how long it may stay on, at most the lease of `hello`; by default all of that.
        """
        if on:
            lease = 1000 if self._firmware is None else self._firmware.lease_ms
            self._ask("LASER", on=1, ms=lease if ms is None else ms)
        else:
            self._ask("LASER", on=0)

    def trigger(self, ms: int | None = None) -> None:
        """One exposure of `ms` milliseconds, by default as long as configured. Does not wait for its end."""
        if ms is None:
            self._ask("TRIG")
        else:
            self._ask("TRIG", ms=ms)

    def shot(self, to: int, id: int, *, lit: bool = True, dark: bool = True) -> None:
        """Begin a shot: turn, settle, expose with the laser, expose without. `to` as it stands repeats it.

        Args:
            to: microsteps from home.
            id: a number to know it by.
            lit: expose with the laser.
            dark: expose without.
        """
        self._drop_old_events()
        self._ask("SHOT", to=to, id=id, m=lit + 2 * dark)

    def wait_shot(self, id: int, timeout_s: float = 120.0) -> ShotDone:
        """Wait for the end of a shot that `shot` has begun.

        Raises:
            RigFault: something stopped it.
            RigTimeout: it did not end in time; it was stopped.
        """

        def told(event: Event) -> ShotDone | None:
            if event.name != "SHOT" or event.fields.get("id") != str(id):
                return None
            return ShotDone(integer(event.fields, "pos"), integer(event.fields, "trg"))

        return self._wait(f"shot {id}", timeout_s, told, lambda status: ShotDone(status.position, status.exposures))

    # State

    def stat(self) -> Status:
        """Ask for the state.

        Raises:
            ControllerReset: it has been reset since `hello`.
        """
        status = read_status(self._ask("STAT"))
        self._wire.note_last_event(status.events)
        if self._enabled and not status.enabled:
            if status.state == "fault":
                self._enabled = False
            elif self._firmware is not None:
                # Nobody switched the driver off, so it is the state after a reset whose event was lost.
                self._wire.restarted = self._wire.restarted or ControllerReset(self._firmware.boot, None)
        self._raise_reset()
        return status

    def poll(self) -> Status:
        """Ask for the state to keep the link alive.

        Raises:
            RigFault: the controller is in a fault.
            ControllerReset: it has been reset.
        """
        status = self.stat()
        if status.state == "fault":
            raise RigFault(status.fault, status.position)
        return status

    def counters(self) -> Counters:
        """The controller's counters of errors and wear."""
        return read_counters(self._ask("CNT"))

    def clear(self) -> None:
        """Leave a fault; the contactor stays open until `arm`.

        Raises:
            Refused: the emergency stop is still pressed.
            RigFault: another fault came at the same moment, of which nobody has been told yet.
        """
        try:
            self._ask("CLEAR")
        except Refused:
            status = self.stat()
            if status.state == "fault" and not status.estop:
                raise RigFault(status.fault, status.position) from None
            raise
        self._wire.events.clear()
        # The emergency stop has switched the driver off; that is no sign of a reset.
        self._enabled = read_status(self._ask("STAT")).enabled

    # The way out

    def abort(self) -> None:
        """Everything off at once, without waiting for an answer; fault 5."""
        self._wire.abort()

    def make_safe(self) -> bool:
        """Stop, laser off, contactor open; if that is not answered, abort.

        Returns:
            True if the controller confirmed that the laser is off and nothing runs that could switch it on. False:
            a person must look. After a lost link the controller's own watchdog does the same.
        """
        return make_safe(self._wire, self._clock)

    def close(self) -> None:
        """Make safe and give the port back.

        Raises:
            RigError: it could not be confirmed that the laser is off.
        """
        if self._closed:
            return
        self._closed = True
        try:
            safe = self.make_safe()
        finally:
            self._wire.link.close()
        if not safe:
            raise RigError(f"{self.name}: {UNCONFIRMED}")

    def __enter__(self) -> "Controller":
        """The controller itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Make safe and close; where that fails on the way out of an error, the error says so as well."""
        try:
            self.close()
        except RigError as problem:
            if error is None:
                raise
            log.critical("%s", problem)
            error.add_note(str(problem))

    # Within

    def _ask(self, verb: str, **args: int) -> dict[str, str]:
        """Ask, and turn refusals that mean a fault or a reset into what they mean."""
        self._raise_reset()
        try:
            fields = self._wire.ask(verb, **args)
        except LinkLost as problem:
            # A port that fails must be opened again; one that is silent must not yet: opening it resets an Uno.
            self._broken = problem.__cause__ is not None
            raise
        except Refused as refusal:
            if refusal.code == 9 and self._firmware is not None:
                self._wire.restarted = self._wire.restarted or ControllerReset(self._firmware.boot, None)
                raise self._wire.restarted from refusal
            if refusal.code == 6 and verb != "CLEAR":
                status = self.stat()
                if status.state == "fault":
                    raise RigFault(status.fault, status.position) from refusal
            raise
        return fields

    def _raise_reset(self) -> None:
        if self._wire.restarted is not None:
            self._enabled = False
            raise self._wire.restarted

    def _greet(self) -> Firmware:
        firmware = greet(self._wire, self._clock, self._session)
        if self._firmware is None or firmware.boot != self._firmware.boot:
            self._enabled = False
        self._firmware = firmware
        return firmware

    def _open_again(self) -> None:
        if self._reopen is not None:
            self._wire.link.close()
            self._wire.attach(self._reopen())
        self._broken = False

    def _is_end(self, event: Event, name: str) -> bool:
        """Whether an event is the end of what the last line began, and not of what an earlier one did."""
        return event.name == name and event.fields.get("seq") == str(self._begun)

    def _drop_old_events(self) -> None:
        """What is left of earlier commands must not be taken for the end of the next one."""
        kept = [event for event in self._wire.events if event.name == "FAULT"]
        self._wire.events.clear()
        self._wire.events.extend(kept)

    def _wait(self, what: str, timeout_s: float, told: Callable[[Event], T | None], idle: Callable[[Status], T]) -> T:
        """Wait for an event, and ask for the state meanwhile: the event may be lost, and the link must stay alive."""
        give_up = self._clock.now() + timeout_s
        next_poll = self._clock.now() + POLL_S
        while True:
            done = self._look_at_events(told)
            if done is not None:
                return done
            self._raise_reset()
            now = self._clock.now()
            if now >= give_up:
                self.stop()
                raise RigTimeout(f"{what} did not end within {timeout_s:.1f} s; it was stopped")
            if now < next_poll:
                self._listen(next_poll - now)
                continue
            status = self.poll()
            next_poll = self._clock.now() + POLL_S
            if status.state == "idle":
                done = self._look_at_events(told)
                return idle(status) if done is None else done

    def _listen(self, timeout_s: float) -> None:
        try:
            self._wire.listen(timeout_s)
        except LinkLost:
            self._broken = True
            raise

    def _look_at_events(self, told: Callable[[Event], T | None]) -> T | None:
        while self._wire.events:
            event = self._wire.events.popleft()
            if event.name == "FAULT":
                raise RigFault(integer(event.fields, "f"), integer(event.fields, "pos"))
            done = told(event)
            if done is not None:
                return done
        return None
