"""How far a repeated solve departs from a stored calibration."""

import jax
import numpy as np

from jaxscan.calibration.result import Calibration
from jaxscan.geometry import Scanner


# A held parameter may change by this much, which is rounding.
_HELD = 1e-6


def largest_departure(stored: Calibration, again: Calibration) -> tuple[float, str]:
    """The parameter that differs most between two solves of the same observations.

    Returns:
        Its difference in standard deviations [1], infinite where a held parameter changed; and its name.
    """
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
    """Change of lasers and motion in the minimal coordinates of the stored ones."""
    parts = []
    for index in range(len(stored.laser_names)):
        before, after = stored.laser(index), again.laser(index)
        parts += [before.basis @ (after.normal - before.normal), [after.distance - before.distance]]
        parts += [after.bow - before.bow]
    parts.append(stored.turntable.departure(again.turntable))
    return np.concatenate([np.asarray(part, np.float64) for part in parts])
