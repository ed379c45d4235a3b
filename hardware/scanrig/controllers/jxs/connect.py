"""From a port's name to a controller that can be found again."""

from scanrig.clock import Clock
from scanrig.controllers.jxs.controller import JxsController
from scanrig.wire import Link, choose_port, find_again, identify, open_serial


def connect(port: str = "auto", baud: int = 250_000, clock: Clock | None = None) -> JxsController:
    """Open the controller's port. Nothing is said to it before `hello`.

    Args:
        port: a path, a USB serial number, or "auto" for the only board there is.
        baud: bits per second.
        clock: for every wait.

    Returns:
        A controller whose `reconnect` finds the same board again, by its USB serial number or its path under
        /dev/serial/by-id, even where it comes back under another port number.

    Raises:
        PortError: none, several, missing, taken, or no right to use it.
    """
    path = choose_port(port)
    link = open_serial(path, baud, clock)
    known = identify(path)

    def reopen() -> Link:
        return open_serial(find_again(known), baud, clock)

    return JxsController(link, clock, reopen=reopen)
