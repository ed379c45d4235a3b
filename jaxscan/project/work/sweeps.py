"""Calibrations and clouds, made of captures."""

from functools import partial
from pathlib import Path

from jaxscan import api
from jaxscan.api.sweeps import cloud_of_ranges, stripes_of_range
from jaxscan.errors import CalibrationError, CaptureError
from jaxscan.files.calibration import calibration_digest, calibration_notes
from jaxscan.files.capture import Capture
from jaxscan.files.disk import read_arrays, write_arrays, write_atomically
from jaxscan.geometry import Scanner
from jaxscan.project.work.desk import Desk
from jaxscan.reconstruction import PointCloud


def calibrate_rig(desk: Desk) -> None:
    """Calibrate from captures of a board, as `jaxscan calibrate` does.

    Raises:
        CalibrationError: If the result cannot be used.
    """
    captures = [desk.capture(role) for role in desk.step.sources]
    boards = " and ".join(Path(address).name for address in desk.step.sources.values())
    try:
        result = api.calibrate(captures, progress=desk.progress)
    except CalibrationError as problem:
        raise CalibrationError(f"{boards}: {problem}") from problem
    verdict = result.quality.verdict
    if verdict is not None and verdict.refused is not None:
        raise CalibrationError(f"{boards}: cannot be used: {verdict.refused}")
    good_to = verdict.good_to if verdict is not None else None
    if good_to is not None and good_to.sigma_mm is not None and good_to.at_m is not None:
        desk.notes.append(f"Good to {good_to.sigma_mm:.2g} mm at {good_to.at_m:.1f} m.")
    desk.notes.extend(result.missing)
    api.save_calibration(result, desk.target())


def find_part(desk: Desk) -> None:
    """The stripes of some records of a large sweep."""
    sweep, scanner = desk.capture().every(desk.setting("every")), api.load_scanner(desk.file("calibration"))
    settings, records = reconstruct_settings(desk), (desk.setting("first"), desk.setting("stop"))
    arrays = stripes_of_range(sweep, scanner, records, settings=settings, progress=desk.progress)
    write_atomically(desk.target(), partial(write_arrays, arrays=arrays), durable=False, error=CaptureError)


def reconstruct_sweep(desk: Desk) -> None:
    """Reconstruct a sweep, as `jaxscan reconstruct` does, in all formats that are wanted."""
    calibration = desk.file("calibration")
    desk.notes.extend(calibration_notes(calibration))
    sweep, scanner = desk.capture().every(desk.setting("every")), api.load_scanner(calibration)
    parts = [desk.file(role) for role in desk.step.products if role.startswith("stripes ")]
    if parts:
        arrays = [read_arrays(path, error=CaptureError) for path in parts]
        done = cloud_of_ranges(sweep, scanner, arrays, settings=reconstruct_settings(desk))
    else:
        done = api.reconstruct_capture(sweep, scanner, settings=reconstruct_settings(desk), progress=desk.progress)
    desk.notes.extend(done.notes)
    cloud = coloured(desk, done.cloud, sweep, scanner)
    digest = calibration_digest(calibration)
    for number in range(len(desk.step.outputs)):
        api.save_cloud(cloud, desk.target(number), calibration_digest=digest)


def reconstruct_settings(desk: Desk) -> api.ReconstructSettings:
    """How the sweep of a step is reconstructed."""
    return api.ReconstructSettings(
        smooth=desk.setting("smooth"), min_range_m=desk.setting("min_range_m"), max_range_m=desk.setting("max_range_m")
    )


def coloured(desk: Desk, cloud: PointCloud, sweep: Capture, scanner: Scanner) -> PointCloud:
    """The cloud in the colours that are wanted, as far as there are photographs."""
    if desk.setting("colour") != "photographs" or not api.has_photographs(sweep):
        return cloud
    return api.colour_cloud(cloud, sweep, scanner)
