"""Switches everything off and has it confirmed."""

import logging

from scanrig.clock import Clock
from scanrig.controllers.jxs.answers import read_status
from scanrig.controllers.jxs.exchange import Exchange
from scanrig.errors import Refused, RigError


log = logging.getLogger(__name__)

TRIES = 3
"""Fewer tries than usual; then the abort byte is sent, which works without a valid line."""

STOPPING_S = 0.5
"""How long a shot may take to end after STOP."""


def make_safe(wire: Exchange, clock: Clock) -> bool:
    """Stop, laser off, contactor open; if that is not answered, abort.

    Raises no error of the rig, so that every exit can call it.

    Returns:
        True if the controller confirmed that the laser is off, the contactor open, and nothing runs that could switch
        it on again.
    """
    try:
        _insist(wire, "STOP")
        _insist(wire, "LASER", on=0)
        _insist(wire, "ARM", on=0)
        if is_dark(wire, clock):
            return True
    except RigError as problem:
        # No answer, or an incomplete one: the abort byte needs neither.
        log.warning("%s", problem)
    try:
        wire.abort()
        return is_dark(wire, clock)
    except RigError as problem:
        log.warning("%s", problem)
        return False


def is_dark(wire: Exchange, clock: Clock) -> bool:
    """Whether the controller confirms that the laser is off and stays off. Raises RigError if it does not answer."""
    end = clock.now() + STOPPING_S
    while True:
        status = read_status(wire.ask("STAT", tries=TRIES))
        if not status.laser and not status.armed and status.state != "shot":
            return True
        if clock.now() >= end:
            return False
        clock.sleep(0.02)


def _insist(wire: Exchange, verb: str, **args: int) -> None:
    """Send a command; a refusal is logged, so that the next command follows."""
    try:
        wire.ask(verb, tries=TRIES, **args)
    except Refused as problem:
        log.warning("%s", problem)
