"""HELLO: begins a session and finds out which device is on the port."""

import logging

from scanrig.clock import Clock
from scanrig.controllers.jxs.answers import read_firmware
from scanrig.controllers.jxs.exchange import Exchange
from scanrig.controllers.jxs.protocol import PROTOCOL
from scanrig.controllers.status import Firmware
from scanrig.errors import FirmwareError, LinkLost, Refused


log = logging.getLogger(__name__)

BOOT_S = 2.5
"""Opening its port resets an Uno; its boot loader takes this long."""


class Silence(Exception):
    """No answer to HELLO."""


def greet(wire: Exchange, clock: Clock, session: int) -> Firmware:
    """Begin a session.

    A running controller answers at once. One that was reset by opening its port sends BOOT first and is then greeted
    again.

    Args:
        wire: to the controller.
        clock: for the wait for the boot loader.
        session: 1 … 2³¹−1.

    Returns:
        The firmware that answered.

    Raises:
        Silence: no answer; `what_is_there` describes the lines that came instead.
        FirmwareError: it answers but speaks another protocol.
        LinkLost: the port went away.
    """
    wire.forget()
    wire.odd_lines.clear()
    opened = clock.now()
    try:
        fields = hello(wire, session, tries=1)
    except Silence:
        if _echoes(wire):
            raise
        if not wait_for_boot(wire, clock, opened + BOOT_S):
            log.info("%s: no BOOT within %.1f s", wire.link.name, BOOT_S)
        fields = hello(wire, session, tries=wire.tries)
    found = fields.get("proto", "unknown")
    if found != str(PROTOCOL):
        raise FirmwareError(
            f"{wire.link.name}: found firmware {fields.get('fw', 'unknown')} that speaks protocol {found}, needed "
            f"protocol {PROTOCOL}; load the firmware that belongs to this version"
        )
    firmware = read_firmware(fields)
    wire.boot = firmware.boot
    wire.restarted = None
    return firmware


def hello(wire: Exchange, session: int, tries: int) -> dict[str, str]:
    """Send HELLO, at most `tries` times."""
    try:
        return wire.ask("HELLO", ses=session, tries=tries)
    except Refused as problem:
        raise FirmwareError(f"{wire.link.name} does not begin a session: {problem}") from problem
    except LinkLost as problem:
        if problem.__cause__ is not None:
            raise  # The port itself failed, which is not silence.
        raise Silence(str(problem)) from problem


def wait_for_boot(wire: Exchange, clock: Clock, until: float) -> bool:
    """Listen until BOOT comes or the time `until` is reached; returns whether BOOT came."""
    while not any(event.name == "BOOT" for event in wire.events):
        left = until - clock.now()
        if left <= 0:
            return False
        wire.listen(left)
    return True


def what_is_there(wire: Exchange) -> str:
    """Describes, for messages, the lines that came from the port instead of an answer to HELLO."""
    if not wire.odd_lines:
        return "silence"
    says = repr(wire.odd_lines[-1][:60])[1:]
    return f"a device that echoes its input ({says})" if _echoes(wire) else f"a device that sends {says}"


def _echoes(wire: Exchange) -> bool:
    return any(b"HELLO" in line for line in wire.odd_lines)
