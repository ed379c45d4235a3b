"""`jaxscan report`: draws the report of a stored calibration."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

import jaxscan
from jaxscan.cli.options import OutputPath
from jaxscan.cli.output import JsonTarget, check_json, console, emit_json
from jaxscan.cli.paths import calibration_at, check_paths, file_at


if TYPE_CHECKING:
    from jaxscan.calibration import Calibration


def report(
    calibration: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="CALIBRATION")],
    /,
    *,
    output: OutputPath,
    json: JsonTarget = None,
) -> None:
    """Draw a calibration's report: `jaxscan report calibration.json -o report.html`.

    Solves again from the observations beside the file, with the settings in it, and says whether the result agrees
    with the stored parameters.

    Args:
        calibration: The calibration file.
        output: Report to write: one HTML file that needs no other files.
        json: Write the result as JSON too.
    """
    # Imported here, so that `--help` does not load JAX.
    from jaxscan.cli.summary import summary, write_page
    from jaxscan.files.calibration import calibration_notes
    from jaxscan.files.disk import check_writable

    check_paths(calibration_at("CALIBRATION", calibration), [*file_at("--output", output), *file_at("--json", json)])
    check_writable(output)
    check_json(json)
    drawn, note, reproduced = _drawn(calibration)
    notes = calibration_notes(calibration)
    write_page(drawn, output, notes=(note, *notes))
    out = console(json)
    out.print(note, style="" if reproduced else "bold yellow")
    for other in notes:
        out.print(f"note: {other}")
    out.print(f"written: {output}")
    emit_json(
        json,
        "report",
        {"calibration": str(calibration), "report": str(output), "reproduced": reproduced, "notes": notes}
        | summary(drawn),
    )


def _drawn(path: Path) -> tuple["Calibration", str, bool | None]:
    """The calibration to draw, a note on it, and whether it agrees with the stored one; None where that is unknown."""
    from jaxscan.api.again import solve_again

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
