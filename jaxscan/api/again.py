"""A stored calibration, solved again from its own observations."""

from dataclasses import replace
from typing import NamedTuple

from jaxscan.calibration import Calibration, KnownParts, calibrate_observations, largest_departure
from jaxscan.errors import CalibrationError
from jaxscan.files.calibration import stored_settings


REPRODUCED = 0.01
"""Largest departure [standard deviations] of a parameter that counts as the same: far more than rounding and the
stopping of a solver leave, and far less than matters."""


class Again(NamedTuple):
    """A stored calibration and a new solve of its observations."""

    calibration: Calibration
    """With `fit`; captures and versions are those of the stored one."""
    departure: float
    """Of the parameter that moved most, in its standard deviations [1]; infinite where a held parameter changed."""
    parameter: str
    """Its name."""

    @property
    def reproduced(self) -> bool | None:
        """Whether the stored parameters came out again; None where the new solve did not converge."""
        return self.departure <= REPRODUCED if self.calibration.quality.converged else None


def solve_again(stored: Calibration, *, name: str = "calibration") -> Again:
    """Solve from the observations and with the settings that are stored with a calibration.

    Args:
        stored: As `load_calibration` gives it.
        name: Of the calibration in messages.

    Raises:
        CalibrationError: If there are no observations, the settings cannot be meant, or the solve fails.
    """
    if stored.observations is None:
        raise CalibrationError(
            f"{name}: has no observations beside it (.npz of the same name), so it cannot be solved."
        )
    # Whoever asks again wants to know whether the models suffice.
    settings = replace(stored_settings(stored.provenance, name=name), judge=True)
    if stored.scanner is None:
        settings = replace(settings, only="camera")
    again = calibrate_observations(stored.observations, settings=settings, known=_held(stored))
    departure, parameter = largest_departure(stored, again)
    # Only the images could tell again how much their second look gained.
    quality = replace(again.quality, redetected=stored.quality.redetected)
    return Again(replace(again, provenance=stored.provenance, quality=quality), departure, parameter)


def _held(stored: Calibration) -> KnownParts:
    """The parts that the stored solve did not estimate."""
    held, scanner = stored.provenance.get("held", ()), stored.scanner
    if not isinstance(held, list | tuple):
        return KnownParts()
    return KnownParts(
        camera=stored.camera if "camera" in held else None,
        sheets=tuple(scanner.laser(k) for k in range(len(scanner.laser_names))) if scanner and "sheet" in held else (),
        motion=scanner.turntable if scanner and "axis" in held else None,
    )
