"""The controller's verbs: what a session asks of turntable, laser and trigger, and how it gets all of it made safe."""

import logging
import secrets
from collections.abc import Callable
from types import TracebackType

from scanrig.clock import Clock, SystemClock
from scanrig.controllers.conversation import Conversation
from scanrig.controllers.greeting import Silence, greet, what_is_there
from scanrig.controllers.safety import UNCONFIRMED, make_safe
from scanrig.controllers.settings import Settings
from scanrig.controllers.status import (
    Counters,
    Firmware,
    LinkCounts,
    Reconnection,
    ShotDone,
    Status,
    integer,
    read_counters,
)
from scanrig.errors import FirmwareError, LinkLost, PortError, RigError
from scanrig.wire.exchange import Exchange
from scanrig.wire.link import Link
from scanrig.wire.protocol import PROTOCOL, Event


log = logging.getLogger(__name__)


REST_S = 5.0
"""How long a table may take to slow down."""


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
        self._talk = Conversation(self._wire, self._clock)
        self._reopen = reopen
        self._session = session or secrets.randbelow(2**31 - 1) + 1
        self._settings: Settings | None = None
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

    def reconnect(self, timeout_s: float = 60.0) -> Reconnection:
        """Find the controller again after LinkLost or ControllerReset, with longer and longer pauses.

        Motion is stopped, a link fault cleared, and the settings are sent again. If it is still the same boot, its
        position is good; otherwise it must be enabled and homed anew. The contactor is open in either
        case. What is left to do is in its state.

        Args:
            timeout_s: when to give up.

        Returns:
            Whether it is the same boot, whether it must be homed, and its state.

        Raises:
            LinkLost: it did not come back in time.
            FirmwareError: something else is there now.
        """
        before = self._talk.firmware
        give_up = self._clock.now() + timeout_s
        pause = 0.1
        while True:
            try:
                if self._talk.broken:
                    self._open_again()
                firmware = self._greet()
                if self._come_to_rest().fault == 2:
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
        """Switch the motor driver on or off; off forgets home."""
        self._talk.ask("EN", on=on)
        self._talk.enabled = on

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
        self._talk.begin("HOME", max=max_steps)
        return self._talk.wait(
            "homing",
            timeout_s,
            lambda event: integer(event.fields, "was") if self._talk.is_end(event, "HOMED") else None,
            lambda status: integer(self._talk.ask("CNT"), "was"),
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
        self._talk.begin("MOVE", to=to)
        return self._talk.wait(
            f"moving to {to}",
            timeout_s,
            lambda event: integer(event.fields, "pos") if self._talk.is_end(event, "DONE") else None,
            lambda status: status.position,
        )

    def stop(self) -> None:
        """Laser off, motor slowed down; the table stays homed."""
        self._talk.ask("STOP")

    # Light

    def arm(self, on: bool) -> None:
        """Close or open the contactor in the laser's supply."""
        self._talk.ask("ARM", on=on)

    def laser(self, on: bool, ms: int | None = None) -> None:
        """Switch the laser on for a while, renew that, or switch it off.

        Args:
            on: on or off.
            ms: how long it may stay on, at most the lease of `hello`; by default all of that.
        """
        if on:
            lease = 1000 if self._talk.firmware is None else self._talk.firmware.lease_ms
            self._talk.ask("LASER", on=1, ms=lease if ms is None else ms)
        else:
            self._talk.ask("LASER", on=0)

    def trigger(self, ms: int | None = None) -> None:
        """One exposure of `ms` milliseconds, by default as long as configured. Does not wait for its end."""
        if ms is None:
            self._talk.ask("TRIG")
        else:
            self._talk.ask("TRIG", ms=ms)

    def shot(self, to: int, id: int, *, lit: bool = True, dark: bool = True) -> None:
        """Begin a shot: turn, settle, expose with the laser, expose without. `to` as it stands repeats it.

        Args:
            to: microsteps from home.
            id: a number to know it by.
            lit: expose with the laser.
            dark: expose without.
        """
        self._talk.begin("SHOT", to=to, id=id, m=lit + 2 * dark)

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

        return self._talk.wait(
            f"shot {id}", timeout_s, told, lambda status: ShotDone(status.position, status.exposures)
        )

    # State

    def stat(self) -> Status:
        """Ask for the state.

        Raises:
            ControllerReset: it has been reset since `hello`.
        """
        return self._talk.stat()

    def poll(self) -> Status:
        """Ask for the state to keep the link alive.

        Raises:
            RigFault: the controller is in a fault.
            ControllerReset: it has been reset.
        """
        return self._talk.poll()

    def counters(self) -> Counters:
        """The controller's counters of errors and wear."""
        return read_counters(self._talk.ask("CNT"))

    def clear(self) -> None:
        """Leave a fault; the contactor stays open until `arm`.

        Raises:
            Refused: the emergency stop is still pressed.
            RigFault: another fault came at the same moment, of which nobody has been told yet.
        """
        self._talk.clear()

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

    def _greet(self) -> Firmware:
        firmware = greet(self._wire, self._clock, self._session)
        before, self._talk.firmware = self._talk.firmware, firmware
        if before is None or firmware.boot != before.boot:
            self._talk.enabled = False
        return firmware

    def _come_to_rest(self) -> Status:
        """A cable that was pulled for less than the link watchdog's time has stopped nothing."""
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
