"""What any controller says of itself: firmware, state, counters."""

from dataclasses import dataclass, field
from typing import Literal

from scanrig.errors import Fault


State = Literal["idle", "move", "home", "shot", "fault"]


@dataclass(frozen=True)
class Firmware:
    """Who answered."""

    proto: int | str
    """The protocol that it speaks: its number, or its name."""
    version: str
    boot: int
    """Counts resets: where it changed, position and settings are gone."""
    lease_ms: int = 0
    """The longest time for which the laser stays on without a word from the host; 0: for ever."""


@dataclass(frozen=True)
class Status:
    """The state at this moment."""

    state: State
    fault: Fault | None
    """Which fault it is in."""
    position: int
    """Microsteps from home."""
    homed: bool
    armed: bool
    """Whether the laser may be switched on: the contactor in its supply is closed, where there is one."""
    enabled: bool
    """Whether the motor driver is on."""
    laser: bool
    exposures: int = 0
    """Trigger pulses since boot, modulo 65536."""
    home_switch: bool = False
    """Whether the home switch is active."""
    estop: bool = False
    """Whether the emergency stop is pressed."""


@dataclass(frozen=True)
class Counters:
    """What a controller counts: errors and wear."""

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
