"""A `Controller` for the scanner's own firmware, with the verbs of PROTOCOL.md."""

import secrets
from collections.abc import Callable

from scanrig.clock import Clock, SystemClock
from scanrig.controllers.controller import Guarantees, SafelyClosed
from scanrig.controllers.jxs.answers import integer, read_counters
from scanrig.controllers.jxs.conversation import Conversation
from scanrig.controllers.jxs.exchange import Exchange
from scanrig.controllers.jxs.greeting import Silence, greet, what_is_there
from scanrig.controllers.jxs.protocol import PROTOCOL, Event
from scanrig.controllers.jxs.safety import make_safe
from scanrig.controllers.jxs.wire_settings import wire_settings
from scanrig.controllers.settings import Settings
from scanrig.controllers.status import Counters, Firmware, LinkCounts, Reconnection, ShotDone, Status
from scanrig.errors import Fault, FirmwareError, LinkLost, PortError, Reason, Refused
from scanrig.wire.link import Link


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
            link: to the controller.
            clock: for every wait.
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
            on: on or off.
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
            lit: expose with the laser.
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
