"""Settings as fields of the protocol."""

from scanrig.controllers.settings import Settings


UNLIMITED = (-(2**31), 2**31 - 1)
"""Soft limits that allow every position."""


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
