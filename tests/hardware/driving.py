"""Helpers of tests with a rig: make it ready, and read its log."""

from collections.abc import Iterable
from typing import Any

from bench import CLOCK_HZ, SimulatedRig
from scanrig.controllers.controller import Settings
from scanrig.controllers.jxs.controller import JxsController, connect


PATIENT = 60_000
"""A link watchdog for simulated time that runs faster than the host's."""


def ready(rig: SimulatedRig, *, speed: float = 0.0, armed: bool = True, **settings: Any) -> JxsController:
    """A controller of the rig: greeted, configured, driver on, armed, homed.

    Args:
        rig: Switched on.
        speed: Simulated seconds per second from here on; up to here it is as fast as it goes.
        armed: Whether the contactor is closed.
        settings: Of the controller, by the names of `Settings`.
    """
    rig.control("speed 0")
    controller = connect(rig.port)
    controller.hello()
    controller.configure(Settings(watchdog_ms=PATIENT))
    make_ready(controller, armed=armed)
    rig.control(f"speed {speed}")
    controller.configure(Settings(**{"watchdog_ms": PATIENT, **settings}))
    return controller


def make_ready(controller: JxsController, *, armed: bool = True) -> int:
    """Driver on, armed, homed; returns the counter at home."""
    controller.enable(True)
    if armed:
        controller.arm(True)
    return controller.home(40_000)


def rises(edges: Iterable[dict[str, Any]], pin: str) -> list[dict[str, Any]]:
    """The entries at which a pin went high."""
    return [edge for edge in edges if edge.get("pin") == pin and edge["v"] == 1]


def falls(edges: Iterable[dict[str, Any]], pin: str) -> list[dict[str, Any]]:
    """The entries at which a pin went low."""
    return [edge for edge in edges if edge.get("pin") == pin and edge["v"] == 0]


def together(edges: Iterable[dict[str, Any]]) -> bool:
    """Whether the gates of two lasers were ever high at once."""
    gates = {"laser": 0, "laser_2": 0}
    for edge in edges:
        if edge.get("pin") in gates:
            gates[edge["pin"]] = edge["v"]
            if all(gates.values()):
                return True
    return False


def milliseconds(start: dict[str, Any] | int, end: dict[str, Any] | int) -> float:
    """Simulated time between two entries of the log, or cycles."""
    first = start if isinstance(start, int) else int(start["cycle"])
    last = end if isinstance(end, int) else int(end["cycle"])
    return (last - first) / CLOCK_HZ * 1e3
