"""The controller's settings, by their full names, and what the wire calls them."""

from dataclasses import dataclass


UNLIMITED = (-(2**31), 2**31 - 1)
"""Soft limits that limit nothing."""


@dataclass(frozen=True)
class Settings:
    """What the host sets after each HELLO (PROTOCOL.md, section 4, has ranges and defaults)."""

    watchdog_ms: int = 500
    """Milliseconds without a good line after which the controller takes the link for lost."""
    speed: int = 4000
    """Microsteps per second."""
    start_speed: int = 400
    """Microsteps per second at which a ramp begins."""
    acceleration: int = 8000
    """Microsteps per second squared."""
    home_speed: int = 200
    """Microsteps per second of the slow approach to the home switch."""
    backlash: int = 0
    """Microsteps by which a downward motion overshoots, so that every target is approached from below."""
    reverse: bool = False
    """Turns the sense of the direction pin round."""
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
    """How long to wait for the camera's ready line before each trigger; 0: not at all."""
    limits: tuple[int, int] | None = None
    """Soft limits, microsteps from home; None: none."""

    def wire(self) -> dict[str, dict[str, int]]:
        """The settings as the wire has them, in groups that fit one line each and are checked together there."""
        low, high = UNLIMITED if self.limits is None else self.limits
        return {
            "motion": {
                "wd": self.watchdog_ms,
                "vmax": self.speed,
                "vst": self.start_speed,
                "acc": self.acceleration,
                "hv": self.home_speed,
                "back": self.backlash,
                "dir": int(self.reverse),
            },
            "shot": {
                "settl": self.settle_ms,
                "lon": self.laser_on_ms,
                "loff": self.laser_off_ms,
                "exp": self.exposure_ms,
                "gap": self.gap_ms,
                "rdy": self.ready_ms,
            },
            "limits": {"smin": low, "smax": high},
        }
