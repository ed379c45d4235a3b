"""A controller that speaks GRBL: the device is identified, its axis measured, and driven as any controller."""

import dataclasses
import logging
import re

from scanrig.clock import Clock
from scanrig.controllers.controller import (
    Controller,
    ControllerTable,
    Firmware,
    GrblTable,
    Guarantees,
    LinkCounts,
    Reconnection,
    Settings,
    ShotDone,
    State,
    Status,
    with_growing_pauses,
)
from scanrig.controllers.grbl.lines import (
    BOOT_S,
    HOLD,
    POLL_S,
    QUERY,
    STATES,
    GrblLines,
    Report,
    TableUnits,
    read_report,
    read_settings,
)
from scanrig.errors import Fault, FirmwareError, LinkLost, PortError, Reason, Refused, RigError, RigFault, RigTimeout
from scanrig.wire import Link, open_port


log = logging.getLogger(__name__)

AWAKE_S = 0.5
_TOLERANCE = 1e-4
"""Part by which a setting may differ: the board prints three decimals."""


def wake(lines: GrblLines) -> None:
    """Wait until the board answers: at once, or after its boot loader if opening the port has reset it."""
    lines.greeting = ""
    lines.write(b"\n" + QUERY)
    give_up = lines.clock.now() + AWAKE_S
    while (left := give_up - lines.clock.now()) > 0:
        if any(read_report(text) for text in lines.read(left, raise_resets=False)) or lines.greeting:
            return
    if not lines.await_greeting(BOOT_S):
        lines.reset()


def greet(lines: GrblLines) -> str:
    """Wait until the board answers, check its greeting, and return its version.

    Raises:
        FirmwareError: no answer, or another device; the message quotes it.
        LinkLost: the port went away.
    """
    try:
        wake(lines)
        lines.reset()
    except LinkLost as problem:
        if lines.broken:
            raise
        found = f"a device that sends {lines.heard[:60]!r}" if lines.heard else "silence"
        raise FirmwareError(
            f"{lines.link.name}: found {found}, needed a board that greets with '{lines.expected_greeting}' after a "
            "reset; check port, power, controller.baud and controller.grbl.greeting, or unlock the board ($X)"
        ) from problem
    # FluidNC writes GRBL's version first, and its own in brackets.
    own = re.search(r"FluidNC (v\S+)", lines.greeting)
    words = lines.greeting.split()
    return own[1] if own else words[1] if len(words) > 1 else "unknown"


def require_fit(lines: GrblLines, table: GrblTable, units: TableUnits, settings: Settings) -> None:
    """Raise FirmwareError, with what to type, if the board's own settings do not fit; they are never changed here."""
    answer = lines.ask("$$")
    says = read_settings(answer)
    axis = "XYZABC".index(table.axis)
    feed = 60 * settings.speed / units.steps_per_unit
    if 100 + axis not in says:
        name, found = lines.dialect.name, ", ".join(answer)[:60] or "nothing"
        where = "its configuration file (config.yaml)" if not lines.dialect.listed else "its own settings"
        raise FirmwareError(
            f"{lines.link.name}: found {found} in answer to $$; {name} does not list its axes there. Look in {where} "
            f"for steps_per_mm = {units.steps_per_unit:.10g} and max_rate = {feed:.10g} or more on axis {table.axis}, "
            "then set check_settings = false under [controller.grbl]"
        )
    wanted = {1: 255.0, 13: 0.0, 32: 0.0, 100 + axis: units.steps_per_unit}
    # A mask in grblHAL: homing is its first bit.
    if table.home and not int(says.get(22, 0)) & 1:
        wanted[22] = 1.0
    wrong = {
        number: value
        for number, value in wanted.items()
        if number not in says or abs(says[number] - value) > _TOLERANCE * max(1.0, abs(value))
    }
    if not int(says.get(10, 1)) & 1:
        wrong[10] = 1.0
    if says.get(110 + axis, feed) < feed * (1 - _TOLERANCE):
        wrong[110 + axis] = feed
    if wrong:
        found = ", ".join(f"${number}={says.get(number, 'nothing')}" for number in wrong)
        do = ", ".join(f"${number}={value:.10g}" for number, value in wrong.items())
        raise FirmwareError(
            f"{lines.link.name}: found {found}; expected {do}: type that on the board, or change the configuration"
        )


REST_S = 10.0
_STILL = 3
"""Reports of standstill after which a motion is over, wherever it ended."""

_FAULTS = {"Door": Fault.EMERGENCY_STOP, "Sleep": Fault.ASLEEP, "Tool": Fault.TOOL_CHANGE}


