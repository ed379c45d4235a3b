"""The scanner's own controller: which device is on the port, its verbs, and everything off and confirmed."""

import logging
import secrets
from collections.abc import Callable
from typing import TypeVar

from scanrig.clock import Clock
from scanrig.controllers.controller import (
    Controller,
    Counters,
    Firmware,
    Guarantees,
    LinkCounts,
    Reconnection,
    Settings,
    ShotDone,
    Status,
    with_growing_pauses,
)
from scanrig.controllers.jxs.exchange import Exchange
from scanrig.controllers.jxs.protocol import (
    PROTOCOL,
    Event,
    integer,
    read_counters,
    read_fault,
    read_firmware,
    read_status,
    wire_settings,
)
from scanrig.errors import (
    ControllerReset,
    Fault,
    FirmwareError,
    LinkLost,
    PortError,
    Reason,
    Refused,
    RigError,
    RigFault,
    RigTimeout,
)
from scanrig.wire import Link, open_port


log = logging.getLogger(__name__)

BOOT_S = 2.5
"""Opening its port resets an Uno; its boot loader takes this long."""


class Silence(LinkLost):
    """No answer to HELLO."""


SAFE_TRIES = 3
"""Fewer tries than usual; then the abort byte is sent, which works without a valid line."""
STOPPING_S = 0.5
"""How long a shot may take to end after STOP."""
REST_S = 5.0
POLL_S = 0.1
"""Time between two polls while something runs: well below the controller's watchdog, 500 ms by default."""

T = TypeVar("T")


