"""Controllers turn the table, switch the lasers and may trigger the camera. All have one interface.

`jxs/` is for the scanner's own firmware (PROTOCOL.md), `grbl/` for boards that speak GRBL's G-code; only the one that
is opened is loaded.
"""

from jaxscan.errors import ConfigError
from scanrig.clock import Clock
from scanrig.controllers.controller import (
    UNCONFIRMED,
    Controller,
    ControllerTable,
    Counters,
    Firmware,
    GrblTable,
    Guarantees,
    LinkCounts,
    Reconnection,
    Settings,
    ShotDone,
    Status,
)


def open_controller(
    table: ControllerTable, microsteps_per_turn: int, *, port: str | None = None, clock: Clock | None = None
) -> Controller:
    """Open the controller's port. Nothing is sent before `Controller.hello`.

    Args:
        port: Replaces the table's port: a path, a USB serial number, or "auto" for the only board.

    Returns:
        A controller whose `reconnect` finds the same board again, even under another port number.

    Raises:
        ConfigError: If the controller may leave the laser on and the configuration does not allow that.
        PortError: No port, several, port missing or in use, or no permission.
    """
    wanted = port or table.port
    match table.type:
        case "jaxscan":
            from scanrig.controllers.jxs import JxsController, connect

            require_allowed(JxsController.guarantees, table)
            return connect(wanted, table.baud, clock)
        case "grbl":
            from scanrig.controllers.grbl import GrblController, connect_grbl

            require_allowed(GrblController.guarantees, table)
            return connect_grbl(table, microsteps_per_turn, port=wanted, clock=clock)


def require_allowed(guarantees: Guarantees, table: ControllerTable) -> None:
    """Raise ConfigError unless the configuration allows a controller that leaves the laser on without the host."""
    if not guarantees.laser_off_without_host and not table.allow_laser_without_watchdog:
        raise ConfigError(
            "controller.allow_laser_without_watchdog: found false, expected true with this controller, which leaves "
            "the laser on when the program, the computer or the cable fails, until somebody cuts its supply. To scan "
            "with it all the same, write allow_laser_without_watchdog = true under [controller]."
        )


def shortcomings(guarantees: Guarantees) -> tuple[str, ...]:
    """The guarantees that a controller lacks, a sentence each; the one about the laser comes first."""
    says = []
    if not guarantees.laser_off_without_host:
        says.append(
            "The controller has no watchdog: if this program, the computer or the cable fails, the laser stays on. "
            "Do not leave the rig alone, and keep the switch of the laser's supply at hand."
        )
    if not guarantees.checked_lines:
        says.append("Its lines have no checksum: a command that was damaged on its way may be carried out.")
    if not guarantees.knows_missed_steps:
        says.append("It does not report at home whether steps were lost: only the images show that.")
    return tuple(says)
