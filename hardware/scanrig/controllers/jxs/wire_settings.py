"""The settings as the wire has them."""

from scanrig.controllers.settings import Settings


UNLIMITED = (-(2**31), 2**31 - 1)
"""Soft limits that limit nothing."""


def wire_settings(settings: Settings) -> dict[str, dict[str, int]]:
    """The settings as the wire has them, in groups that fit one line each and are checked together there."""
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
