"""`jaxscan report`: draws the report of a stored calibration, or of a cloud."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

import jaxscan
from jaxscan import report as reports
from jaxscan.cli.calibrate import summary, write_page
from jaxscan.cli.help import Arg
from jaxscan.cli.options import CLOUD_SUFFIXES, CloudUnit, CloudUp, OptionalCalibrationPath, OutputPath, check_paths
from jaxscan.cli.progress import progress_bar
from jaxscan.cli.terminal import console, emit_json
from jaxscan.errors import OptionError
from jaxscan.files import calibration as calibration_files
from jaxscan.files import capture as capture_files
from jaxscan.files import clouds as cloud_files
from jaxscan.files import disk


if TYPE_CHECKING:
    from jaxscan.calibration import Calibration
    from jaxscan.files.clouds import Unit, Up
    from jaxscan.reconstruction import PointCloud


def report(
    result: Annotated[Path, Arg("RESULT")],
    /,
    *,
    output: OutputPath,
    calibration: OptionalCalibrationPath = None,
    capture: Path | None = None,
    unit: CloudUnit = None,
    up: CloudUp = None,
) -> None:
    """Draw the report of a calibration or a cloud: `jaxscan report calibration.json -o report.html`.

    A calibration is solved again from the observations beside its file, with the settings in it; the report says
    whether the result agrees with the stored parameters. Of a cloud (`jaxscan report room.ply -c calibration.json
    -o room.html`) it shows coverage, uncertainty, dimensions and doubts.

    Args:
        result: The calibration file, or the cloud.
        output: Report to write: one HTML file that needs no other files.
        calibration: Of a cloud: the calibration that it was made with.
        capture: Folder of the capture. Of a calibration its photographs are shown; of a cloud it is searched for
            suspicious steps, which needs the calibration too.
    """
    is_cloud = result.suffix.lower() in CLOUD_SUFFIXES.split()
    for option, value in (("--calibration", calibration), ("--unit", unit), ("--up", up)):
        if value is not None and not is_cloud:
            raise OptionError(f"{option}: is for clouds ({CLOUD_SUFFIXES}); {result} is taken for a calibration.")
    check_paths(
        {"RESULT": result, "--calibration": calibration, "--capture": capture},
        {"--output": output},
        kept={"the stripes": capture / capture_files.CACHE_NAME if capture is not None and is_cloud else None},
    )
    disk.check_writable(output)
    if not is_cloud:
        _of_calibration(result, output, capture)
        return

    numbers = write_room_report(result, output, calibration=calibration, capture=capture, unit=unit, up=up)
    out = console(numbers["notes"])
    for name, side in numbers["dimensions"].items():
        out.print(f"{name} {side['value_m']:.4f} m, sigma {1e3 * side['sigma_m']:.2f} mm")
    for doubt in numbers["doubts"]:
        out.print(f"suspicious: {doubt}")
    out.print(f"{numbers['points']:,} points; {100 * numbers['coverage']:.1f} % of the directions looked at have some")
    out.print(f"written: {output}")
    emit_json(numbers)


def _of_calibration(path: Path, output: Path, capture: Path | None) -> None:
    drawn, note, reproduced = _drawn(path)
    notes = calibration_files.calibration_notes(path)
    write_page(drawn, output, notes=(note, *notes), path=path, capture=capture)
    out = console()
    out.print(note, style="" if reproduced else "bold yellow")
    out.notes(notes)
    out.print(f"written: {output}")
    emit_json(
        {"calibration": str(path), "report": str(output), "reproduced": reproduced, "notes": notes} | summary(drawn),
    )


def _drawn(path: Path) -> tuple["Calibration", str, bool | None]:
    """The calibration to draw, a note on it, and whether it agrees with the stored one; None where that is unknown."""
    from jaxscan.api.calibration import solve_again

    stored = jaxscan.load_calibration(path)
    if stored.observations is None and "recalibration" in stored.provenance:
        note = (
            "Recalibrated from sweeps: there are no observations of boards to solve again. "
            "jaxscan recalibrate --report draws the walls of its sweeps."
        )
        return stored, note, None
    if stored.observations is None:
        return stored, "The observations are not beside the calibration file, so residuals are not shown.", None
    again = solve_again(stored, name=str(path))
    if again.reproduced is None:
        note = "Solved again from the stored observations: the solve did not converge."
    elif again.reproduced:
        note = "Solved again from the stored observations: the result agrees with the stored parameters."
    else:
        note = (
            f"Not reproduced: solved again from the stored observations, {again.parameter} is {again.departure:.3g} "
            "standard deviations from the stored value. The file was changed since, or another version made it; this "
            "report shows the new solution."
        )
    return again.calibration, note, again.reproduced


SAME_RAD = 0.02
"""A table's angle is corrected by less."""


def write_room_report(
    cloud: Path, output: Path, *, calibration: Path | None, capture: Path | None, unit: "Unit | None", up: "Up | None"
) -> dict[str, Any]:
    """Write the report of a cloud.

    Returns:
        Its numbers, for JSON.

    Raises:
        JaxscanError: If an input is not what it should be, or the report cannot be written.
    """
    # Imported here, so that `--help` does not load JAX.
    from jaxscan.api.reports import calibration_rows, look_again, save_report

    if capture is not None and calibration is None:
        raise OptionError("--capture: of a cloud it is looked at with the rig's calibration: give -c calibration.json.")
    stored = cloud_files.read_cloud(cloud)
    points, notes = cloud_files.in_metres(stored, unit)
    points, more = cloud_files.with_z_up(stored, points, up)
    notes = [*notes, *more]
    scanner, rows = None, []
    if calibration is not None:
        scanner = jaxscan.load_scanner(calibration)
        notes += calibration_files.calibration_notes(calibration)
        rows = calibration_rows(calibration, stored.about.calibration)
    elif stored.about.calibration:
        rows = [("digest", stored.about.calibration)]
    doubts, left_out = None, ""
    if capture is not None and scanner is not None:
        sweep = jaxscan.open_capture(capture)
        if not _is_made_of(stored.cloud, sweep.angles):
            raise OptionError(f"--capture: {cloud} was not made of {capture}: its profiles have other angles.")
        with progress_bar("Looking at the capture") as progress:
            doubts, left_out = look_again(sweep, scanner, progress)
    beside = reports.Beside(cloud.name, tuple(notes), tuple(rows), doubts, left_out)
    facts, box = save_report(points, output, scanner=scanner, beside=beside)
    sides = {} if box is None else box.sides
    seen = facts.directions[0]
    return {
        "cloud": str(cloud),
        "report": str(output),
        "points": facts.points,
        "dimensions": {name: {"value_m": side.value_m, "sigma_m": side.sigma_m} for name, side in sides.items()},
        "coverage": seen.share(of_band=True),
        "holes": len(seen.holes()),
        "median_sigma_m": facts.median_sigma_m,
        "doubts": list(facts.doubts if doubts is None else doubts),
        "notes": notes,
    }


def _is_made_of(cloud: "PointCloud", angles: np.ndarray) -> bool:
    """Whether the profiles of a cloud have the angles of a sweep's records [rad]; clouds do not name their capture."""
    record = np.asarray(cloud.record)
    if not (np.ptp(cloud.angle) > 0 and record.min() >= 0 and record.max() < len(angles)):
        return False
    return bool(np.abs(angles[record] - np.asarray(cloud.angle)).max() < SAME_RAD)
