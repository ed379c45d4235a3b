"""Reads answers: firmware, state and counters from their fields, faults and refusals from their numbers."""

import re
from collections.abc import Mapping

from scanrig.controllers.status import Counters, Firmware, State, Status
from scanrig.errors import Fault, FirmwareError, Reason


FAULTS = {
    1: Fault.EMERGENCY_STOP,
    2: Fault.LINK_LOST,
    3: Fault.LEASE_RAN_OUT,
    4: Fault.HOME_NOT_FOUND,
    5: Fault.ABORTED,
    6: Fault.CAMERA_NOT_READY,
}
"""The firmware's fault numbers (PROTOCOL.md, section 4)."""

REFUSALS = {
    1: Reason.NOT_UNDERSTOOD,
    2: Reason.DAMAGED,
    3: Reason.UNKNOWN_COMMAND,
    4: Reason.BAD_ARGUMENT,
    5: Reason.BUSY,
    6: Reason.IN_FAULT,
    8: Reason.NOT_HOMED,
    9: Reason.NO_SESSION,
    10: Reason.TOO_LONG,
    11: Reason.DRIVER_OFF,
    13: Reason.BEYOND_LIMIT,
    14: Reason.NOT_ARMED,
}
"""The firmware's refusal numbers (PROTOCOL.md, section 4)."""

_INTEGER = re.compile(r"-?[0-9]{1,10}")
"""The firmware's integers have 32 bits."""

STATES: dict[str, State] = {"idle": "idle", "move": "move", "home": "home", "shot": "shot", "fault": "fault"}


def read_fault(number: int) -> Fault:
    """A fault by its number."""
    return FAULTS.get(number, Fault.UNKNOWN)


def read_refusal(number: int, verb: str) -> Reason:
    """The reason for a refusal, by its number and the refused verb."""
    if number == 6 and verb == "CLEAR":
        return Reason.STILL_PRESSED
    return REFUSALS.get(number, Reason.UNKNOWN)


def read_firmware(fields: Mapping[str, str]) -> Firmware:
    """Firmware from the fields of HELLO's answer."""
    version = fields.get("fw", "unknown")
    return Firmware(integer(fields, "proto"), version, integer(fields, "boot"), integer(fields, "lease"))


def read_status(fields: Mapping[str, str]) -> Status:
    """Status from the fields of STAT's answer."""
    inputs = integer(fields, "in")
    return Status(
        state=read_state(word(fields, "st")),
        fault=read_fault(number) if (number := integer(fields, "f")) else None,
        position=integer(fields, "pos"),
        homed=bool(integer(fields, "hm")),
        armed=bool(integer(fields, "arm")),
        enabled=bool(integer(fields, "en")),
        laser=bool(integer(fields, "las")),
        exposures=integer(fields, "trg"),
        home_switch=bool(inputs & 1),
        estop=bool(inputs & 2),
    )


def read_state(name: str) -> State:
    """A state by its name."""
    if name not in STATES:
        raise FirmwareError(f"the controller says st={name:.20}, expected one of {', '.join(STATES)}")
    return STATES[name]


def read_counters(fields: Mapping[str, str]) -> Counters:
    """Counters from the fields of CNT's answer."""
    return Counters(*(integer(fields, key) for key in ("crc", "over", "dup", "las", "up", "wdr")))


def word(fields: Mapping[str, str], key: str) -> str:
    """A field that must be there."""
    if key not in fields:
        raise FirmwareError(
            f"the controller's answer {dict(fields)} lacks '{key}'; its firmware does not fit this host"
        )
    return fields[key]


def integer(fields: Mapping[str, str], key: str) -> int:
    """A field that must be there and be an integer."""
    text = word(fields, key)
    if _INTEGER.fullmatch(text) is None:
        raise FirmwareError(
            f"the controller says {key}={text:.20}, expected an integer; its firmware does not fit this host"
        )
    return int(text)
