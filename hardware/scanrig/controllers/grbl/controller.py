"""A `Controller` for boards that speak GRBL's G-code."""

import dataclasses
import logging

from scanrig.controllers.controller import Guarantees, SafelyClosed
from scanrig.controllers.grbl.axis import TableAxis
from scanrig.controllers.grbl.greeting import greet, require_fit, wake
from scanrig.controllers.grbl.lines import GrblLines
from scanrig.controllers.grbl.report import STATES
from scanrig.controllers.grbl.units import TableUnits
from scanrig.controllers.settings import Settings
from scanrig.controllers.status import Firmware, LinkCounts, Reconnection, ShotDone, State, Status
from scanrig.controllers.table import GrblTable
from scanrig.errors import Fault, FirmwareError, LinkLost, PortError, Reason, Refused, RigError, RigFault
from scanrig.wire.link import Link


log = logging.getLogger(__name__)


class GrblController(SafelyClosed):
    """A session with a GRBL board; `Controller` documents the methods."""

    guarantees = Guarantees(
        laser_off_without_host=False, knows_missed_steps=False, hardware_trigger=False, checked_lines=False
    )

    def __init__(self, lines: GrblLines, table: GrblTable, units: TableUnits) -> None:
        """Nothing is sent yet."""
        self._lines, self._table = lines, table
        self._axis = TableAxis(lines, table, units)
        self._settings: Settings | None = None
        self._boot = 0
        self._enabled = self._armed = self._lit = False

    # Session

    @property
    def link(self) -> Link:
        return self._lines.link

    @property
    def link_counts(self) -> LinkCounts:
        return self._lines.counts

    def hello(self) -> Firmware:
        self._lines.open_again()
        version = greet(self._lines)
        self._begin()
        return Firmware(self._lines.dialect.name, version, self._boot)

    def configure(self, settings: Settings) -> None:
        known = len(self._table.laser_on)
        if settings.lasers > known:
            raise FirmwareError(
                f"controller.grbl.laser_on: found {known} commands, expected one for each of {settings.lasers} lasers"
            )
        self._axis.units = dataclasses.replace(self._axis.units, reverse=settings.reverse)
        if self._table.check_settings:
            require_fit(self._lines, self._table, self._axis.units, settings)
        self._settings = settings

    def reconnect(self, timeout_s: float = 60.0) -> Reconnection:
        """Find the board again, with growing pauses. Many boards are reset when their port is opened."""
        before = self._boot
        give_up = self._lines.clock.now() + timeout_s
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
                if self._lines.clock.now() + pause > give_up:
                    raise LinkLost(f"{self.name} did not come back within {timeout_s:.0f} s: {problem}") from problem
            self._lines.clock.sleep(pause)
            pause = min(2 * pause, 2.0)

    # Motion

    def enable(self, on: bool) -> None:
        if command := self._table.enable if on else self._table.disable:
            self._lines.ask(command)
        self._enabled = on
        if not on:
            self._axis.forget_home()

    def home(self, max_steps: int, timeout_s: float = 120.0) -> None:
        """Search for the home switch, as far as the board's own settings allow."""
        self._require(self._enabled, Reason.DRIVER_OFF, "home")
        self._axis.find_home((self._settings or Settings()).speed, timeout_s)

    def move(self, to: int, timeout_s: float = 120.0) -> int:
        self._require(self._enabled, Reason.DRIVER_OFF, f"move to {to}")
        self._require(self._axis.zero is not None, Reason.NOT_HOMED, f"move to {to}")
        settings = self._settings or Settings()
        if settings.limits is not None:
            low, high = settings.limits
            self._require(low <= to <= high, Reason.BEYOND_LIMIT, f"move to {to}")
        if settings.backlash and to < self._axis.position(self._lines.report()):
            self._axis.go(to - settings.backlash, settings.speed, timeout_s)
        return self._axis.go(to, settings.speed, timeout_s)

    def stop(self) -> None:
        self._lines.raise_reset()
        if self._axis.come_to_rest():
            # A reset cancels the motion; at standstill it keeps the position.
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

    # There is no trigger wire to the camera

    def trigger(self) -> None:
        raise Refused(Reason.NO_SUCH_PART, "trigger")

    def shot(self, to: int, id: int, *, number: int = 1) -> None:
        raise Refused(Reason.NO_SUCH_PART, f"shot {id} at {to}")

    def wait_shot(self, id: int, timeout_s: float = 120.0) -> ShotDone:
        raise Refused(Reason.NO_SUCH_PART, f"shot {id}")

    # State

    def stat(self) -> Status:
        report = self._lines.report()
        fault = self._axis.fault(report)
        if fault is not None:
            self._armed = self._lit = False
        state: State = STATES[report.state]
        if state == "fault" and fault is None:
            # Alarm without a number is the lock after power on; homing ends it.
            state = "idle"
        return Status(
            state=state,
            fault=fault,
            position=self._axis.position(report),
            homed=self._axis.zero is not None,
            armed=self._armed,
            enabled=self._enabled,
            laser=self._lit,
            estop=report.state == "Door" and report.part > 0,
        )

    def poll(self) -> Status:
        status = self.stat()
        if status.fault is not None:
            self._axis.raise_fault(self._lines.report())
        return status

    def counters(self) -> None:
        """It has none."""

    def clear(self) -> None:
        self._require(not self.stat().estop, Reason.STILL_PRESSED, "clear")
        self._reset()
        self._lines.alarm = None
        if self._lines.report().state == "Alarm":
            self._lines.ask("$X")

    # Ending

    def abort(self) -> None:
        self._armed = self._lit = False
        self._lines.abort()

    def make_safe(self) -> bool:
        self._armed = False
        # Switch the laser off even after an unexpected reset.
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

    # Within

    def _begin(self) -> None:
        """Stop the table, switch the laser off, unlock a board without a home switch; note whether home is known."""
        if self._boot != 1 + self._lines.resets:
            self._boot = 1 + self._lines.resets
            self._axis.forget_home()
        self._lines.forget_reset()
        self._axis.come_to_rest()
        self._reset()
        self._armed = False
        report = self._lines.report()
        if report.state == "Alarm":
            self._axis.forget_home()
            self._lines.alarm = None
            if self._axis.fault(report) is Fault.EMERGENCY_STOP:
                # A reset has just failed to end it.
                raise RigFault(Fault.EMERGENCY_STOP, None, self._axis.words(report))
            if not self._table.home:
                self._lines.ask("$X")

    def _require(self, held: bool, reason: Reason, command: str) -> None:
        if not held:
            raise Refused(reason, command)

    def _reset(self) -> None:
        self._lines.reset()
        self._lit = False

    def _off(self) -> None:
        """All lasers off; in an alarm the board has switched them off itself and refuses the command."""
        try:
            self._lines.ask(self._table.laser_off)
        except Refused as problem:
            if problem.reason is not Reason.IN_FAULT:
                raise
        self._lit = False

    def _is_dark(self) -> bool:
        """Whether the board confirms that the laser is off; if it is not the spindle, that it took the command."""
        spindle = any(command.startswith(("M3", "M4")) for command in self._table.laser_on)
        if not spindle:
            self._lines.ask(self._table.laser_off)
            return True
        return any(line.startswith("[GC:") and " M5 " in line for line in self._lines.ask("$G"))
