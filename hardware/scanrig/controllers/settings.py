"""The settings of a controller for a session."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """Motion, waits and limits, in microsteps and milliseconds; a controller ignores those that it does not have."""

    watchdog_ms: int = 500
    """Milliseconds without a valid line after which the controller treats the link as lost."""
    speed: int = 4000
    """Microsteps per second."""
    start_speed: int = 400
    """Microsteps per second at the beginning of a ramp."""
    acceleration: int = 8000
    """Microsteps per second squared."""
    home_speed: int = 200
    """Microsteps per second of the slow approach to the home switch."""
    backlash: int = 0
    """Microsteps by which a downward motion overshoots, so that every target is approached from below."""
    reverse: bool = False
    """Inverts the direction pin."""
    lasers: int = 1
    """How many lasers the controller has to switch."""
    settle_ms: int = 50
    """Rest before a shot."""
    laser_on_ms: int = 20
    """From laser on to exposure."""
    laser_off_ms: int = 20
    """From laser off to exposure."""
    exposure_ms: int = 10
    """Trigger pulse."""
    gap_ms: int = 5
    """After each exposure."""
    ready_ms: int = 0
    """Longest wait for the camera's ready line before each trigger; 0: no wait."""
    limits: tuple[int, int] | None = None
    """Soft limits, microsteps from home; None: none."""
