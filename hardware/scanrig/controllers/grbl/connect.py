"""Opens the port of a GRBL board."""

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
    """Open a board's port. Nothing is sent before `hello`.

    Args:
        table: Port and commands of the board.
        microsteps_per_turn: Of the table.
        port: Replaces the table's port: a path, a USB serial number, or "auto".
        clock: For every wait.

    Raises:
        PortError: No port, several, port missing or in use, or no permission.
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
