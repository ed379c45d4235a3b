"""The answers of every controller: firmware, state, counters."""

from dataclasses import dataclass, field
from typing import Literal

from scanrig.errors import Fault


State = Literal["idle", "move", "home", "shot", "fault"]


@dataclass(frozen=True)
class Firmware:
    """The firmware that answered."""

    proto: int | str
    """Number or name of its protocol."""
    version: str
    boot: int
    """Counts resets: when it changes, position and settings are lost."""
    lease_ms: int = 0
    """Longest time for which the laser stays on without a command from the host; 0: no limit."""


@dataclass(frozen=True)
class Status:
    """The present state."""

    state: State
    fault: Fault | None
    """The fault that it is in, or None."""
    position: int
    """Microsteps from home."""
    homed: bool
    armed: bool
    """Whether the laser may be switched on: the contactor in its supply is closed, if there is one."""
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
    """A controller's counters of errors and wear."""

    damaged: int
    """Lines that arrived damaged at the controller."""
    overruns: int
    """Bytes that the controller lost."""
    repeated: int
    """Lines that arrived again and were answered but not carried out again."""
    laser_cycles: int
    """Times that the laser was switched on since boot."""
    up_ms: int
    watchdog_resets: int
    """Resets by the processor's watchdog since it was programmed."""


@dataclass(frozen=True)
class ShotDone:
    """A finished shot."""

    position: int
    """Microsteps from home, as reached."""
    exposures: int
    """Exposures since boot, modulo 65536: must have grown by the number of frames asked for."""


@dataclass(frozen=True)
class Reconnection:
    """How the controller was found again."""

    same_boot: bool
    """It was not reset: its position is still valid."""
    must_home: bool
    status: Status


@dataclass
class LinkCounts:
    """Counts of the lines sent to and received from the controller."""

    sent: int = 0
    """Lines sent, including resent ones."""
    resent: int = 0
    naks: int = 0
    damaged: int = 0
    """Lines that arrived damaged at the host."""
    strays: int = 0
    """Unexpected answers: second answers to lines that were resent."""
    events: int = 0
    events_missed: int = 0
    events_by_name: dict[str, int] = field(default_factory=dict)
    unanswered: int = 0
    """Waits for an answer that came to nothing, and failures of the port, since a line was heard last."""
