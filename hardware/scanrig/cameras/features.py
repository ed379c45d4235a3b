"""Checks that a camera took its settings."""

import math

from scanrig.cameras.frame import Camera, Features
from scanrig.cameras.settings import CameraSettings
from scanrig.errors import CameraError


_EXPOSURE_SHARE = 0.02
_EXPOSURE_S = 50e-6
"""An exposure is a whole number of line times of the sensor, tens of microseconds each."""
_GAIN_DB = 0.2
"""Amplifiers have steps of about a tenth of a decibel."""


def wanted(settings: CameraSettings) -> Features:
    """The features that a camera with these settings must report."""
    return {
        "width": settings.width,
        "height": settings.height,
        "pixel_format": settings.pixel_format,
        "exposure_s": settings.exposure_ms * 1e-3,
        "gain_db": settings.gain_db,
        "trigger": settings.trigger,
    }


def differences(found: Features, expected: Features) -> list[str]:
    """Reported features that differ from the expected ones: "name: found ..., expected ..."."""
    return [
        f"{name}: found {_show(found[name])}, expected {_show(value)}"
        for name, value in expected.items()
        if name in found and not _same(name, found[name], value)
    ]


def require(found: Features, expected: Features, *, name: str) -> None:
    """Check that a camera took its settings.

    Raises:
        CameraError: With all differences, and the remedy.
    """
    if wrong := differences(found, expected):
        raise CameraError(f"{name}: did not take its settings: {'; '.join(wrong)}. Set supported values in [camera].")


def require_same(camera: Camera, expected: Features) -> None:
    """Check that a camera's settings are those of the beginning.

    Raises:
        CameraError: With all differences.
    """
    if wrong := differences(camera.features(), expected):
        raise CameraError(
            f"{camera.identity}: is not set as it was when the capture began: {'; '.join(wrong)}. "
            "Restore these settings, or begin a new capture."
        )


def _same(name: str, found: float | int | str, expected: float | int | str) -> bool:
    if isinstance(found, str) or isinstance(expected, str):
        return found == expected
    if name == "exposure_s":
        return math.isclose(found, expected, rel_tol=_EXPOSURE_SHARE, abs_tol=_EXPOSURE_S)
    if name == "gain_db":
        return math.isclose(found, expected, rel_tol=0.0, abs_tol=_GAIN_DB)
    return math.isclose(found, expected, rel_tol=1e-6)


def _show(value: float | int | str) -> str:
    return f'"{value:.60}"' if isinstance(value, str) else f"{value:g}"
