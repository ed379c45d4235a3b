"""Captures of a board to observations, and to a calibration; and a stored calibration solved again."""

import datetime
from collections.abc import Sequence
from dataclasses import replace
from importlib import metadata
from typing import NamedTuple, TypeVar

from jaxscan.api.stages import Stage, Stages, megapixels
from jaxscan.calibration import (
    NOTHING_KNOWN,
    Calibration,
    CalibrationSettings,
    KnownParts,
    Missed,
    Rig,
    calibrate_observations,
    choose,
    estimate,
    judge,
    largest_departure,
    planned_rig,
    settle_lens,
    solved_rig,
    warn_of_missing_lines,
)
from jaxscan.errors import CalibrationError, CaptureError
from jaxscan.files.calibration import stored_settings
from jaxscan.files.capture import Capture, common_board
from jaxscan.observation import Eyes, Observations, Progress, look_again, look_at_boards, to_observations
from jaxscan.recalibration import RecalibrationSettings


_Settings = TypeVar("_Settings", CalibrationSettings, RecalibrationSettings)


def observe_boards(
    captures: Sequence[Capture], *, with_stripes: bool = True, progress: Progress | None = None
) -> Observations:
    """Find the board's corners, and the stripes on it, in calibration captures.

    Corners are looked for in the laser-off image where there is one. Views with the same
    placement share a board pose; a view without a table angle is a placement of its own.

    Args:
        captures: Calibration captures of the same board, camera and rig.
        with_stripes: Look for stripes too; they are not needed for a camera alone.
        progress: Called with (records done, records in all).

    Returns:
        The observations that `calibrate` solves from.

    Raises:
        CaptureError: If a capture is not a calibration capture, or they do not belong together.
        CalibrationError: If the board is found in no image.
    """
    board = common_board(captures, single_lasers=with_stripes)
    seen = look_at_boards(captures, board, _eyes(), with_stripes=with_stripes, progress=progress)
    return to_observations(captures, seen)


def plan_calibration(
    captures: Sequence[Capture], *, settings: CalibrationSettings | None = None, known: KnownParts = NOTHING_KNOWN
) -> Rig:
    """The rig that `calibrate` will solve, by header and journal alone; no image is read.

    Args:
        captures: Calibration captures of the same board, camera and rig.
        settings: Settings of the solve.
        known: Parts that need not be determined.

    Raises:
        CaptureError: If there is no capture, or one is not a calibration capture.
        CalibrationError: If not even the camera can be determined.
    """
    if not captures:
        raise CaptureError("No capture was given; a calibration needs at least one capture of a board.")
    common_board(captures, single_lasers=False)
    return planned_rig(captures, (settings or CalibrationSettings()).only, known)


