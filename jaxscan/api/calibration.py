"""Captures to a calibration: look at the boards, solve, say where it came from."""

from collections.abc import Sequence
from dataclasses import replace
from importlib import metadata

from jaxscan.api.boards import Progress, find_boards, to_observations
from jaxscan.api.redetect import choose, look_again
from jaxscan.calibration import Calibration, CalibrationSettings, calibrate_camera, calibrate_observations
from jaxscan.errors import CalibrationError, CaptureError
from jaxscan.files.capture import Capture


def calibrate(
    captures: Capture | Sequence[Capture],
    *,
    settings: CalibrationSettings | None = None,
    only_camera: bool = False,
    redetect: bool = True,
    progress: Progress | None = None,
) -> Calibration:
    """Calibrate a rig from captures of a board: corners, stripes, one joint least squares.

    Args:
        captures: Calibration captures of the same board, camera and rig.
        settings: Of the solve.
        only_camera: Intrinsics alone; lasers and turntable are left out of the result.
        redetect: Look at the images a second time, where the first solve says that corners and
            stripes are, and solve again; `quality.redetected` says how much it gained.
        progress: Called with (records done, records in all), over both looks.

    Returns:
        The calibration, with its covariance, quality and observations.

    Raises:
        CaptureError: If a capture is not a calibration capture, or they do not belong together.
        CalibrationError: If something cannot be determined; the message says what to capture.
    """
    captures = [captures] if isinstance(captures, Capture) else list(captures)
    if not captures:
        raise CaptureError("No capture was given; a calibration needs at least one capture of a board.")
    if not only_camera and not captures[0].lines:
        raise CalibrationError(
            f"{captures[0].path}: lists no [[laser]], so there is no laser plane to be found: capture the board with "
            "the laser on and off, or calibrate the camera alone (`--only camera`, `only_camera=True`)."
        )
    settings = settings or CalibrationSettings()
    solve = calibrate_camera if only_camera else calibrate_observations
    looks, stripes = 2 if redetect else 1, not only_camera
    views = find_boards(captures, with_stripes=stripes, progress=_part(progress, 0, looks))
    # The first of two looks is there to know where to look; only the last is judged.
    first = replace(settings, judge=settings.judge and not redetect)
    result = solve(to_observations(views, captures), settings=first)
    # A solve that did not converge cannot say where to look.
    if redetect and result.quality.converged:
        again = look_again(captures, views, result, stripes=stripes, progress=_part(progress, 1, looks))
        result, gains = choose(result, solve(to_observations(again, captures), settings=settings))
        if not gains.kept:
            result = solve(to_observations(views, captures), settings=settings)
        result = replace(result, quality=replace(result.quality, redetected=gains))
    provenance = {
        **result.provenance,
        "captures": [{"name": capture.path.name, "digest": capture.digest()} for capture in captures],
        "versions": {name: metadata.version(name) for name in ("jaxscan", "jax", "optimistix", "numpy")},
    }
    return replace(result, provenance=provenance)


def _part(progress: Progress | None, look: int, looks: int) -> Progress | None:
    """Progress of one of several looks at the same records."""
    return None if progress is None else lambda done, total: progress(look * total + done, looks * total)
