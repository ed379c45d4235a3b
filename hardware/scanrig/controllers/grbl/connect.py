"""From a port's name to a GRBL board that can be found again."""

from scanrig.clock import Clock, SystemClock
from scanrig.controllers.grbl.controller import GrblController
from scanrig.controllers.grbl.lines import GrblLines
from scanrig.controllers.grbl.units import TableUnits
from scanrig.controllers.table import ControllerTable
from scanrig.wire import Link, choose_port, find_again, identify, open_serial


BAUD = 115_200


def connect_grbl(
    table: ControllerTable, microsteps_per_turn: int, *, port: str | None = None, clock: Clock | None = None
) -> GrblController:
    """Open a board's port. Nothing is said to it before `hello`.

    Args:
        table: What the board is told.
        microsteps_per_turn: Of the table.
        port: Instead of the table's: a path, a USB serial number, or "auto".
        clock: For every wait.

    Raises:
        PortError: None, several, missing, taken, or no right to use it.
    """
    clock = clock or SystemClock()
    path = choose_port(port or table.port)
    baud = table.baud or BAUD
    link = open_serial(path, baud, clock)
    known = identify(path)

    def reopen() -> Link:
        return open_serial(find_again(known), baud, clock)

    lines = GrblLines(link, clock, greeting=table.grbl.greeting, reopen=reopen)
    return GrblController(lines, table.grbl, TableUnits(microsteps_per_turn, table.grbl.units_per_turn))
