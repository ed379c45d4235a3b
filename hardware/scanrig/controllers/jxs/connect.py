"""Opens the port of a controller with the scanner's own firmware."""

from scanrig.clock import Clock
from scanrig.controllers.jxs.controller import JxsController
from scanrig.wire import Link, choose_port, find_again, identify, open_serial


def connect(port: str = "auto", baud: int = 250_000, clock: Clock | None = None) -> JxsController:
    """Open the controller's port. Nothing is sent before `hello`.

    Args:
        port: a path, a USB serial number, or "auto" for the only board.
        baud: bits per second.
        clock: for every wait.

    Returns:
        A controller whose `reconnect` finds the same board again, by its USB serial number or its path under
        /dev/serial/by-id, even under another port number.

    Raises:
        PortError: no port, several, port missing or in use, or no permission.
    """
    path = choose_port(port)
    link = open_serial(path, baud, clock)
    known = identify(path)

    def reopen() -> Link:
        return open_serial(find_again(known), baud, clock)

    return JxsController(link, clock, reopen=reopen)
