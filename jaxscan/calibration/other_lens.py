"""Advice on another model of the lens, where the one that was chosen falls short."""

from dataclasses import replace

import numpy as np

from jaxscan.calibration.calibrate import calibrate_observations
from jaxscan.calibration.result import Calibration
from jaxscan.calibration.settings import CalibrationSettings
from jaxscan.calibration.verdict import is_named
from jaxscan.errors import CalibrationError
from jaxscan.geometry import CAMERAS


# Other models take their time, and are tried where the lens is a cause worth a word, and the residuals of corners are
# this many times as large as the detector promised.
_NOISY = 2.0
# Another model is advised where it brings the residuals to this share.
_BETTER = 0.7
# More of the corners than this may not go for it.
_MORE_REJECTED = 0.02


def advise_lens(calibration: Calibration, settings: CalibrationSettings) -> Calibration:
    """The calibration, with other lens models tried where its own falls short; the best one is advised.

    Only the camera is solved again, from the same corners.

    Args:
        calibration: Judged, with its observations.
        settings: It was solved with these.
    """
    quality, observations = calibration.quality, calibration.observations
    verdict = quality.verdict
    if verdict is None or verdict.good_to is None or observations is None or not quality.corner_rms_px:
        return calibration
    effects = [test.effect_px or 0.0 for test in verdict.tests if test.name == "lens"]
    fails = any(is_named(effect, verdict.good_to.sigma_px or 0.0) for effect in effects)
    if not fails or (quality.corner_rms_whitened or 0.0) < _NOISY:
        return calibration
    rational = () if "rational" in settings.free else ("rational",)
    tried = [(name, f"--lens {name}", settings.free) for name in CAMERAS if name != settings.camera]
    tried += [("pinhole", "--free rational", (*settings.free, *rational))] if settings.camera == "pinhole" else []
    found: list[tuple[float, str]] = []
    for name, words, free in tried:
        other = replace(settings, camera=name, free=free, only="camera", judge=False)
        rms_px = _residual(calibration, other)
        if rms_px < _BETTER * quality.corner_rms_px:
            found.append((rms_px, words))
    if not found:
        return calibration
    rms_px, words = min(found)
    line = f"`{words}` brings the residuals of the corners from {quality.corner_rms_px:.2g} to {rms_px:.2g} px"
    return replace(calibration, quality=replace(quality, verdict=replace(verdict, advice=(line, *verdict.advice))))


def _residual(calibration: Calibration, settings: CalibrationSettings) -> float:
    """Root mean square residual of the corners with another camera; infinite where it does not suit."""
    if calibration.observations is None:
        return np.inf
    try:
        other = calibrate_observations(calibration.observations, settings=settings).quality
    except CalibrationError:
        # A model that these corners do not determine is no cure.
        return np.inf
    before, after = calibration.quality.corners_rejected or 0, other.corners_rejected or 0
    suits = other.converged and after - before <= _MORE_REJECTED * (other.corners or 0)
    return float(other.corner_rms_px or np.inf) if suits else np.inf
