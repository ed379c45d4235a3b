"""What the controller says of itself: firmware, state, counters."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from scanrig.errors import FirmwareError


@dataclass(frozen=True)
class Firmware:
    """The answer to HELLO."""

    proto: int
    """The number of the protocol it speaks."""
    version: str
    boot: int
    """Counts resets: where it changed, position and settings are gone."""
    lease_ms: int
    """The longest time for which the laser can be switched on by hand."""


@dataclass(frozen=True)
class Status:
    """The answer to STAT."""

    state: str
    """idle, move, home, shot or fault."""
    fault: int
    """0: none."""
    position: int
    """Microsteps from home."""
    homed: bool
    armed: bool
    enabled: bool
    laser: bool
    lease_ms: int
    exposures: int
    """Since boot, modulo 65536."""
    home_switch: bool
    estop: bool
    camera_ready: bool
    events: int
    """Number of the last event that the controller sent."""


@dataclass(frozen=True)
class Counters:
    """The answer to CNT."""

    damaged: int
    """Lines that came to the controller damaged."""
    overruns: int
    """Bytes that the controller lost."""
    repeated: int
    """Lines that came again and were answered, not carried out."""
    laser_cycles: int
    """Times the laser was switched on since boot: wear."""
    up_ms: int
    watchdog_resets: int
    """Times the processor hung, ever."""


@dataclass(frozen=True)
class ShotDone:
    """A finished shot."""

    position: int
    """Microsteps from home, as reached."""
    exposures: int
    """Exposures since boot, modulo 65536: must have grown by the frames that were asked for."""


@dataclass(frozen=True)
class Reconnection:
    """How the controller was found again."""

    same_boot: bool
    """It was not reset: its position is the one from before."""
    must_home: bool
    status: Status


@dataclass
class LinkCounts:
    """What the line did to what was sent over it."""

    sent: int = 0
    """Lines, resent ones counted again."""
    resent: int = 0
    naks: int = 0
    damaged: int = 0
    """Lines that came to the host damaged."""
    strays: int = 0
    """Answers that nobody was waiting for: the second ones to lines that were resent."""
    events: int = 0
    events_missed: int = 0
    events_by_name: dict[str, int] = field(default_factory=dict)


def read_firmware(fields: Mapping[str, str]) -> Firmware:
    """Firmware from the fields of HELLO's answer."""
    version = fields.get("fw", "unknown")
    return Firmware(integer(fields, "proto"), version, integer(fields, "boot"), integer(fields, "lease"))


def read_status(fields: Mapping[str, str]) -> Status:
    """Status from the fields of STAT's answer."""
    inputs = integer(fields, "in")
    return Status(
        state=word(fields, "st"),
        fault=integer(fields, "f"),
        position=integer(fields, "pos"),
        homed=bool(integer(fields, "hm")),
        armed=bool(integer(fields, "arm")),
        enabled=bool(integer(fields, "en")),
        laser=bool(integer(fields, "las")),
        lease_ms=integer(fields, "le"),
        exposures=integer(fields, "trg"),
        home_switch=bool(inputs & 1),
        estop=bool(inputs & 2),
        camera_ready=bool(inputs & 4),
        events=integer(fields, "ev"),
    )


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
    try:
        return int(text)
    except ValueError as problem:
        raise FirmwareError(
            f"the controller says {key}={text}, expected an integer; its firmware does not fit this host"
        ) from problem
