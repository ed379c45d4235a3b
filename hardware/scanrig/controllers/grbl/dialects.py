"""The dialects of GRBL: how a board is known by its greeting, and what its alarms and settings mean.

Sources: "Grbl v1.1 Interface" of github.com/gnea/grbl; `alarms.h` of github.com/grblHAL/core; "Alarms" of
wiki.fluidnc.com.
"""

import re
from collections.abc import Mapping
from typing import NamedTuple

from scanrig.errors import Fault


class Dialect(NamedTuple):
    """What a family of boards says, and means by it."""

    name: str
    alarms: Mapping[int, Fault]
    unhomed: frozenset[int] = frozenset()
    """Alarms that only say that home is not known."""
    listed: bool = True
    """Whether `$$` lists the settings of the axes."""


_ALARMS = {
    1: Fault.LIMIT,
    2: Fault.LIMIT,
    3: Fault.ABORTED,
    6: Fault.HOME_NOT_FOUND,
    7: Fault.HOME_NOT_FOUND,
    8: Fault.HOME_NOT_FOUND,
    9: Fault.HOME_NOT_FOUND,
}
GRBL = Dialect("Grbl", _ALARMS)
GRBL_HAL = Dialect(
    "grblHAL",
    {**_ALARMS, 10: Fault.EMERGENCY_STOP, 12: Fault.LIMIT, 15: Fault.HOME_NOT_FOUND, 18: Fault.HOME_NOT_FOUND},
    unhomed=frozenset({11}),
)
FLUID_NC = Dialect(
    "FluidNC",
    {**_ALARMS, 11: Fault.EMERGENCY_STOP, 12: Fault.LIMIT, 13: Fault.LIMIT},
    unhomed=frozenset({14, 15}),
    listed=False,
)
_KNOWN = ((re.compile("fluidnc", re.IGNORECASE), FLUID_NC), (re.compile("grblhal", re.IGNORECASE), GRBL_HAL))
_OLD = re.compile(r"<[A-Z][a-z]+,[MW]Pos:.*")
_OTHERS = (
    (re.compile(r"echo:|Marlin|start$"), "the firmware of a printer (Marlin or its like), which does not speak GRBL"),
    (re.compile(r"\{.*\}$"), "a board that speaks JSON (TinyG, g2core), which is not GRBL"),
    (re.compile(r"Smoothie|Build version:"), "Smoothieware; it speaks GRBL only with grbl_mode true"),
)


def dialect_of(greeting: str) -> Dialect:
    """The dialect of a board, by its first line after a reset; GRBL's own where it names none."""
    return next((dialect for sign, dialect in _KNOWN if sign.search(greeting)), GRBL)


def is_old(greeting: str, answer: str = "") -> bool:
    """Whether greeting or report are those of GRBL before 1.0, which reports in another form."""
    return bool(re.match(r"Grbl 0\.", greeting) or _OLD.fullmatch(answer))


def other_device(line: str) -> str:
    """What else sends such a line, in words; empty where nobody knows."""
    return next((f", {words}" for sign, words in _OTHERS if sign.search(line)), "")
