"""The scanner's own controller: which device is on the port, its verbs, and everything off and confirmed."""

import logging
import secrets
from collections.abc import Callable

from scanrig.clock import Clock, SystemClock
from scanrig.controllers.controller import (
    Counters,
    Firmware,
    Guarantees,
    LinkCounts,
    Reconnection,
    SafelyClosed,
    Settings,
    ShotDone,
    Status,
)
from scanrig.controllers.jxs.conversation import Conversation, Exchange
from scanrig.controllers.jxs.protocol import (
    PROTOCOL,
    Event,
    integer,
    read_counters,
    read_firmware,
    read_status,
    wire_settings,
)
from scanrig.errors import Fault, FirmwareError, LinkLost, PortError, Reason, Refused, RigError
from scanrig.wire import Link, choose_port, find_again, identify, open_serial


log = logging.getLogger(__name__)

BOOT_S = 2.5
"""Opening its port resets an Uno; its boot loader takes this long."""


class Silence(Exception):
    """No answer to HELLO."""


def greet(wire: Exchange, clock: Clock, session: int) -> Firmware:
    """Begin a session.

    A running controller answers at once. One that was reset by opening its port sends BOOT first and is then greeted
    again.

    Args:
        clock: for the wait for the boot loader.
        session: 1 … 2³¹−1.

    Returns:
        The firmware that answered.

    Raises:
        Silence: no answer; `what_is_there` describes the lines that came instead.
        FirmwareError: it answers but speaks another protocol.
        LinkLost: the port went away.
    """
    wire.forget()
    wire.odd_lines.clear()
    opened = clock.now()
    try:
        fields = hello(wire, session, tries=1)
    except Silence:
        if _echoes(wire):
            raise
        if not wait_for_boot(wire, clock, opened + BOOT_S):
            log.info("%s: no BOOT within %.1f s", wire.link.name, BOOT_S)
        fields = hello(wire, session, tries=wire.tries)
    found = fields.get("proto", "unknown")
    if found != str(PROTOCOL):
        raise FirmwareError(
            f"{wire.link.name}: found firmware {fields.get('fw', 'unknown')} that speaks protocol {found}, needed "
            f"protocol {PROTOCOL}; load the firmware that belongs to this version"
        )
    firmware = read_firmware(fields)
    wire.boot = firmware.boot
    wire.restarted = None
    return firmware


def hello(wire: Exchange, session: int, tries: int) -> dict[str, str]:
    """Send HELLO, at most `tries` times."""
    try:
        return wire.ask("HELLO", ses=session, tries=tries)
    except Refused as problem:
        raise FirmwareError(f"{wire.link.name} does not begin a session: {problem}") from problem
    except LinkLost as problem:
        if problem.__cause__ is not None:
            raise  # The port itself failed, which is not silence.
        raise Silence(str(problem)) from problem


def wait_for_boot(wire: Exchange, clock: Clock, until: float) -> bool:
    """Listen until BOOT comes or the time `until` is reached; returns whether BOOT came."""
    while not any(event.name == "BOOT" for event in wire.events):
        left = until - clock.now()
        if left <= 0:
            return False
        wire.listen(left)
    return True


def what_is_there(wire: Exchange) -> str:
    """Describes, for messages, the lines that came from the port instead of an answer to HELLO."""
    if not wire.odd_lines:
        return "silence"
    says = repr(wire.odd_lines[-1][:60])[1:]
    return f"a device that echoes its input ({says})" if _echoes(wire) else f"a device that sends {says}"


def _echoes(wire: Exchange) -> bool:
    return any(b"HELLO" in line for line in wire.odd_lines)


TRIES = 3
"""Fewer tries than usual; then the abort byte is sent, which works without a valid line."""

STOPPING_S = 0.5
"""How long a shot may take to end after STOP."""


def make_safe(wire: Exchange, clock: Clock) -> bool:
    """Stop, laser off, contactor open; if that is not answered, abort.

    Raises no error of the rig, so that every exit can call it.

    Returns:
        True if the controller confirmed that the laser is off, the contactor open, and nothing runs that could switch
        it on again.
    """
    try:
        _insist(wire, "STOP")
        _insist(wire, "LASER", on=0)
        _insist(wire, "ARM", on=0)
        if is_dark(wire, clock):
            return True
    except RigError as problem:
        # No answer, or an incomplete one: the abort byte needs neither.
        log.warning("%s", problem)
    try:
        wire.abort()
        return is_dark(wire, clock)
    except RigError as problem:
        log.warning("%s", problem)
        return False


