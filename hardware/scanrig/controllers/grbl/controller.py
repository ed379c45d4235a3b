"""A board that speaks GRBL's G-code as a controller: what the table and the laser are told, and how it is made safe."""

import dataclasses
import logging
from types import TracebackType

from scanrig.clock import Clock
from scanrig.controllers.controller import UNCONFIRMED, Guarantees, close_after
from scanrig.controllers.grbl.greeting import greet, require_fit, wake
from scanrig.controllers.grbl.lines import HOLD, POLL_S, GrblLines
from scanrig.controllers.grbl.report import ALARMS, STATES, Report
from scanrig.controllers.grbl.units import TableUnits
from scanrig.controllers.settings import Settings
from scanrig.controllers.status import Firmware, LinkCounts, Reconnection, ShotDone, Status
from scanrig.controllers.table import GrblTable
from scanrig.errors import Fault, FirmwareError, LinkLost, PortError, Reason, Refused, RigError, RigFault, RigTimeout


log = logging.getLogger(__name__)

REST_S = 10.0
"""How long a table may take to slow down."""
_STILL = 3
"""Reports of rest after which a motion is over, wherever it ended."""


class GrblController:
    """A session with a GRBL board; a `Controller`, which says what its methods do."""

    guarantees = Guarantees(
        laser_off_without_host=False, knows_missed_steps=False, hardware_trigger=False, checked_lines=False
    )

    def __init__(self, lines: GrblLines, table: GrblTable, units: TableUnits, clock: Clock) -> None:
        """Nothing is sent yet."""
        self._lines, self._table, self._units, self._clock = lines, table, units, clock
        self._settings: Settings | None = None
        self._zero: float | None = None
        """What the axis says at home; None while home is not known."""
        self._home_lost = False
        """Whether home was known and is not any more."""
        self._boot = 0
        self._enabled = self._armed = self._lit = self._closed = False

    # Session

    @property
    def name(self) -> str:
        return self._lines.link.name

    @property
    def link_counts(self) -> LinkCounts:
        return self._lines.counts

    def hello(self) -> Firmware:
        self._lines.open_again()
        version = greet(self._lines)
        self._begin()
        return Firmware("Grbl", version, self._boot)

    def configure(self, settings: Settings) -> None:
        if settings.lasers > (known := len(self._table.laser_on)):
            raise FirmwareError(
                f"{self.name}: found {known} command in controller.grbl.laser_on, needed one for each of "
                f"{settings.lasers} lasers"
            )
        self._units = dataclasses.replace(self._units, reverse=settings.reverse)
        if self._table.check_settings:
            require_fit(self._lines, self._table, self._units, settings)
        self._settings = settings

    def reconnect(self, timeout_s: float = 60.0) -> Reconnection:
        """Find the board again, with longer and longer pauses. Many boards are reset when their port is opened."""
        before = self._boot
        give_up = self._clock.now() + timeout_s
        pause = 0.1
        while True:
            try:
                self._lines.open_again()
                wake(self._lines)
                self._begin()
                if self._settings is not None:
                    self.configure(self._settings)
                status = self.stat()
                return Reconnection(self._boot == before, not status.homed, status)
            except (LinkLost, PortError) as problem:
                self._lines.broken = True
                if self._clock.now() + pause > give_up:
                    raise LinkLost(f"{self.name} did not come back within {timeout_s:.0f} s: {problem}") from problem
            self._clock.sleep(pause)
            pause = min(2 * pause, 2.0)

    # Motion

    def enable(self, on: bool) -> None:
        if command := self._table.enable if on else self._table.disable:
            self._lines.ask(command)
        self._enabled = on
        if not on:
            self._forget_home()

    def home(self, max_steps: int, timeout_s: float = 120.0) -> None:
        """Look for the home switch, as far as the board's own settings allow."""
        self._require(self._enabled, Reason.DRIVER_OFF, "home")
        if self._table.home:
            self._zero = None
            self._lines.alarm = None
            if not self._lines.ask_long(self._table.home, timeout_s):
                self._reset()
                raise RigTimeout(f"homing did not end within {timeout_s:.1f} s; it was stopped")
            self._await_rest("homing", timeout_s)
        elif self._zero is not None:
            self.move(0, timeout_s)
        elif self._home_lost:
            raise Refused(
                Reason.NO_SUCH_PART, "home", "there is no home switch, and where the table stands is not known any more"
            )
        self._zero, self._home_lost = self._axis(self._lines.report()), False

    def move(self, to: int, timeout_s: float = 120.0) -> int:
        self._require(self._enabled, Reason.DRIVER_OFF, f"move to {to}")
        self._require(self._zero is not None, Reason.NOT_HOMED, f"move to {to}")
        settings = self._settings or Settings()
        if settings.limits is not None:
            low, high = settings.limits
            self._require(low <= to <= high, Reason.BEYOND_LIMIT, f"move to {to}")
        if settings.backlash and to < self._position(self._lines.report()):
            self._go(to - settings.backlash, settings.speed, timeout_s)
        return self._go(to, settings.speed, timeout_s)

    def stop(self) -> None:
        self._lines.raise_reset()
        if self._come_to_rest():
            # What it was told to go to is forgotten in a reset; from rest the place is kept.
            self._reset()
        self._off()

    # Light

    def arm(self, on: bool) -> None:
        if on:
            self._require(self.stat().fault is None, Reason.IN_FAULT, "arm")
        else:
            self._off()
        self._armed = on

    def laser(self, on: bool, *, number: int = 1) -> None:
        if not on:
            self._off()
            return
        self._require(self._armed, Reason.NOT_ARMED, f"laser {number} on")
        self._require(1 <= number <= len(self._table.laser_on), Reason.NO_SUCH_PART, f"laser {number} on")
        self._lit = True
        self._lines.ask(self._table.laser_on[number - 1])

    # The camera's wire, which there is none of

    def trigger(self) -> None:
        raise Refused(Reason.NO_SUCH_PART, "trigger")

    def shot(self, to: int, id: int, *, number: int = 1) -> None:
        raise Refused(Reason.NO_SUCH_PART, f"shot {id} at {to}")

    def wait_shot(self, id: int, timeout_s: float = 120.0) -> ShotDone:
        raise Refused(Reason.NO_SUCH_PART, f"shot {id}")

    # State

    def stat(self) -> Status:
        report = self._lines.report()
        fault = self._fault(report)
        # Alarm without a number is the state after power on, which homing ends.
        state = "idle" if report.state == "Alarm" and fault is None else STATES[report.state]
        return Status(
            state="move" if report.moving and state == "idle" else state,
            fault=fault,
            position=self._position(report),
            homed=self._zero is not None,
            armed=self._armed,
            enabled=self._enabled,
            laser=self._lit,
            estop=report.state == "Door" and report.part > 0,
        )

    def poll(self) -> Status:
        status = self.stat()
        if status.fault is not None:
            raise RigFault(status.fault, status.position, self._said())
        return status

    def counters(self) -> None:
        """It has none."""

    def clear(self) -> None:
        self._require(not self.stat().estop, Reason.STILL_PRESSED, "clear")
        self._reset()
        self._lines.alarm = None
        if self._lines.report().state == "Alarm":
            self._lines.ask("$X")

    # The way out

    def abort(self) -> None:
        self._armed = self._lit = False
        self._lines.abort()

    def make_safe(self) -> bool:
        self._armed = False
        # That it began anew is no reason not to switch the laser off.
        self._lines.forget_reset()
        for way in (self.stop, self._reset):
            try:
                way()
                if self._is_dark():
                    return True
            except RigError as problem:
                log.warning("%s", problem)
                self._lines.forget_reset()
        return False

    def close(self) -> None:
        if self._closed:
            return
        self._closed = True
        try:
            safe = self.make_safe()
        finally:
            self._lines.link.close()
        if not safe:
            raise RigError(f"{self.name}: {UNCONFIRMED}")

    def __enter__(self) -> "GrblController":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        close_after(self, error)

    # Within

    def _begin(self) -> None:
        """At rest, laser off, out of the lock that needs no home switch; whether home is known is known then."""
        if self._boot != 1 + self._lines.resets:
            self._boot = 1 + self._lines.resets
            self._forget_home()
        self._lines.forget_reset()
        self._come_to_rest()
        self._reset()
        self._armed = False
        if self._lines.report().state == "Alarm":
            self._forget_home()
            self._lines.alarm = None
            if not self._table.home:
                self._lines.ask("$X")

    def _forget_home(self) -> None:
        self._home_lost = self._home_lost or self._zero is not None
        self._zero = None

    def _require(self, held: bool, reason: Reason, command: str) -> None:
        if not held:
            raise Refused(reason, command)

    def _reset(self) -> None:
        self._lines.reset()
        self._lit = False

    def _come_to_rest(self) -> bool:
        """Slow the table down; whether it turned."""
        report = self._lines.report()
        turned = report.moving or report.state == "Hold"
        give_up = self._clock.now() + REST_S
        while report.moving and report.state != "Home":
            if self._clock.now() >= give_up:
                raise LinkLost(f"{self.name}: the table did not come to rest")
            self._lines.write(HOLD)
            self._clock.sleep(POLL_S)
            report = self._lines.report()
        return turned

    def _off(self) -> None:
        """All lasers off; in an alarm the board has done so itself, and refuses to be told."""
        try:
            self._lines.ask(self._table.laser_off)
        except Refused as problem:
            if problem.reason is not Reason.IN_FAULT:
                raise
        self._lit = False

    def _is_dark(self) -> bool:
        """Whether the board says that the laser is off; of a laser that is no spindle, that it was told so."""
        spindle = any(command.startswith(("M3", "M4")) for command in self._table.laser_on)
        if not spindle:
            self._lines.ask(self._table.laser_off)
            return True
        return any(line.startswith("[GC:") and " M5 " in line for line in self._lines.ask("$G"))

    def _go(self, to: int, speed: int, timeout_s: float) -> int:
        zero = 0.0 if self._zero is None else self._zero
        feed = 60 * speed / self._units.steps_per_unit
        target = zero + self._units.units(to)
        self._lines.ask(f"G21 G90 G94 G53 G1 {self._table.axis}{target:.4f} F{feed:.2f}")
        return self._await_rest(f"moving to {to}", timeout_s, at=to)

    def _await_rest(self, what: str, timeout_s: float, at: int | None = None) -> int:
        """Wait until the table rests; elsewhere than `at`, until it has been seen at rest several times."""
        give_up = self._clock.now() + timeout_s
        still = 0
        while True:
            report = self._lines.report()
            if (fault := self._fault(report)) is not None:
                raise RigFault(fault, self._position(report), self._said())
            position = self._position(report)
            still = still + 1 if report.state == "Idle" else 0
            if still >= _STILL or (still and position == at):
                return position
            if self._clock.now() >= give_up:
                self._come_to_rest()
                self._reset()
                raise RigTimeout(f"{what} did not end within {timeout_s:.1f} s; it was stopped")
            self._clock.sleep(POLL_S)

    def _fault(self, report: Report) -> Fault | None:
        """The fault that a report tells of; what is known no more after it is forgotten."""
        number = self._lines.alarm
        if report.state == "Door":
            fault = Fault.EMERGENCY_STOP
        elif report.state == "Sleep" or (report.state == "Alarm" and number is not None):
            fault = ALARMS.get(number or 0, Fault.UNKNOWN)
        else:
            return None
        self._armed = self._lit = False
        if number != 2:
            self._forget_home()
        return fault

    def _said(self) -> str:
        return "" if self._lines.alarm is None else f"ALARM:{self._lines.alarm}"

    def _axis(self, report: Report) -> float:
        at = report.position(self._table.axis)
        if at is None:
            raise RigError(f"{self.name}: its reports have no position of the machine; type $10=1")
        return at

    def _position(self, report: Report) -> int:
        return self._units.microsteps(self._axis(report) - (0.0 if self._zero is None else self._zero))