class JxsController(Controller):
    """A session with the scanner's own firmware over a link."""

    guarantees = Guarantees(
        laser_off_without_host=True, knows_missed_steps=True, hardware_trigger=True, checked_lines=True
    )

    def __init__(
        self,
        link: Link,
        clock: Clock | None = None,
        *,
        reopen: Callable[[], Link] | None = None,
        session: int | None = None,
    ):
        """Nothing is sent yet.

        Args:
            reopen: opens the port again for `reconnect`, even under another number.
            session: the number of this session, 1 … 2³¹−1; by default a random one.
        """
        self._clock = clock or Clock()
        # The link counts as lost after two seconds without an answer.
        self._wire = Exchange(link, self._clock, timeout_s=0.25, tries=8)
        self._reopen = reopen
        self._session = session or secrets.randbelow(2**31 - 1) + 1
        self.settings: Settings | None = None
        self._firmware: Firmware | None = None
        self._enabled = False
        """Whether the motor driver was switched on; if it is off now, the controller was reset."""
        self._broken = False
        """Whether the port itself failed, so that it must be opened again."""
        self._begun = 0
        """Number of the line that began what runs."""

    # Session

    @property
    def link_counts(self) -> LinkCounts:
        return self._wire.counts

    @property
    def link(self) -> Link:
        return self._wire.link

    def hello(self) -> Firmware:
        try:
            return self._greet()
        except Silence as problem:
            odd, echoes = self._wire.odd_lines, " and echoes its input" * self._echoes()
            found = f"a device that sends {repr(odd[-1][:60])[1:]}{echoes}" if odd else "silence"
            raise FirmwareError(
                f"{self.name}: found {found}, needed a scanner controller that speaks JXS/{PROTOCOL} at 250000 baud; "
                "check the port, its power and its firmware"
            ) from problem

    def configure(self, settings: Settings) -> None:
        lasers = integer(self._ask("HAS"), "las") if settings.lasers > 1 else 1
        if settings.lasers > lasers:
            raise FirmwareError(
                f"{self.name}: found a firmware that switches {lasers} laser, needed one that switches "
                f"{settings.lasers}; load the firmware that belongs to this version, or leave one [[laser]] in the "
                "configuration"
            )
        groups = wire_settings(settings)
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
        self.settings = settings

    def reconnect(self, timeout_s: float = 60.0) -> Reconnection:
        """Find the controller again, with growing pauses; a link fault is cleared, and the settings are sent again."""
        before = self._firmware

        def found() -> Reconnection:
            try:
                self._open_again()
                firmware = self._greet()
                if self._come_to_rest().fault is Fault.LINK_LOST:
                    self.clear()
                if self.settings is not None:
                    self.configure(self.settings)
                status = self.stat()
            except (LinkLost, PortError):
                self._broken = True
                raise
            self._enabled = status.enabled
            return Reconnection(before is not None and before.boot == firmware.boot, status)

        return with_growing_pauses(found, self._clock, timeout_s, self.name)

    # Motion

    def enable(self, on: bool) -> None:
        self._ask("EN", on=on)
        self._enabled = on

    def home(self, max_steps: int, timeout_s: float = 120.0) -> int:
        self._begin("HOME", max=max_steps)
        return self._wait(
            "homing",
            timeout_s,
            lambda event: integer(event.fields, "was") if self._is_end(event, "HOMED") else None,
            lambda status: integer(self._ask("CNT"), "was"),
        )

    def move(self, to: int, timeout_s: float = 120.0) -> int:
        self._begin("MOVE", to=to)
        return self._wait(
            f"moving to {to}",
            timeout_s,
            lambda event: integer(event.fields, "pos") if self._is_end(event, "DONE") else None,
            lambda status: status.position,
        )

    def stop(self) -> None:
        self._ask("STOP")

    # Light

    def arm(self, on: bool) -> None:
        self._ask("ARM", on=on)

    def laser(self, on: bool, ms: int | None = None, *, number: int = 1) -> None:
        """Like that of every controller. `ms` is the lease [ms], at most that of `hello`; by default all of it."""
        if on:
            lease = 1000 if self._firmware is None else self._firmware.lease_ms
            self._ask("LASER", on=1, ms=lease if ms is None else ms, **_named(number))
        else:
            self._ask("LASER", on=0)

    def trigger(self) -> None:
        self._ask("TRIG")

    def shot(self, to: int, id: int, *, number: int = 1) -> None:
        self._begin("SHOT", to=to, id=id, m=3, **_named(number))

    def wait_shot(self, id: int, timeout_s: float = 120.0) -> ShotDone:
        def reported(event: Event) -> ShotDone | None:
            if event.name != "SHOT" or event.fields.get("id") != str(id):
                return None
            return ShotDone(integer(event.fields, "pos"), integer(event.fields, "trg"))

        return self._wait(f"shot {id}", timeout_s, reported, lambda status: ShotDone(status.position, status.exposures))

    # State

    def stat(self) -> Status:
        says = self._ask("STAT")
        status = read_status(says)
        self._wire.note_last_event(integer(says, "ev"))
        if self._enabled and not status.enabled:
            if status.state == "fault":
                self._enabled = False
            else:
                # The host did not switch the driver off, so there was a reset whose event was lost.
                self._note_reset()
        self._raise_reset()
        return status

    def poll(self) -> Status:
        status = self.stat()
        if status.state == "fault":
            raise RigFault(status.fault or Fault.UNKNOWN, status.position)
        return status

    def counters(self) -> Counters:
        return read_counters(self._ask("CNT"))

    def clear(self) -> None:
        """Leave a fault. Raises RigFault if another one came at the same moment and was not reported yet."""
        try:
            self._ask("CLEAR")
        except Refused:
            if not self.stat().estop:
                self.poll()
            raise
        self._wire.events.clear()
        # The emergency stop switches the driver off; that does not mean a reset.
        self._enabled = read_status(self._ask("STAT")).enabled

    # Ending

    def abort(self) -> None:
        self._wire.abort()

    def make_safe(self) -> bool:
        try:
            self._insist("STOP")
            self._insist("LASER", on=0)
            self._insist("ARM", on=0)
            if self._is_dark():
                return True
        except RigError as problem:
            # No answer, or an incomplete one: the abort byte needs neither.
            log.warning("%s", problem)
        try:
            self._wire.abort()
            return self._is_dark()
        except RigError as problem:
            log.warning("%s", problem)
            return False

    def _insist(self, verb: str, **args: int) -> None:
        """Send a command; a refusal is logged, so that the next command follows."""
        try:
            self._wire.ask(verb, tries=SAFE_TRIES, **args)
        except Refused as problem:
            log.warning("%s", problem)

    def _is_dark(self) -> bool:
        """Whether the controller confirms that the laser is off and stays off. Raises RigError without an answer."""
        end = self._clock.now() + STOPPING_S
        while True:
            status = read_status(self._wire.ask("STAT", tries=SAFE_TRIES))
            if not status.laser and not status.armed and status.state != "shot":
                return True
            if self._clock.now() >= end:
                return False
            self._clock.sleep(0.02)

    # Within

    def _greet(self) -> Firmware:
        """Begin a session. A controller that was reset by opening its port sends BOOT first and is then greeted again.

        Raises:
            Silence: no answer; the lines that came instead are in `odd_lines`.
            FirmwareError: it answers but speaks another protocol.
        """
        wire, clock = self._wire, self._clock
        wire.forget()
        wire.odd_lines.clear()
        until = clock.now() + BOOT_S
        try:
            fields = self._hello(1)
        except Silence:
            if self._echoes():
                raise
            while not any(event.name == "BOOT" for event in wire.events) and clock.now() < until:
                wire.listen(until - clock.now())
            fields = self._hello(wire.tries)
        found = fields.get("proto", "unknown")
        if found != str(PROTOCOL):
            raise FirmwareError(
                f"{self.name}: found firmware {fields.get('fw', 'unknown')} that speaks protocol {found}, needed "
                f"protocol {PROTOCOL}; load the firmware that belongs to this version"
            )
        firmware = read_firmware(fields)
        wire.boot, wire.restarted = firmware.boot, None
        before, self._firmware = self._firmware, firmware
        if before is None or firmware.boot != before.boot:
            self._enabled = False
        return firmware

    def _hello(self, tries: int) -> dict[str, str]:
        try:
            return self._wire.ask("HELLO", ses=self._session, tries=tries)
        except Refused as problem:
            raise FirmwareError(f"{self.name} does not begin a session: {problem}") from problem
        except LinkLost as problem:
            if problem.__cause__ is not None:
                raise  # The port itself failed, which is not silence.
            raise Silence(str(problem)) from problem

    def _echoes(self) -> bool:
        return any(b"HELLO" in line for line in self._wire.odd_lines)

    def _come_to_rest(self) -> Status:
        """Stop the table: a cable that was pulled for less than the watchdog's time has not stopped it."""
        give_up = self._clock.now() + REST_S
        self.stop()
        while (status := self.stat()).state not in ("idle", "fault"):
            if self._clock.now() >= give_up:
                raise LinkLost(f"{self.name}: the table did not come to rest")
            self._clock.sleep(0.02)
        return status

    def _open_again(self) -> None:
        if self._broken and self._reopen is not None:
            self._wire.link.close()
            self._wire.attach(self._reopen())
        self._broken = False

    def _ask(self, verb: str, **args: int) -> dict[str, str]:
        """The fields of a command's answer; a fault or a reset that it shows is raised."""
        self._raise_reset()
        try:
            return self._wire.ask(verb, **args)
        except LinkLost as problem:
            # A port that fails must be opened again. A silent one is kept open, since opening it resets an Uno.
            self._broken = problem.__cause__ is not None
            raise
        except Refused as refusal:
            if refusal.reason is Reason.NO_SESSION and self._firmware is not None:
                self._note_reset()
                self._raise_reset()
            if refusal.reason is Reason.IN_FAULT:
                self.poll()
            raise

    def _begin(self, verb: str, **args: int) -> None:
        """Send a command whose end is an event."""
        # Events of earlier commands must not count as the end of this one.
        kept = [event for event in self._wire.events if event.name == "FAULT"]
        self._wire.events.clear()
        self._wire.events.extend(kept)
        self._ask(verb, **args)
        self._begun = self._wire.seq

    def _is_end(self, event: Event, name: str) -> bool:
        """Whether an event ends the command that was begun last, not an earlier one."""
        return event.name == name and event.fields.get("seq") == str(self._begun)

    def _wait(
        self, action: str, timeout_s: float, reported: Callable[[Event], T | None], idle: Callable[[Status], T]
    ) -> T:
        """Wait for an event, and poll meanwhile: the event may be lost, and the watchdog must be fed.

        Args:
            reported: reads the result from the event; None for any other event.
            idle: reads the result from the state once nothing runs any more.
        """
        give_up = self._clock.now() + timeout_s
        next_poll = self._clock.now() + POLL_S
        while True:
            done = self._look_at_events(reported)
            if done is not None:
                return done
            self._raise_reset()
            now = self._clock.now()
            if now >= give_up:
                self._ask("STOP")
                raise RigTimeout(f"{action} did not end within {timeout_s:.1f} s; it was stopped")
            if now < next_poll:
                self._listen(next_poll - now)
                continue
            status = self.poll()
            next_poll = self._clock.now() + POLL_S
            if status.state == "idle":
                done = self._look_at_events(reported)
                return idle(status) if done is None else done

    def _look_at_events(self, reported: Callable[[Event], T | None]) -> T | None:
        while self._wire.events:
            event = self._wire.events.popleft()
            if event.name == "FAULT":
                raise RigFault(read_fault(integer(event.fields, "f")), integer(event.fields, "pos"))
            done = reported(event)
            if done is not None:
                return done
        return None

    def _listen(self, timeout_s: float) -> None:
        try:
            self._wire.listen(timeout_s)
        except LinkLost:
            self._broken = True
            raise

    def _note_reset(self) -> None:
        self._wire.restarted = self._wire.restarted or ControllerReset(self._wire.boot, None)

    def _raise_reset(self) -> None:
        if self._wire.restarted is not None:
            self._enabled = False
            raise self._wire.restarted


def _named(number: int) -> dict[str, int]:
    """The laser's number as a field; the first is the one without."""
    return {} if number == 1 else {"n": number}


def connect(port: str = "auto", baud: int | None = None, clock: Clock | None = None) -> JxsController:
    """Open the controller's port: a path, a USB serial number, or "auto". Nothing is sent before `hello`."""
    link, reopen = open_port(port, baud or 250_000, clock)
    return JxsController(link, clock, reopen=reopen)