def is_dark(wire: Exchange, clock: Clock) -> bool:
    """Whether the controller confirms that the laser is off and stays off. Raises RigError if it does not answer."""
    end = clock.now() + STOPPING_S
    while True:
        status = read_status(wire.ask("STAT", tries=TRIES))
        if not status.laser and not status.armed and status.state != "shot":
            return True
        if clock.now() >= end:
            return False
        clock.sleep(0.02)


def _insist(wire: Exchange, verb: str, **args: int) -> None:
    """Send a command; a refusal is logged, so that the next command follows."""
    try:
        wire.ask(verb, tries=TRIES, **args)
    except Refused as problem:
        log.warning("%s", problem)


REST_S = 5.0
"""Longest time that the table may take to stop."""


class JxsController(SafelyClosed):
    """A session with the scanner's own firmware over a link; `Controller` documents the methods."""

    guarantees = Guarantees(
        laser_off_without_host=True, knows_missed_steps=True, hardware_trigger=True, checked_lines=True
    )

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
            timeout_s: the longest wait for one answer.
            tries: the link counts as lost after `tries * timeout_s` without an answer.
            reopen: opens the port again for `reconnect`, even under another number.
            session: the number of this session, 1 … 2³¹−1; by default a random one.
        """
        self._clock = clock or SystemClock()
        self._wire = Exchange(link, self._clock, timeout_s=timeout_s, tries=tries)
        self._talk = Conversation(self._wire, self._clock)
        self._reopen = reopen
        self._session = session or secrets.randbelow(2**31 - 1) + 1
        self._settings: Settings | None = None

    # Session

    @property
    def link_counts(self) -> LinkCounts:
        return self._wire.counts

    @property
    def link(self) -> Link:
        """The present link."""
        return self._wire.link

    @property
    def settings(self) -> Settings | None:
        """The settings configured last."""
        return self._settings

    def hello(self) -> Firmware:
        try:
            return self._greet()
        except Silence as problem:
            raise FirmwareError(
                f"{self.name}: found {what_is_there(self._wire)}, needed a scanner controller that speaks "
                f"JXS/{PROTOCOL} at 250000 baud; check the port, its power and its firmware"
            ) from problem

    def configure(self, settings: Settings) -> None:
        if settings.lasers > (lasers := self.lasers() if settings.lasers > 1 else 1):
            raise FirmwareError(
                f"{self.name}: found a firmware that switches {lasers} laser, needed one that switches "
                f"{settings.lasers}; load the firmware that belongs to this version, or leave one [[laser]] in the "
                "configuration"
            )
        groups = wire_settings(settings)
        for group in groups.values():
            self._talk.ask("SET", **group)
        says = self._talk.ask("CFG") | self._talk.ask("CFG", shot=1)
        wanted = {key: value for group in groups.values() for key, value in group.items()}
        differing = [
            f"{key}={says.get(key, 'nothing')} instead of {value}"
            for key, value in wanted.items()
            if says.get(key) != str(value)
        ]
        if differing:
            raise FirmwareError(f"{self.name}: settings read back as {', '.join(differing)}")
        self._settings = settings

    def lasers(self) -> int:
        """How many lasers it switches; earlier firmware does not know the question and switches one."""
        try:
            return integer(self._talk.ask("HAS"), "las")
        except Refused as problem:
            if problem.reason is not Reason.UNKNOWN_COMMAND:
                raise
            return 1

    def reconnect(self, timeout_s: float = 60.0) -> Reconnection:
        """Find the controller again, with growing pauses.

        A link fault is cleared, and the settings are sent again. If the boot number is the same, its position is valid;
        otherwise it must be enabled and homed again.
        """
        before = self._talk.firmware
        give_up = self._clock.now() + timeout_s
        pause = 0.1
        while True:
            try:
                if self._talk.broken:
                    self._open_again()
                firmware = self._greet()
                if self._come_to_rest().fault is Fault.LINK_LOST:
                    self.clear()
                if self._settings is not None:
                    self.configure(self._settings)
                status = self.stat()
                break
            except (Silence, LinkLost, PortError) as problem:
                self._talk.broken = True
                if self._clock.now() + pause > give_up:
                    raise LinkLost(f"{self.name} did not come back within {timeout_s:.0f} s: {problem}") from problem
            self._clock.sleep(pause)
            pause = min(2 * pause, 2.0)
        self._talk.enabled = status.enabled
        same = before is not None and before.boot == firmware.boot
        return Reconnection(same, not status.homed, status)

    # Motion

    def enable(self, on: bool) -> None:
        self._talk.ask("EN", on=on)
        self._talk.enabled = on

    def home(self, max_steps: int, timeout_s: float = 120.0) -> int:
        self._talk.begin("HOME", max=max_steps)
        return self._talk.wait(
            "homing",
            timeout_s,
            lambda event: integer(event.fields, "was") if self._talk.is_end(event, "HOMED") else None,
            lambda status: integer(self._talk.ask("CNT"), "was"),
        )

    def move(self, to: int, timeout_s: float = 120.0) -> int:
        self._talk.begin("MOVE", to=to)
        return self._talk.wait(
            f"moving to {to}",
            timeout_s,
            lambda event: integer(event.fields, "pos") if self._talk.is_end(event, "DONE") else None,
            lambda status: status.position,
        )

    def stop(self) -> None:
        self._talk.ask("STOP")

    # Light

    def arm(self, on: bool) -> None:
        self._talk.ask("ARM", on=on)

    def laser(self, on: bool, ms: int | None = None, *, number: int = 1) -> None:
        """Switch a laser on, renew its lease, or switch all lasers off.

        Args:
            ms: lease [ms], at most that of `hello`; by default all of it.
            number: which laser, from 1.
        """
        if on:
            lease = 1000 if self._talk.firmware is None else self._talk.firmware.lease_ms
            self._talk.ask("LASER", on=1, ms=lease if ms is None else ms, **_named(number))
        else:
            self._talk.ask("LASER", on=0)

    def trigger(self, ms: int | None = None) -> None:
        """One exposure of `ms` milliseconds, by default as long as configured. Does not wait for its end."""
        if ms is None:
            self._talk.ask("TRIG")
        else:
            self._talk.ask("TRIG", ms=ms)

    def shot(self, to: int, id: int, *, number: int = 1, lit: bool = True, dark: bool = True) -> None:
        """Begin a shot: turn, settle, expose with the laser, expose without. The present position as `to` repeats it.

        Args:
            to: microsteps from home.
            id: a number that identifies the shot.
            number: which laser, from 1.
            dark: expose without.
        """
        self._talk.begin("SHOT", to=to, id=id, m=lit + 2 * dark, **_named(number))

    def wait_shot(self, id: int, timeout_s: float = 120.0) -> ShotDone:
        def told(event: Event) -> ShotDone | None:
            if event.name != "SHOT" or event.fields.get("id") != str(id):
                return None
            return ShotDone(integer(event.fields, "pos"), integer(event.fields, "trg"))

        return self._talk.wait(
            f"shot {id}", timeout_s, told, lambda status: ShotDone(status.position, status.exposures)
        )

    # State

    def stat(self) -> Status:
        return self._talk.stat()

    def poll(self) -> Status:
        return self._talk.poll()

    def counters(self) -> Counters:
        return read_counters(self._talk.ask("CNT"))

    def clear(self) -> None:
        self._talk.clear()

    # Ending

    def abort(self) -> None:
        self._wire.abort()

    def make_safe(self) -> bool:
        return make_safe(self._wire, self._clock)

    # Within

    def _greet(self) -> Firmware:
        firmware = greet(self._wire, self._clock, self._session)
        before, self._talk.firmware = self._talk.firmware, firmware
        if before is None or firmware.boot != before.boot:
            self._talk.enabled = False
        return firmware

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
        if self._reopen is not None:
            self._wire.link.close()
            self._wire.attach(self._reopen())
        self._talk.broken = False


def _named(number: int) -> dict[str, int]:
    """The laser's number as a field. The first laser is sent without it, since earlier firmware knows no numbers."""
    return {} if number == 1 else {"n": number}


def connect(port: str = "auto", baud: int = 250_000, clock: Clock | None = None) -> JxsController:
    """Open the controller's port. Nothing is sent before `hello`.

    Args:
        port: a path, a USB serial number, or "auto" for the only board.
        baud: bits per second.

    Returns:
        A controller whose `reconnect` finds the same board again, by its USB serial number or its path under
        /dev/serial/by-id, even under another port number.

    Raises:
        PortError: no port, several, port missing or in use, or no permission.
    """
    path = choose_port(port)
    link = open_serial(path, baud, clock)
    known = identify(path)

    def reopen() -> Link:
        return open_serial(find_again(known), baud, clock)

    return JxsController(link, clock, reopen=reopen)
