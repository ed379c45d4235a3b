"""Captures to a calibration: look at the boards, solve, say where it came from."""

from collections.abc import Sequence
from importlib import metadata

from jaxscan.api.boards import Progress, observe_boards
from jaxscan.calibration import Calibration, CalibrationSettings, calibrate_camera, calibrate_observations
from jaxscan.errors import CalibrationError, CaptureError
from jaxscan.files.capture import Capture


def calibrate(
    captures: Capture | Sequence[Capture],
    *,
    settings: CalibrationSettings | None = None,
    only_camera: bool = False,
    progress: Progress | None = None,
) -> Calibration:
    """Calibrate a rig from captures of a board: corners, stripes, one joint least squares.

    Args:
        captures: Calibration captures of the same board, camera and rig.
        settings: Of the solve.
        only_camera: Intrinsics alone; lasers and turntable are left out of the result.
        progress: Called with (records done, records in all).

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
    observations = observe_boards(captures, with_stripes=not only_camera, progress=progress)
    solve = calibrate_camera if only_camera else calibrate_observations
    result = solve(observations, settings=settings or CalibrationSettings())
    provenance = {
        **result.provenance,
        "captures": [{"name": capture.path.name, "digest": capture.digest()} for capture in captures],
        "versions": {name: metadata.version(name) for name in ("jaxscan", "jax", "optimistix", "numpy")},
    }
    return Calibration(**{**vars(result), "provenance": provenance})
