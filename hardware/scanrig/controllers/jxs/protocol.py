"""Bytes to messages and back, on the host's side (PROTOCOL.md, section 1), and fields to names.

Nothing here waits or knows a session."""

import binascii
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import get_args

from scanrig.controllers.controller import Counters, Firmware, Settings, State, Status
from scanrig.errors import Fault, FirmwareError, Reason


PROTOCOL = 1

ABORT = b"\x1b"
"""Esc, which works outside of lines: laser off and motor stopped at once. No single flipped bit turns a byte of a line
into it."""

LONGEST_COMMAND = 96

LONGEST_LINE = 127

LAST_SEQUENCE = 65535


@dataclass(frozen=True)
class Reply:
    """The answer to a command that was carried out, with its fields."""

    seq: int
    fields: dict[str, str]


@dataclass(frozen=True)
class Refusal:
    """The answer to a command that arrived intact and was not carried out."""

    seq: int
    code: int


@dataclass(frozen=True)
class Nak:
    """A line of the host arrived damaged (2) or too long (10) and must be sent again; its number is not known."""

    code: int


@dataclass(frozen=True)
class Event:
    """An event at the controller, sent once."""

    number: int
    name: str
    fields: dict[str, str]


@dataclass(frozen=True)
class Damaged:
    """A line that is not of this protocol, or was damaged on its way."""

    raw: bytes


Message = Reply | Refusal | Nak | Event | Damaged

_SEQ = rb"(0|[1-9][0-9]{0,4})"
_FIELDS = rb"((?: [a-z]+=[!-)+-<>-~]+)*)"
_REPLY = re.compile(rb"=" + _SEQ + rb" ok" + _FIELDS)
_REFUSAL = re.compile(rb"=" + _SEQ + rb" err ([1-9][0-9]?)")
_NAK = re.compile(rb"=\? err ([1-9][0-9]?)")
_EVENT = re.compile(rb"!" + _SEQ + rb" ([A-Z]+)" + _FIELDS)
_SEALED = re.compile(rb"([ -~]*)\*([0-9A-F]{4})")


def crc(data: bytes) -> int:
    """CRC-16/CCITT-FALSE: polynomial 0x1021, initial value 0xFFFF, no reflection; for "123456789" it is 0x29B1."""
    return binascii.crc_hqx(data, 0xFFFF)


def seal(text: str) -> bytes:
    """A line's text with its CRC and newline, as bytes."""
    body = text.encode("ascii")
    return b"%s*%04X\n" % (body, crc(body))


def command_text(verb: str, **args: int) -> str:
    """A command as readable text: `SHOT to=1200 id=150`. ValueError beyond 32 bits."""
    for key, value in args.items():
        if not -(2**31) <= value < 2**31:
            raise ValueError(f"{key}={value}: beyond 32 bits")
    return " ".join([verb, *(f"{key}={int(value)}" for key, value in args.items())])


def encode(seq: int, verb: str, **args: int) -> bytes:
    """A command as the bytes of its line, with CRC and newline; ValueError if it is no valid line of the protocol.

    Args:
        seq: 1 … 65535.
        args: 32 bits signed; True and False count as 1 and 0.
    """
    if not 1 <= seq <= LAST_SEQUENCE:
        raise ValueError(f"sequence number {seq}: 1 … {LAST_SEQUENCE}")
    line = seal(f"@{seq} {command_text(verb, **args)}")
    if len(line) - 1 > LONGEST_COMMAND:
        raise ValueError(f"{len(line) - 1} bytes, at most {LONGEST_COMMAND}: {line!r}")
    return line


class LineReader:
    """Joins the pieces that the port returns to the controller's lines."""

    def __init__(self) -> None:
        self._pending = b""

    def feed(self, data: bytes) -> list[Message]:
        """The messages that `data` completes, in order. Never raises, whatever arrives.

        The result does not depend on how the stream is cut into pieces.
        """
        *lines, pending = (self._pending + data.replace(b"\r", b"")).split(b"\n")
        # An endless line must not fill the memory: one byte more than the longest line is enough to reject it.
        self._pending = pending[: LONGEST_LINE + 1]
        return [decode(line[: LONGEST_LINE + 1]) for line in lines if line]


