"""Another model of the lens, where the one that was chosen falls short."""

import contextlib
from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np

from jaxscan.calibration.advice import refusal
from jaxscan.calibration.calibrate import calibrate_observations
from jaxscan.calibration.propagate import image_places
from jaxscan.calibration.result import Calibration, GoodTo, Verdict, is_named
from jaxscan.calibration.rigs import KnownParts
from jaxscan.calibration.settings import CalibrationSettings
from jaxscan.errors import CalibrationError
from jaxscan.geometry import CAMERAS, AbstractCamera, exponential
from jaxscan.observation import Observations


# Other models take their time, and are tried where the lens is a cause worth a word, and the residuals of corners are
# this many times as large as the detector promised.
_NOISY = 2.0
# Another model is advised where it brings the residuals to this share, and taken where to this one.
_BETTER, _FAR_BETTER = 0.7, 0.5
# Among models whose residuals agree up to this factor, the one with the fewest parameters goes least astray.
_ALIKE = 1.1
# More of the corners than this may not go for it.
_MORE_REJECTED = 0.02
_ROTATION_ROUNDS = 10
_LENS_TESTS = ("lens", "regions")


class OtherLens(NamedTuple):
    """The model that explains the corners better, and how much."""

    settings: CalibrationSettings
    option: str
    """The option of the command line that chooses the model."""
    rms_px: float
    """Root mean square residual of the corners with it."""
    before_px: float
    off_px: float
    """How far rays of the chosen model are from its rays, root mean square over the image after the best rotation."""

    @property
    def far_better(self) -> bool:
        """Whether it should be taken rather than advised."""
        return self.rms_px < _FAR_BETTER * self.before_px

    def gain(self) -> str:
        """What it does to the residuals."""
        return f"brings the residuals of the corners from {self.before_px:.2g} to {self.rms_px:.2g} px"

    def said(self) -> str:
        """Why it was taken."""
        return (
            f"the lens was solved as `{self.option}`, which {self.gain()}; without it rays are {self.off_px:.3g} px "
            "off over the image"
        )


def find_better_lens(calibration: Calibration, settings: CalibrationSettings) -> OtherLens | None:
    """The model of the lens that explains the corners best, tried where the calibration's own falls short.

    Only the camera is solved again, from the same corners.

    Returns:
        None where the lens suffices, or no other is better.
    """
    quality, before = calibration.quality, calibration.quality.corner_rms_px
    verdict = quality.verdict
    if verdict is None or verdict.good_to is None or calibration.observations is None or not before:
        return None
    effects = [test.effect_px or 0.0 for test in verdict.tests if test.name in _LENS_TESTS]
    fails = any(is_named(effect, verdict.good_to.sigma_px or 0.0) for effect in effects)
    if not fails or (quality.corner_rms_whitened or 0.0) < _NOISY:
        return None
    rational = () if "rational" in settings.free else ("rational",)
    tried = [(name, f"--lens {name}", settings.free) for name in CAMERAS if name != settings.camera]
    tried += [("pinhole", "--free rational", (*settings.free, *rational))] if settings.camera == "pinhole" else []
    found = []
    for name, option, free in tried:
        other = _solved(calibration, replace(settings, camera=name, free=free, only="camera", judge=False))
        if other is not None and (other.quality.corner_rms_px or np.inf) < _BETTER * before:
            found.append((other.quality.corner_rms_px or 0.0, option, name, free, other.camera))
    if not found:
        return None
    best = min(rms_px for rms_px, *_ in found)
    alike = [one for one in found if one[0] <= _ALIKE * best]
    rms_px, option, name, free, camera = min(alike, key=lambda one: (len(one[-1].parameter_names()), one[0]))
    off_px = ray_difference(camera, calibration.camera)
    return OtherLens(replace(settings, camera=name, free=free), option, rms_px, before, off_px)