class GrblController(Controller):
    """A session with a GRBL board."""

    guarantees = Guarantees(
        laser_off_without_host=False, knows_missed_steps=False, hardware_trigger=False, checked_lines=False
    )

    def __init__(self, lines: GrblLines, table: GrblTable, units: TableUnits) -> None:
        """Nothing is sent yet."""
        self._lines, self._table = lines, table
        self._units = units
        self._zero: float | None = None
        """Coordinate of the axis at home; None while home is not known."""
        self._lost = False
        """Whether home was known and was lost."""
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
        self._units = dataclasses.replace(self._units, reverse=settings.reverse)
        if self._table.check_settings:
            require_fit(self._lines, self._table, self._units, settings)
        self._settings = settings

    def reconnect(self, timeout_s: float = 60.0) -> Reconnection:
        """Find the board again, with growing pauses. Many boards are reset when their port is opened."""
        before = self._boot

        def found() -> Reconnection:
            try:
                self._lines.open_again()
                wake(self._lines)
                self._begin()
                if self._settings is not None:
                    self.configure(self._settings)
                return Reconnection(self._boot == before, self.stat())
            except (LinkLost, PortError):
                self._lines.broken = True
                raise

        return with_growing_pauses(found, self._lines.clock, timeout_s, self.name)

    # Motion

    def enable(self, on: bool) -> None:
        if command := self._table.enable if on else self._table.disable:
            self._lines.ask(command)
        self._enabled = on
        if not on:
            self._forget_home()

    def home(self, max_steps: int, timeout_s: float = 120.0) -> None:
        """Search for the home switch, as far as the board's own settings allow.

        Without a switch, home is the position at the first call; it is refused once the table's position was lost.
        """
        lines = self._lines
        _require(self._enabled, Reason.DRIVER_OFF, "home")
        if self._table.home:
            self._zero, lines.alarm = None, None
            if not lines.ask_long(self._table.home, timeout_s):
                lines.reset()
                raise RigTimeout(f"homing did not end within {timeout_s:.1f} s; it was stopped")
            self._await_rest("homing", timeout_s)
        elif self._zero is not None:
            self._go(0, (self._settings or Settings()).speed, timeout_s)
        elif self._lost:
            why = "there is no home switch, and where the table stands is not known any more"
            raise Refused(Reason.NO_SUCH_PART, "home", why)
        self._zero, self._lost = self._reported(lines.report()), False

    def move(self, to: int, timeout_s: float = 120.0) -> int:
        _require(self._enabled, Reason.DRIVER_OFF, f"move to {to}")
        _require(self._zero is not None, Reason.NOT_HOMED, f"move to {to}")
        settings = self._settings or Settings()
        if settings.limits is not None:
            low, high = settings.limits
            _require(low <= to <= high, Reason.BEYOND_LIMIT, f"move to {to}")
        if settings.backlash and to < self._position(self._lines.report()):
            self._go(to - settings.backlash, settings.speed, timeout_s)
        return self._go(to, settings.speed, timeout_s)

    def stop(self) -> None:
        self._lines.raise_reset()
        if self._come_to_rest():
            # A reset cancels the motion; at standstill it keeps the position.
            self._reset()
        self._off()

    # Light

    def arm(self, on: bool) -> None:
        if on:
            _require(self.stat().fault is None, Reason.IN_FAULT, "arm")
        else:
            self._off()
        self._armed = on

    def laser(self, on: bool, *, number: int = 1) -> None:
        if not on:
            self._off()
            return
        _require(self._armed, Reason.NOT_ARMED, f"laser {number} on")
        _require(1 <= number <= len(self._table.laser_on), Reason.NO_SUCH_PART, f"laser {number} on")
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
        fault = self._fault(report)
        if fault is not None:
            self._armed = self._lit = False
        state: State = STATES[report.state]
        if state == "fault" and fault is None:
            # Alarm without a number is the lock after power on; homing ends it.
            state = "idle"
        return Status(
            state=state,
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
            self._raise_fault(self._lines.report())
        return status

    def counters(self) -> None:
        """It has none."""

    def clear(self) -> None:
        _require(not self.stat().estop, Reason.STILL_PRESSED, "clear")
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
        self._lines.raised_reset = self._lines.resets
        for way in (self.stop, self._reset):
            try:
                way()
                if self._is_dark():
                    return True
            except RigError as problem:
                log.warning("%s", problem)
                self._lines.raised_reset = self._lines.resets
        return False

    # The axis that turns the table, in microsteps from home

    def _position(self, report: Report) -> int:
        """The table's position in a report; counted from the axis's own zero while home is not known."""
        return self._units.microsteps(self._reported(report) - (self._zero or 0.0))

    def _forget_home(self) -> None:
        self._lost = self._lost or self._zero is not None
        self._zero = None

    def _go(self, to: int, speed: int, timeout_s: float) -> int:
        """Turn to a position [microsteps from home] at a speed [microsteps/s]; returns where the table stands then."""
        target = (self._zero or 0.0) + self._units.units(to)
        feed = 60 * speed / self._units.steps_per_unit
        self._lines.ask(f"G21 G90 G94 G53 G1 {self._table.axis}{target:.4f} F{feed:.2f}")
        return self._await_rest(f"moving to {to}", timeout_s, at=to)

    def _come_to_rest(self) -> bool:
        """Stop the table; returns whether it was turning or held on its way."""
        report = self._lines.report()
        turned = report.moving or report.state == "Hold"
        give_up = self._lines.clock.now() + REST_S
        while report.moving and report.state != "Home":
            if self._lines.clock.now() >= give_up:
                raise LinkLost(f"{self._lines.link.name}: the table did not come to rest")
            self._lines.write(HOLD)
            self._lines.clock.sleep(POLL_S)
            report = self._lines.report()
        return turned

    def _fault(self, report: Report) -> Fault | None:
        """The fault in a report, or None; home is lost after most faults."""
        dialect = self._lines.dialect
        # An alarm's number may come in the report, or have been said before it.
        number = report.part if report.state == "Alarm" and report.part else self._lines.alarm
        if report.state == "Hold" and not report.moving:
            # A table that is held has lost nothing.
            return Fault.HELD
        if report.state in _FAULTS:
            fault = _FAULTS[report.state]
        elif report.state == "Alarm" and number is not None and number not in dialect.unhomed:
            fault = dialect.alarms.get(number, Fault.UNKNOWN)
        else:
            return None
        if number != 2:
            self._forget_home()
        return fault

    def _raise_fault(self, report: Report) -> None:
        """Raise the fault in a report, if there is one."""
        if (fault := self._fault(report)) is not None:
            raise RigFault(fault, self._position(report), self._words(report))

    def _words(self, report: Report) -> str:
        """What the board says of its fault."""
        name = self._lines.dialect.name
        if report.state == "Door":
            door = "is open: close it" if report.part else "was open, and is closed again"
            return f"{name} says Door:{report.part}: its safety door, or what is wired to that pin, {door}"
        number = report.part if report.state == "Alarm" and report.part else self._lines.alarm
        return f"{name} says {report.state if number is None else f'ALARM:{number}'}"

    def _await_rest(self, motion: str, timeout_s: float, at: int | None = None) -> int:
        """Wait until the table stands still; at another position than `at`, in several reports."""
        clock = self._lines.clock
        give_up = clock.now() + timeout_s
        still = 0
        while True:
            report = self._lines.report()
            self._raise_fault(report)
            position = self._position(report)
            still = still + 1 if report.state == "Idle" else 0
            if still >= _STILL or (still and position == at):
                return position
            if clock.now() >= give_up:
                self._come_to_rest()
                self._lines.reset()
                raise RigTimeout(f"{motion} did not end within {timeout_s:.1f} s; it was stopped")
            clock.sleep(POLL_S)

    def _reported(self, report: Report) -> float:
        at = report.position(self._table.axis)
        if at is None:
            raise RigError(f"{self._lines.link.name}: its reports have no position of the machine; type $10=1")
        return at

    # Within

    def _begin(self) -> None:
        """Stop the table, switch the laser off, unlock a board without a home switch; note whether home is known."""
        if self._boot != 1 + self._lines.resets:
            self._boot = 1 + self._lines.resets
            self._forget_home()
        self._lines.raised_reset = self._lines.resets
        self._come_to_rest()
        self._reset()
        self._armed = False
        report = self._lines.report()
        if report.state == "Alarm":
            self._forget_home()
            self._lines.alarm = None
            if self._fault(report) is Fault.EMERGENCY_STOP:
                # A reset has just failed to end it.
                raise RigFault(Fault.EMERGENCY_STOP, None, self._words(report))
            if not self._table.home:
                self._lines.ask("$X")

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


def _require(held: bool, reason: Reason, command: str) -> None:
    if not held:
        raise Refused(reason, command)


def connect_grbl(
    table: ControllerTable, microsteps_per_turn: int, *, port: str, clock: Clock | None = None
) -> GrblController:
    """Open a board's port, a path, a USB serial number or "auto"; raises PortError. Nothing is sent before `hello`."""
    clock = clock or Clock()
    link, reopen = open_port(port, table.baud or 115_200, clock)
    lines = GrblLines(link, clock, greeting=table.grbl.greeting, reopen=reopen)
    return GrblController(lines, table.grbl, TableUnits(microsteps_per_turn, table.grbl.units_per_turn))