def decode(line: bytes) -> Message:
    """One line, without its newline, as a message; `Damaged` if it is not exactly a line of the protocol."""
    sealed = _SEALED.fullmatch(line)
    if len(line) > LONGEST_LINE or not sealed or crc(sealed[1]) != int(sealed[2], 16):
        return Damaged(line)
    body = sealed[1]
    if match := _REPLY.fullmatch(body):
        seq, fields = int(match[1]), _fields(match[2])
        return Damaged(line) if fields is None or seq > LAST_SEQUENCE else Reply(seq, fields)
    if match := _EVENT.fullmatch(body):
        number, fields = int(match[1]), _fields(match[3])
        return Damaged(line) if fields is None or number > LAST_SEQUENCE else Event(number, match[2].decode(), fields)
    if match := _REFUSAL.fullmatch(body):
        return Damaged(line) if int(match[1]) > LAST_SEQUENCE else Refusal(int(match[1]), int(match[2]))
    if match := _NAK.fullmatch(body):
        return Nak(int(match[1]))
    return Damaged(line)


def _fields(words: bytes) -> dict[str, str] | None:
    """` a=1 b=2` as a dictionary; None if a key comes twice."""
    pairs = [word.partition("=")[::2] for word in words.decode("ascii").split()]
    fields = dict(pairs)
    return fields if len(fields) == len(pairs) else None


FAULTS = {
    1: Fault.EMERGENCY_STOP,
    2: Fault.LINK_LOST,
    3: Fault.LEASE_RAN_OUT,
    4: Fault.HOME_NOT_FOUND,
    5: Fault.ABORTED,
    6: Fault.CAMERA_NOT_READY,
}

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

_STATES: dict[str, State] = {state: state for state in get_args(State)}


def read_fault(number: int) -> Fault:
    return FAULTS.get(number, Fault.UNKNOWN)


def read_refusal(number: int, verb: str) -> Reason:
    """The reason for a refusal, by its number and the refused verb."""
    if number == 6 and verb == "CLEAR":
        return Reason.STILL_PRESSED
    return REFUSALS.get(number, Reason.UNKNOWN)


def read_firmware(fields: Mapping[str, str]) -> Firmware:
    version = fields.get("fw", "unknown")
    return Firmware(integer(fields, "proto"), version, integer(fields, "boot"), integer(fields, "lease"))


def read_status(fields: Mapping[str, str]) -> Status:
    inputs, state = integer(fields, "in"), word(fields, "st")
    if state not in _STATES:
        raise FirmwareError(f"the controller says st={state:.20}, expected one of {', '.join(_STATES)}")
    return Status(
        state=_STATES[state],
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


def read_counters(fields: Mapping[str, str]) -> Counters:
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


UNLIMITED = (-(2**31), 2**31 - 1)


def wire_settings(settings: Settings) -> dict[str, dict[str, int]]:
    """Settings as fields of the protocol, in groups that fit one line each and that the firmware checks together."""
    low, high = UNLIMITED if settings.limits is None else settings.limits
    return {
        "motion": {
            "wd": settings.watchdog_ms,
            "vmax": settings.speed,
            "vst": settings.start_speed,
            "acc": settings.acceleration,
            "hv": settings.home_speed,
            "back": settings.backlash,
            "dir": int(settings.reverse),
        },
        "shot": {
            "settl": settings.settle_ms,
            "lon": settings.laser_on_ms,
            "loff": settings.laser_off_ms,
            "exp": settings.exposure_ms,
            "gap": settings.gap_ms,
            "rdy": settings.ready_ms,
        },
        "limits": {"smin": low, "smax": high},
    }
