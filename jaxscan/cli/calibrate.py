"""`jaxscan calibrate`: board captures to a calibrated scanner."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from jaxscan import api
from jaxscan.cli.options import OutputPath
from jaxscan.cli.output import JsonTarget, check_json, console, emit_json, table
from jaxscan.cli.progress import progress_bar
from jaxscan.files.calibration import check_calibration_path
from jaxscan.report.calibration import parameter_rows, quality_lines


def calibrate(
    captures: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="CAPTURE")],
    /,
    *,
    output: OutputPath,
    only: Literal["camera"] | None = None,
    json: JsonTarget = None,
) -> None:
    """Calibrate the rig: `jaxscan calibrate captures/boards -o calibration.json`.

    Args:
        captures: One or more calibration captures of the same board and rig.
        output: Calibration file to write; its observations go into `<stem>.npz` beside it.
        only: `camera`: intrinsics alone, from boards without laser or turning. Such a file
            cannot reconstruct.
        json: Write the result as JSON too.
    """
    check_calibration_path(output)
    check_json(json)
    opened = [api.open_capture(path) for path in captures]
    out = console(json)
    for capture in opened:
        for note in capture.notes:
            out.print(f"note: {capture.path}: {note}")
    with progress_bar("Looking for boards") as progress:
        result = api.calibrate(opened, only_camera=only == "camera", progress=progress)
    api.save_calibration(result, output)
    out.print(table("Calibration", ("parameter", "value", "standard deviation"), parameter_rows(result)))
    for line in quality_lines(result):
        out.print(line)
    out.print(f"written: {output}")
    emit_json(json, "calibrate", {"calibration": str(output), "quality": result.quality})
