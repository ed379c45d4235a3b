"""`jaxscan calibrate`: board captures to a calibrated scanner."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from jaxscan import api
from jaxscan.calibration import CalibrationSettings
from jaxscan.calibration.parameters import Block
from jaxscan.cli.options import OutputPath
from jaxscan.cli.output import JsonTarget, check_json, console, emit_json
from jaxscan.cli.progress import progress_bar
from jaxscan.cli.summary import print_summary, summary, write_page
from jaxscan.errors import CalibrationError
from jaxscan.files.calibration import check_calibration_path, quality_table
from jaxscan.files.disk import check_writable
from jaxscan.geometry import CameraModel
from jaxscan.report.words import headline


def calibrate(
    captures: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="CAPTURE")],
    /,
    *,
    output: OutputPath,
    report: Path | None = None,
    only: Literal["camera"] | None = None,
    lens: CameraModel = "pinhole",
    free: tuple[Block, ...] = (),
    hold: tuple[Block, ...] = (),
    redetect: bool = True,
    json: JsonTarget = None,
) -> None:
    """Calibrate the rig: `jaxscan calibrate captures/boards -o calibration.json`.

    Exit code 1 where the calibration is not accepted or its solve did not converge; its file is written all the same.

    Args:
        captures: One or more calibration captures of the same board and rig.
        output: Calibration file to write; its observations go into `<stem>.npz` beside it.
        report: Page to write (HTML), with everything by which to judge the calibration.
        only: `camera`: intrinsics alone, from boards without laser or turning. Such a file
            cannot reconstruct.
        lens: Model of the camera's lens.
        free: Parameters to estimate beside the usual ones.
        hold: Parameters not to estimate.
        redetect: Look at the images a second time, where the first solve says that corners and stripes are.
        json: Write the result as JSON too.
    """
    check_calibration_path(output)
    check_json(json)
    if report is not None:
        check_writable(report)
    opened = [api.open_capture(path) for path in captures]
    out = console(json)
    for capture in opened:
        for note in capture.notes:
            out.print(f"note: {capture.path}: {note}")
    with progress_bar("Looking for boards") as progress:
        settings = calibration_settings(lens, free, hold)
        result = api.calibrate(
            opened, settings=settings, only_camera=only == "camera", redetect=redetect, progress=progress
        )
    api.save_calibration(result, output)
    written = [str(output)]
    if report is not None:
        write_page(result, report)
        written.append(str(report))
    print_summary(out, result)
    out.print(f"written: {', '.join(written)}")
    files = {"calibration": str(output)} | ({"report": str(report)} if report is not None else {})
    emit_json(json, "calibrate", files | summary(result) | {"quality": quality_table(result.quality)})
    first = headline(result)
    if first.kind == "bad":
        raise CalibrationError(f"{output}: written, but {first.headline.lower()}. {first.explanation}")


def calibration_settings(lens: CameraModel, free: tuple[Block, ...], hold: tuple[Block, ...]) -> CalibrationSettings:
    """The usual settings, with some blocks freed and some held."""
    usual = CalibrationSettings(camera=lens)
    wanted = dict.fromkeys((*usual.free, *free))
    return CalibrationSettings(camera=lens, free=tuple(block for block in wanted if block not in hold))