def settle_lens(
    calibration: Calibration, settings: CalibrationSettings, observations: Observations, known: KnownParts
) -> Calibration:
    """The calibration with the model of the lens that explains the corners, where that is better by far.

    Args:
        calibration: Judged, with its observations.
        settings: It was solved with these; `choose_lens` False, or a camera that is known, leaves it at advice.
        observations: From which it was solved, before any was left out.
        known: Parts that were held or refined.

    Returns:
        It, solved with the other model and a warning that says so first; or with advice, and with its own rays as far
        off as the other model shows them.
    """
    other = find_better_lens(calibration, settings)
    if other is None:
        return calibration
    if other.far_better and settings.choose_lens and known.camera is None:
        # The camera alone was solved so; the whole may still not be.
        with contextlib.suppress(CalibrationError):
            found = calibrate_observations(observations, settings=other.settings, known=known)
            if found.quality.converged:
                warnings = (other.said(), *found.quality.warnings)
                quality = replace(found.quality, warnings=warnings, redetected=calibration.quality.redetected)
                return replace(found, quality=quality)
    return advise_lens(calibration, other)


def advise_lens(calibration: Calibration, other: OtherLens) -> Calibration:
    """The calibration whose verdict knows of a better lens: advised first, and its own rays as far off as they are."""
    verdict = calibration.quality.verdict
    if verdict is None or verdict.good_to is None:
        return calibration
    line = f"`{other.option}` {other.gain()}"
    verdict = _with_error(replace(verdict, advice=(line, *verdict.advice)), other.off_px)
    sheets = calibration.scanner is not None and bool(calibration.scanner.laser_names)
    refused = verdict.refused or refusal(
        verdict.good_to or GoodTo(), calibration.camera, other.settings, has_sheets=sheets
    )
    if refused is not None and other.far_better:
        refused = f"the model of the lens is wrong, {line}"
    verdict = replace(verdict, usable=refused is None, refused=refused)
    return replace(calibration, quality=replace(calibration.quality, verdict=verdict))


def ray_difference(camera: AbstractCamera, other: AbstractCamera) -> float:
    """Root mean square distance of the rays of two cameras after the best rotation, where the first has light [px]."""
    camera, other = (jax.tree.map(np.asarray, one) for one in (camera, other))
    q, there = image_places(camera)
    ray = np.asarray(other.unproject(q))
    there, ray, q = (part[np.isfinite(there).all(1) & np.isfinite(ray).all(1)] for part in (there, ray, q))
    for _ in range(_ROTATION_ROUNDS):
        # Turns of rays by which they come nearest, one small turn after the other.
        turns = np.stack([np.cross(axis, ray) for axis in np.eye(3)], -1).reshape(-1, 3)
        turn = np.linalg.lstsq(turns, (there - ray).ravel(), rcond=None)[0]
        ray = ray @ np.asarray(exponential(np.concatenate([np.zeros(3), turn])))[:3, :3].T
    off = np.linalg.norm(np.asarray(camera.project(ray)) - q, axis=1)
    return float(np.sqrt(np.mean(np.square(off[np.isfinite(off)]))))


def _with_error(verdict: Verdict, off_px: float) -> Verdict:
    """The verdict with the error of the lens as another model shows it, where it is larger than was thought."""
    good_to, of_lens = verdict.good_to or GoodTo(), [test for test in verdict.tests if test.name in _LENS_TESTS]
    known = [
        float(np.linalg.norm([getattr(test, key) or 0.0 for test in of_lens])) for key in ("effect_px", "effect_mm")
    ]
    if not 0 < known[0] < off_px:
        return verdict
    # Millimetres grow with the pixels that cause them.
    grown = off_px / known[0]
    larger = lambda value: None if value is None else value * grown
    tests = tuple(
        replace(test, effect_px=larger(test.effect_px), effect_mm=larger(test.effect_mm))
        if test.name in _LENS_TESTS
        else test
        for test in verdict.tests
    )
    whole = [
        None if value is None else float(np.sqrt(value**2 + (grown**2 - 1.0) * part**2))
        for value, part in zip((good_to.sigma_px, good_to.sigma_mm), known, strict=True)
    ]
    return replace(verdict, tests=tests, good_to=replace(good_to, sigma_px=whole[0], sigma_mm=whole[1]))


def _solved(calibration: Calibration, settings: CalibrationSettings) -> Calibration | None:
    """The camera alone, solved from the same corners; None where its model does not suit."""
    if calibration.observations is None:
        return None
    try:
        other = calibrate_observations(calibration.observations, settings=settings)
    except CalibrationError:
        # A model that these corners do not determine is no cure.
        return None
    before, after = calibration.quality.corners_rejected or 0, other.quality.corners_rejected or 0
    suits = other.quality.converged and after - before <= _MORE_REJECTED * (other.quality.corners or 0)
    return other if suits else None
