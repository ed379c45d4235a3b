"""Whether a stored calibration can be refined by sweeps."""

import numpy as np

from jaxscan.calibration import Calibration
from jaxscan.errors import CalibrationError
from jaxscan.geometry import Scanner, Turntable


def require_prior(stored: Calibration, name: str = "the calibration") -> Scanner:
    """The scanner of a calibration that can be refined: camera, sheet, table and their covariance.

    Args:
        stored: The calibration.
        name: Its name in messages.

    Raises:
        CalibrationError: With the part that is missing.
    """
    scanner = stored.scanner
    if scanner is None or not scanner.laser_names:
        parts = "a camera alone" if scanner is None else "camera and axis, without a laser sheet"
        raise CalibrationError(
            f"{name}: holds {parts}; sweeps refine a whole rig: calibrate it once with a board and the laser."
        )
    if not isinstance(scanner.turntable, Turntable):
        moves = "a linear stage" if scanner.turntable.carries == "linear" else "a scanner that stands still"
        raise CalibrationError(
            f"{name}: is that of {moves}; only sweeps of a turntable tell more of their rig: calibrate with boards."
        )
    if scanner.turntable.carries != "scanner":
        raise CalibrationError(
            f"{name}: is that of a table that carries the {scanner.turntable.carries}, expected one that turns the "
            "scanner in its room; calibrate with boards."
        )
    if scanner.covariance is None or not np.any(np.diag(np.asarray(scanner.covariance)) > 0):
        raise CalibrationError(
            f"{name}: has no covariance, so nothing holds the two scales that walls leave open; sweeps refine a "
            "calibration that jaxscan calibrate wrote: calibrate once with a board."
        )
    return scanner
