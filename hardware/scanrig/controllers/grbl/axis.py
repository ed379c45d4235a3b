"""The table as an axis of a GRBL board: position, home, motions and their ends."""

from scanrig.controllers.grbl.lines import HOLD, POLL_S, GrblLines
from scanrig.controllers.grbl.report import Report
from scanrig.controllers.grbl.units import TableUnits
from scanrig.controllers.table import GrblTable
from scanrig.errors import Fault, LinkLost, Reason, Refused, RigError, RigFault, RigTimeout


REST_S = 10.0
"""Longest time that the table may take to stop."""
_STILL = 3
"""Reports of standstill after which a motion is over, wherever it ended."""


_FAULTS = {"Door": Fault.EMERGENCY_STOP, "Sleep": Fault.ASLEEP, "Tool": Fault.TOOL_CHANGE}


class TableAxis:
    """The axis that turns the table, in microsteps from home.

    Attributes:
        units: units of the axis.
        zero: coordinate of the axis at home; None while home is not known.
        lost: whether home was known and was lost.
    """

    def __init__(self, lines: GrblLines, table: GrblTable, units: TableUnits) -> None:
        self.units = units
        self.zero: float | None = None
        self.lost = False
        self._lines, self._table = lines, table

    def position(self, report: Report) -> int:
        """The table's position in a report; counted from the axis's own zero while home is not known."""
        return self.units.microsteps(self._reported(report) - (self.zero or 0.0))

    def forget_home(self) -> None:
        """Mark home as lost."""
        self.lost = self.lost or self.zero is not None
        self.zero = None

    def find_home(self, speed: int, timeout_s: float) -> None:
        """Search for the home switch; without a switch, home is the position at the first call.

        Raises:
            Refused: there is no switch, and the table's position was lost.
            RigFault, RigTimeout: as for `go`.
        """
        lines = self._lines
        if self._table.home:
            self.zero, lines.alarm = None, None
            if not lines.ask_long(self._table.home, timeout_s):
                lines.reset()
                raise RigTimeout(f"homing did not end within {timeout_s:.1f} s; it was stopped")
            self._await_rest("homing", timeout_s)
        elif self.zero is not None:
            self.go(0, speed, timeout_s)
        elif self.lost:
            why = "there is no home switch, and where the table stands is not known any more"
            raise Refused(Reason.NO_SUCH_PART, "home", why)
        self.zero, self.lost = self._reported(lines.report()), False

    def go(self, to: int, speed: int, timeout_s: float) -> int:
        """Turn to a position and wait until the table stands still.

        Args:
            to: Microsteps from home.
            speed: Microsteps per second.
            timeout_s: How long to wait.

        Returns:
            The position where it stands.

        Raises:
            RigFault: An alarm ended the motion.
            RigTimeout: The motion did not end in time and was stopped.
        """
        target = (self.zero or 0.0) + self.units.units(to)
        feed = 60 * speed / self.units.steps_per_unit
        self._lines.ask(f"G21 G90 G94 G53 G1 {self._table.axis}{target:.4f} F{feed:.2f}")
        return self._await_rest(f"moving to {to}", timeout_s, at=to)

    def come_to_rest(self) -> bool:
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

    def fault(self, report: Report) -> Fault | None:
        """The fault in a report, or None; home is lost after most faults."""
        number = self._alarm(report)
        if report.state == "Hold" and not report.moving:
            # A table that is held has lost nothing.
            return Fault.HELD
        if report.state in _FAULTS:
            fault = _FAULTS[report.state]
        elif report.state == "Alarm" and number is not None:
            fault = self._lines.dialect.alarms.get(number, Fault.UNKNOWN)
        else:
            return None
        if number != 2:
            self.forget_home()
        return fault

    def raise_fault(self, report: Report) -> None:
        """Raise the fault in a report, if there is one."""
        if (fault := self.fault(report)) is not None:
            raise RigFault(fault, self.position(report), self.words(report))

    def words(self, report: Report) -> str:
        """What the board says of its fault."""
        number, name = self._alarm(report), self._lines.dialect.name
        if report.state == "Door":
            door = "is open: close it" if report.part else "was open, and is closed again"
            return f"{name} says Door:{report.part}: its safety door, or what is wired to that pin, {door}"
        if number is not None:
            return f"{name} says ALARM:{number}"
        return f"{name} says {report.state}"

    def _alarm(self, report: Report) -> int | None:
        """The number of the alarm in a report, or said before it; None for the lock of a board that is not homed."""
        number = report.part if report.state == "Alarm" and report.part else self._lines.alarm
        return None if number in self._lines.dialect.unhomed else number

    def _await_rest(self, motion: str, timeout_s: float, at: int | None = None) -> int:
        """Wait until the table stands still; at another position than `at`, in several reports."""
        clock = self._lines.clock
        give_up = clock.now() + timeout_s
        still = 0
        while True:
            report = self._lines.report()
            self.raise_fault(report)
            position = self.position(report)
            still = still + 1 if report.state == "Idle" else 0
            if still >= _STILL or (still and position == at):
                return position
            if clock.now() >= give_up:
                self.come_to_rest()
                self._lines.reset()
                raise RigTimeout(f"{motion} did not end within {timeout_s:.1f} s; it was stopped")
            clock.sleep(POLL_S)

    def _reported(self, report: Report) -> float:
        at = report.position(self._table.axis)
        if at is None:
            raise RigError(f"{self._lines.link.name}: its reports have no position of the machine; type $10=1")
        return at
