"""A stored calibration, solved again from its own observations."""

from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np

from jaxscan.calibration import Calibration, calibrate_camera, calibrate_observations
from jaxscan.errors import CalibrationError
from jaxscan.files.calibration import stored_settings
from jaxscan.geometry import Scanner


REPRODUCED = 0.01
"""Largest departure [standard deviations] of a parameter that counts as the same: far more than rounding and the
stopping of a solver leave, and far less than matters."""
_HELD = 1e-6


class Again(NamedTuple):
    """A stored calibration and a new solve of its observations."""

    calibration: Calibration
    """With `fit`; captures and versions are those of the stored one."""
    departure: float
    """Of the parameter that moved most, in its standard deviations [1]; infinite for a change of what was held."""
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
        name: What messages call it.

    Raises:
        CalibrationError: If there are no observations, the settings cannot be meant, or the solve fails.
    """
    if stored.observations is None:
        raise CalibrationError(
            f"{name}: has no observations beside it (.npz of the same name), so it cannot be solved."
        )
    # Whoever asks again wants to know whether the models suffice.
    settings = replace(stored_settings(stored.provenance, name=name), judge=True)
    solve = calibrate_camera if stored.scanner is None else calibrate_observations
    again = solve(stored.observations, settings=settings)
    departure, parameter = _departure(stored, again)
    # Only the images could tell again how much their second look gained.
    quality = replace(again.quality, redetected=stored.quality.redetected)
    return Again(replace(again, provenance=stored.provenance, quality=quality), departure, parameter)


def _departure(stored: Calibration, again: Calibration) -> tuple[float, str]:
    if stored.order != again.order or type(stored.camera) is not type(again.camera):
        return np.inf, "the set of parameters"
    change = _camera(again) - _camera(stored)
    if stored.scanner is not None and again.scanner is not None:
        change = np.concatenate([change, _rig(stored.scanner, again.scanner)])
    sigma = np.sqrt(np.maximum(np.diag(again.covariance), 0.0))
    size = np.where(sigma > 0, np.abs(change) / np.where(sigma > 0, sigma, 1.0), 0.0)
    size = np.where((sigma == 0) & (np.abs(change) > _HELD), np.inf, size)
    worst = int(np.argmax(size))
    return float(size[worst]), again.order[worst]


def _camera(calibration: Calibration) -> np.ndarray:
    with jax.enable_x64(True):
        return np.asarray(calibration.camera.parameters())


def _rig(stored: Scanner, again: Scanner) -> np.ndarray:
    """What lasers and table changed, in the minimal coordinates of the stored ones."""
    parts = []
    for index in range(len(stored.laser_names)):
        before, after = stored.laser(index), again.laser(index)
        parts += [before.basis @ (after.normal - before.normal), [after.distance - before.distance]]
        parts += [after.bow - before.bow]
    table, turned = stored.turntable, again.turntable
    parts += [table.basis @ (turned.direction - table.direction), table.basis @ (turned.point - table.point)]
    parts += [[turned.gain - table.gain], turned.harmonics - table.harmonics]
    return np.concatenate([np.asarray(part, np.float64) for part in parts])
