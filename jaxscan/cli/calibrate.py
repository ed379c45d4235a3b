"""`jaxscan calibrate`: calibrates a scanner from captures of boards."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import tyro

from jaxscan import api
from jaxscan.calibration import Block, CalibrationSettings, KnownParts, Part, RigKind
from jaxscan.cli.known import known_files, known_parts, motion_notes
from jaxscan.cli.options import OutputPath
from jaxscan.cli.output import JsonTarget, check_json, console, emit_json
from jaxscan.cli.paths import calibration_at, capture_at, check_paths, file_at
from jaxscan.cli.progress import progress_bar
from jaxscan.cli.summary import next_command, print_summary, summary, write_page
from jaxscan.errors import CalibrationError
from jaxscan.files.calibration import check_calibration_path, quality_table
from jaxscan.files.disk import check_writable
from jaxscan.geometry import CameraModel
from jaxscan.report import words


def calibrate(
    captures: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="CAPTURE")],
    /,
    *,
    output: OutputPath,
    report: Path | None = None,
    only: RigKind | None = None,
    camera: Path | None = None,
    sheet: tuple[str, ...] = (),
    axis: tuple[str, ...] = (),
    refine: tuple[Part, ...] = (),
    lens: CameraModel | None = None,
    free: tuple[Block, ...] = (),
    hold: tuple[Block, ...] = (),
    redetect: bool = True,
    limit_mm: float | None = None,
    at_m: float | None = None,
    limit_px: float | None = None,
    verbose: bool = False,
    json: JsonTarget = None,
) -> None:
    """Calibrate the rig: `jaxscan calibrate captures/boards -o calibration.json`.

    The first line says which parts of the rig the captures determine; the last lines say to how many millimetres or
    pixels the result is good, and what to type next. The exit code is 1 if it cannot be used at all, because its
    solve did not converge or its points are off by more than 5 % of their distance, or if it breaks a limit. The file
    is written in any case.

    Args:
        captures: One or more captures of the same board with the same rig.
        output: Calibration file to write; its observations go into `<stem>.npz` beside it.
        report: Report to write: an HTML page by which to judge the calibration.
        only: A smaller rig than the captures determine: `camera` alone; `profile`, camera and sheets; `axis`, camera
            and axis. Without sheets a calibration cannot reconstruct.
        camera: Camera that is known: a calibration (.json), or a file of OpenCV, ROS, Kalibr, mrcal or COLMAP. A known
            part is held.
        sheet: Laser sheet that is known: four numbers a b c d of the plane a X + b Y + c Z = d, in metres, of each
            laser; or a calibration (.json).
        axis: Axis that is known: a point, in metres, and a direction; for a linear stage its direction; or a
            calibration (.json).
        refine: Known parts to estimate from there: `camera`, `sheet`, `axis`.
        lens: Camera model; `fisheye` and `double_sphere` are for wide-angle lenses. `pinhole` if not given, or another
            one that explains the corners better by far.
        free: Blocks of parameters to estimate in addition to the usual ones.
        hold: Blocks of parameters not to estimate.
        redetect: Take a second look at the images, where the first solve predicts corners and stripes.
        limit_mm: Refuse a rig whose points are not good to this.
        at_m: Depth at which points are judged; 2.5 m if not given, or as far as the rig reaches.
        limit_px: Refuse a camera whose rays are not good to this, over the image.
        verbose: Print the tests and all parameters too.
        json: Write the result as JSON too.
    """
    parts = [("--camera", camera)] if camera else []
    known_places = [place for option, path in (*parts, *known_files(sheet, axis)) for place in file_at(option, path)]
    check_paths(
        reads=[*(place for path in captures for place in capture_at("CAPTURE", path)), *known_places],
        writes=[*calibration_at("--output", output), *file_at("--report", report), *file_at("--json", json)],
    )
    check_calibration_path(output)
    check_json(json)
    if report is not None:
        check_writable(report)
    settings = replace(calibration_settings(lens or "pinhole", free, hold), only=only, choose_lens=lens is None)
    settings = replace(settings, limit_mm=limit_mm, at_m=at_m, limit_px=limit_px)
    opened = [api.open_capture(path) for path in captures]
    out = console(json)
    for capture in opened:
        for note in capture.notes:
            out.print(f"note: {capture.path}: {note}")
    known, notes = KnownParts(), list[str]()
    if opened:
        known, notes = known_parts(opened[0], camera, sheet, axis, refine, lens or "pinhole")
    for note in motion_notes(opened[0], axis) if opened else []:
        out.print(f"note: {note}")
    plan = api.plan_calibration(opened, settings=settings, known=known)
    for note in notes:
        out.print(f"note: {note}")
    out.print(f"solving for {plan.words()}{_held(known)}")
    for sentence in plan.missing:
        out.print(sentence)
    with progress_bar("Calibrating") as progress:
        result = api.calibrate(opened, settings=settings, known=known, redetect=redetect, progress=progress)
    told = {_part(sentence) for sentence in plan.missing}
    for sentence in result.missing:
        if _part(sentence) not in told:
            out.print(sentence, style="yellow")
    api.save_calibration(result, output)
    files = {"calibration": str(output)}
    if report is not None:
        write_page(result, report)
        files["report"] = str(report)
    out.print(f"written: {', '.join(files.values())}")
    print_summary(out, result, verbose=verbose)
    found = {"missing": result.missing, "quality": quality_table(result.quality)}
    emit_json(json, "calibrate", files | summary(result) | found)
    first = words.headline(result)
    if first.kind == "bad":
        raise CalibrationError(f"{output}: written, but {first.headline.lower()}. {first.explanation}")
    out.print(f"next: {next_command(result, output)}")


def _part(sentence: str) -> str:
    """The part of the rig that a sentence says is missing."""
    return sentence.partition(":")[0]


def _held(known: KnownParts) -> str:
    return f"; held: {' and '.join(known.held())}" if known.held() else ""


def calibration_settings(lens: CameraModel, free: tuple[Block, ...], hold: tuple[Block, ...]) -> CalibrationSettings:
    """The usual settings, with some blocks freed and some held."""
    wanted = dict.fromkeys((*CalibrationSettings().free, *free))
    return CalibrationSettings(camera=lens, free=tuple(block for block in wanted if block not in hold))