def calibrate(
    captures: Capture | Sequence[Capture],
    *,
    settings: CalibrationSettings | None = None,
    known: KnownParts = NOTHING_KNOWN,
    only_camera: bool = False,
    redetect: bool = True,
    progress: Progress | None = None,
) -> Calibration:
    """Calibrate a rig from captures of a board: corners, stripes, one joint least squares.

    The largest rig is solved that the captures determine; `missing` of the calibration says why not more.

    Args:
        captures: Calibration captures of the same board, camera and rig.
        settings: Settings of the solve. Where they do not say how well the motion stops, the headers may.
        known: Parts that are held, or refined.
        only_camera: Calibrate the camera alone, as with `only="camera"` in the settings.
        redetect: Look for corners and stripes again at the places that the first solve predicts,
            and solve again; `quality.redetected` holds the gain.
        progress: Called with (work done, work in all). If it has a method `doing`, that receives the current stage in
            words.

    Returns:
        The calibration, with its covariance, quality and observations.

    Raises:
        CaptureError: If a capture is not a calibration capture, or they do not belong together.
        CalibrationError: If not even the camera can be determined; the message names the missing images.
    """
    captures = [captures] if isinstance(captures, Capture) else list(captures)
    settings = settings or CalibrationSettings()
    settings = replace(settings, only="camera") if only_camera else settings
    stripes = bool(plan_calibration(captures, settings=settings, known=known).lasers)
    settings = with_stops(settings, captures)
    board, eyes = common_board(captures, single_lasers=stripes), _eyes()
    pixels = sum(megapixels(*capture.image_size, len(capture)) for capture in captures)
    # Measured with 50 pairs of 640 x 512 px on one processor; solving hardly depends on the size of images.
    again = (Stage(0.5, 0.12 * pixels), Stage(3.0)) if redetect else (Stage(0.0), Stage(5.0))
    stages = Stages(progress, (Stage(2.3, 0.14 * pixels), Stage(5.3 if redetect else 0.0), *again))
    if (begin := stages.part(0)) is not None:
        begin(0, 1)
    doing = getattr(progress, "doing", lambda words: None)
    doing("finding corners and stripes" if stripes else "finding corners")
    seen = look_at_boards(captures, board, eyes, with_stripes=stripes, progress=stages.part(0))
    doing("solving")
    found = estimate(to_observations(captures, seen), settings=settings, known=known)
    stages.done(1)
    predicted, gains = solved_rig(found) if redetect else None, None
    if predicted is not None:
        doing("looking again at predicted places")
        looked = look_again(captures, seen, predicted, eyes, progress=stages.part(2))
        doing("solving again")
        second = estimate(to_observations(captures, looked), settings=settings, known=known, before=found)
        found, gains = choose(found, second)
        seen = looked if gains.kept else seen
    doing("judging")
    result = judge(found, settings=settings, known=known)
    result = settle_lens(result, settings, to_observations(captures, seen), known)
    stages.done(3)
    missed, rig = tuple(Missed(*record) for record in seen.missed()), solved_rig(found)
    without = () if rig is None else warn_of_missing_lines(*seen.without_a_line(rig))
    warnings = (*result.quality.warnings, *without, *seen.doubts(captures))
    quality = replace(result.quality, redetected=gains, records=len(seen.records), missed=missed, warnings=warnings)
    provenance = {
        **result.provenance,
        "captures": [{"name": capture.path.name, "digest": capture.digest()} for capture in captures],
        "versions": versions(),
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }
    return replace(result, quality=quality, provenance=provenance)


def with_stops(settings: _Settings, captures: Sequence[Capture]) -> _Settings:
    """Settings of a calibration or a recalibration; where they do not say how well table or stage stops, the first
    header that does."""
    if settings.angle_sigma is not None:
        return settings
    return replace(settings, angle_sigma=next((one.stop_sigma for one in captures if one.stop_sigma is not None), None))


def versions() -> dict[str, str]:
    """The versions of all that a solve depends on."""
    return {name: metadata.version(name) for name in ("jaxscan", "jax", "optimistix", "numpy")}


def _eyes() -> Eyes:
    # Imported here, so that `import jaxscan` does not load OpenCV.
    from jaxscan.vision import draw_print, find_corners, name_other_board, refit_corners, to_grey

    return Eyes(to_grey, find_corners, refit_corners, draw_print, name_other_board)


REPRODUCED = 0.01
"""Largest departure [standard deviations] of a parameter that counts as the same: far more than rounding and the
stopping of a solver leave, and far less than matters."""


class Again(NamedTuple):
    """A stored calibration and a new solve of its observations."""

    calibration: Calibration
    """The new calibration, with its `fit`; captures and versions are those of the stored one."""
    departure: float
    """Departure of the parameter that moved most, in its standard deviations [1]; infinite if a held one changed."""
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
        name: Name of the calibration in messages.

    Raises:
        CalibrationError: If there are no observations, the settings cannot be meant, or the solve fails.
    """
    if stored.observations is None:
        raise CalibrationError(
            f"{name}: has no observations beside it (.npz of the same name), so it cannot be solved."
        )
    # A second solve is also asked whether the models suffice.
    settings = replace(stored_settings(stored.provenance, name=name), judge=True)
    if stored.scanner is None:
        settings = replace(settings, only="camera")
    again = calibrate_observations(stored.observations, settings=settings, known=_held(stored))
    departure, parameter = largest_departure(stored, again)
    # The gain of the second look can only be computed from the images.
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
