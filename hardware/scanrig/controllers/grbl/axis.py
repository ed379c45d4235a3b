"""The table as an axis of a GRBL board: where it stands, where home is, motions and their ends."""

from scanrig.controllers.grbl.lines import HOLD, POLL_S, GrblLines
from scanrig.controllers.grbl.report import ALARMS, Report
from scanrig.controllers.grbl.units import TableUnits
from scanrig.controllers.table import GrblTable
from scanrig.errors import Fault, LinkLost, Reason, Refused, RigError, RigFault, RigTimeout


REST_S = 10.0
"""How long a table may take to slow down."""
_STILL = 3
"""Reports of rest after which a motion is over, wherever it ended."""


class TableAxis:
    """The axis that turns the table, in microsteps from home.

    Attributes:
        units: how the axis counts.
        zero: what the axis says at home; None while home is not known.
        lost: whether home was known and is not any more.
    """

    def __init__(self, lines: GrblLines, table: GrblTable, units: TableUnits) -> None:
        self.units = units
        self.zero: float | None = None
        self.lost = False
        self._lines, self._table = lines, table

    def position(self, report: Report) -> int:
        """Where a report says that the table stands; from wherever the axis counts, while home is not known."""
        return self.units.microsteps(self._reported(report) - (self.zero or 0.0))

    def forget_home(self) -> None:
        """Home is known no more."""
        self.lost = self.lost or self.zero is not None
        self.zero = None

    def find_home(self, speed: int, timeout_s: float) -> None:
        """Look for the home switch; without one, home is where the table stood when it was asked for first.

        Raises:
            Refused: there is no switch, and where the table stands is not known any more.
            RigFault, RigTimeout: as of `go`.
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
        """Turn to a position and wait until the table rests.

        Args:
            to: Microsteps from home.
            speed: Microsteps per second.
            timeout_s: How long to wait.

        Returns:
            Where it rests.

        Raises:
            RigFault: An alarm ended it.
            RigTimeout: It was stopped.
        """
        target = (self.zero or 0.0) + self.units.units(to)
        feed = 60 * speed / self.units.steps_per_unit
        self._lines.ask(f"G21 G90 G94 G53 G1 {self._table.axis}{target:.4f} F{feed:.2f}")
        return self._await_rest(f"moving to {to}", timeout_s, at=to)

    def come_to_rest(self) -> bool:
        """Slow the table down; whether it turned, or was held on its way."""
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
        """The fault that a report tells of; home is forgotten where it is not certain after that."""
        number = self._lines.alarm
        if report.state == "Door":
            fault = Fault.EMERGENCY_STOP
        elif report.state == "Sleep" or (report.state == "Alarm" and number is not None):
            fault = ALARMS.get(number or 0, Fault.UNKNOWN)
        else:
            return None
        if number != 2:
            self.forget_home()
        return fault

    def raise_fault(self, report: Report) -> None:
        """Raise the fault that a report tells of."""
        if (fault := self.fault(report)) is not None:
            number = self._lines.alarm
            raise RigFault(fault, self.position(report), "" if number is None else f"ALARM:{number}")

    def _await_rest(self, what: str, timeout_s: float, at: int | None = None) -> int:
        """Wait until the table rests; elsewhere than `at`, until it has been seen at rest several times."""
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
                raise RigTimeout(f"{what} did not end within {timeout_s:.1f} s; it was stopped")
            clock.sleep(POLL_S)

    def _reported(self, report: Report) -> float:
        at = report.position(self._table.axis)
        if at is None:
            raise RigError(f"{self._lines.link.name}: its reports have no position of the machine; type $10=1")
        return at
