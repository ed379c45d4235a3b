"""`jaxscan calibrate`: calibrates a scanner from captures of boards."""

import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from jaxscan import api, geometry
from jaxscan import calibration as calibrating
from jaxscan import report as reports
from jaxscan.cli.help import Arg
from jaxscan.cli.options import Block, OutputPath, Part, RigKind, check_paths
from jaxscan.cli.progress import progress_bar
from jaxscan.cli.terminal import Terminal, console, emit_json, table
from jaxscan.errors import CalibrationError, OptionError
from jaxscan.files import calibration as calibration_files
from jaxscan.files import capture as capture_files
from jaxscan.files import disk
from jaxscan.geometry import CameraModel


if TYPE_CHECKING:
    from jaxscan.calibration import Calibration, CalibrationSettings, KnownParts
    from jaxscan.files.capture import Capture
    from jaxscan.geometry import AbstractMotion, LaserSheet


def calibrate(
    captures: Annotated[tuple[Path, ...], Arg("CAPTURE")],
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
        free: What to estimate beside the usual: of the lens `focal`, `centre`, `radial`, `tangential`, `k3`,
            `rational`, `sphere`; of sheets `laser`, `bow`; of the motion `axis`, `gain`, `harmonics`, `travel`,
            `hand`; of the board its bend `warp`, its size `pitch` and its `shape`.
        hold: What not to estimate; the same names as of --free.
        redetect: Take a second look at the images, where the first solve predicts corners and stripes.
        limit_mm: Refuse a rig whose points are not good to this.
        at_m: Depth at which points are judged; 2.5 m if not given, or as far as the rig reaches.
        limit_px: Refuse a camera whose rays are not good to this, over the image.
        verbose: Print the tests and all parameters too.
    """
    known = {option: Path(words[0]) for option, words in (("--sheet", sheet), ("--axis", axis)) if _is_file(words)}
    check_paths({"CAPTURE": captures, "--camera": camera, **known}, {"--output": output, "--report": report})
    calibration_files.check_calibration_path(output)
    if report is not None:
        disk.check_writable(report)
    settings = replace(calibration_settings(lens or "pinhole", free, hold), only=only, choose_lens=lens is None)
    settings = replace(settings, limit_mm=limit_mm, at_m=at_m, limit_px=limit_px)
    opened = [api.open_capture(path) for path in captures]
    out = console(f"{capture.path}: {note}" for capture in opened for note in capture.notes)
    parts, notes = calibrating.KnownParts(), list[str]()
    if opened:
        parts, notes = known_parts(opened[0], camera, sheet, axis, refine, lens or "pinhole")
    if opened and axis and not _is_file(axis) and opened[0].carries is None:
        out.notes(
            [
                f"{opened[0].path}: does not say what the table carries, so --axis is that of a table that carries the "
                'scanner; otherwise write into its capture.toml: [turntable] carries = "object".'
            ]
        )
    plan = api.plan_calibration(opened, settings=settings, known=parts)
    out.notes(notes)
    held = f"; held: {' and '.join(parts.held())}" if parts.held() else ""
    out.print(f"solving for {plan.words()}{held}")
    for sentence in plan.missing:
        out.print(sentence)
    with progress_bar("Calibrating") as progress:
        result = api.calibrate(opened, settings=settings, known=parts, redetect=redetect, progress=progress)
    # A sentence begins with the part of the rig that is missing.
    listed = {sentence.partition(":")[0] for sentence in plan.missing}
    for sentence in result.missing:
        if sentence.partition(":")[0] not in listed:
            out.print(sentence, style="yellow")
    api.save_calibration(result, output)
    files = {"calibration": str(output)}
    if report is not None:
        write_page(result, report)
        files["report"] = str(report)
    out.print(f"written: {', '.join(files.values())}")
    print_summary(out, result, verbose=verbose)
    found = {"missing": result.missing, "quality": calibration_files.quality_table(result.quality)}
    emit_json(files | summary(result) | found)
    first = reports.words.headline(result)
    if first.kind == "bad":
        raise CalibrationError(f"{output}: written, but {first.headline.lower()}. {first.explanation}")
    out.print(f"next: {next_command(result, output)}")


def calibration_settings(lens: CameraModel, free: tuple[Block, ...], hold: tuple[Block, ...]) -> "CalibrationSettings":
    """The usual settings, with some blocks freed and some held."""
    wanted = dict.fromkeys((*calibrating.CalibrationSettings().free, *free))
    return calibrating.CalibrationSettings(camera=lens, free=tuple(block for block in wanted if block not in hold))


def known_parts(
    capture: "Capture",
    camera: Path | None,
    sheet: Sequence[str],
    axis: Sequence[str],
    refine: Sequence[Part],
    lens: CameraModel = "pinhole",
) -> "tuple[KnownParts, list[str]]":
    """The parts that are given, for the rig of a capture, and notes on how the camera was read.

    Raises:
        OptionError: If numbers are missing or mean nothing, or a part is to be refined that is not given.
        CalibrationError: If a file is wrong, or lacks the part.
    """
    given = {"camera": camera, "sheet": sheet, "axis": axis}
    for part in refine:
        if not given[part]:
            raise OptionError(f"--refine {part}: --{part} is missing, which gives the values to start from.")
    known_camera, notes = None, list[str]()
    if camera is not None:
        read = calibration_files.read_camera(
            camera, capture.image_size, unnamed="fisheye" if lens == "fisheye" else "pinhole"
        )
        known_camera = read.camera
        if lens not in ("pinhole", known_camera.model):
            raise OptionError(
                f"--lens {lens}: {camera} holds a {known_camera.model} camera; leave out --lens, or --camera."
            )
        notes += [read.note] if read.note else []
    known = calibrating.KnownParts(
        camera=known_camera,
        sheets=_sheets(sheet, [line.name for line in capture.lasers]) if sheet else (),
        motion=_motion(axis, capture.carries or "scanner") if axis else None,
        refine=tuple(refine),
    )
    return known, notes


def _is_file(words: Sequence[str]) -> bool:
    return len(words) == 1 and words[0].lower().endswith(".json")


def _sheets(words: Sequence[str], names: Sequence[str]) -> "tuple[LaserSheet, ...]":
    if _is_file(words):
        scanner = calibration_files.load_parts(words[0])[1]
        if scanner is None or not scanner.laser_names:
            raise OptionError(f"--sheet: {words[0]} holds no laser sheet, expected a calibration with one.")
        known = scanner.laser_names
        if set(names) <= set(known):
            return tuple(scanner.laser(known.index(name)) for name in names)
        if len(known) > 1:
            raise OptionError(
                f"--sheet: {words[0]} has the lasers {', '.join(known)}, the capture {', '.join(names) or 'none'}; "
                "give the planes as numbers, in the order of the capture's lasers."
            )
        return (scanner.laser(0),)
    values = _numbers("--sheet", words, 4 * max(len(names), 1), "a b c d of the plane a X + b Y + c Z = d")
    try:
        return tuple(geometry.LaserSheet.from_plane(plane[:3], plane[3]) for plane in values.reshape(-1, 4))
    except ValueError as problem:
        raise OptionError(f"--sheet: {problem}.") from problem


def _motion(words: Sequence[str], carries: str) -> "AbstractMotion":
    if _is_file(words):
        scanner = calibration_files.load_parts(words[0])[1]
        if scanner is None or isinstance(scanner.turntable, geometry.Still):
            raise OptionError(f"--axis: {words[0]} holds no axis, expected a calibration with one.")
        return scanner.turntable
    keys, wanted = geometry.MOTIONS[carries].numbers
    if not keys:
        raise OptionError("--axis: the header says that nothing moves, expected no axis.")
    values = _numbers("--axis", words, 3 * len(keys), wanted).reshape(-1, 3)
    try:
        return geometry.motion_of(carries, **dict(zip(keys, values, strict=True)))
    except ValueError as problem:
        raise OptionError(f"--axis: {problem}.") from problem


def _numbers(option: str, words: Sequence[str], count: int, meaning: str) -> np.ndarray:
    try:
        values = np.array([float(word) for word in words])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or not np.isfinite(values).all():
        raise OptionError(
            f"{option}: found {' '.join(words)[:60]}, expected {count} numbers ({meaning}) or a calibration (.json)."
        )
    return values


STYLES = {"good": "bold green", "plain": "bold", "bad": "bold red", "open": "bold yellow"}
"""How verdicts are printed, by their kind."""


def print_summary(out: Terminal, calibration: "Calibration", *, verbose: bool = False) -> None:
    """Print lengths, noise, faults and advice, and the verdict last; with `verbose` tests and parameters before all."""
    words, found = reports.words, summary(calibration)
    if verbose and (outcomes := reports.outcome_rows(calibration)):
        columns = ("", "statistic", "dof", "p", "p of structure", "harm", "result")
        out.print(table("Tests", columns, [row[:7] for row in outcomes]))
    if verbose and calibration.quality.converged is not False:
        rows = [parameter.row() for parameter in reports.parameters(calibration)]
        out.print(table("Parameters", ("parameter", "value", "standard deviation"), rows))
    if found["lengths"]:
        out.print("Uncertainty that the calibration alone causes (one standard deviation):")
    for line in words.lengths(calibration):
        out.print(f"  {words.millimetres(line.sigma_mm):>9}  {line.what}")
    for text in (*found["boards"], *found["noise"], *found["second_look"]):
        out.print(text)
    for view in words.bad_views(calibration):
        out.print(f"record {view.record}: {view.why}", style="yellow")
    for text in found["warnings"]:
        out.print(f"warning: {text}", style="yellow")
    for text in found["advice"]:
        out.print(f"to improve it: {text}")
    first = words.headline(calibration)
    out.print(f"{first.headline}. {first.explanation}", style=STYLES[first.kind])


def next_command(calibration: "Calibration", path: Path) -> str:
    """What to type after a calibration that can be used."""
    scanner = calibration.scanner
    if scanner is None or not scanner.laser_names or isinstance(scanner.turntable, geometry.Still):
        return shlex.join(["jaxscan", "report", str(path), "-o", str(path.with_suffix(".html"))])
    return shlex.join(["jaxscan", "reconstruct", "captures/room", "-c", str(path), "-o", "room.ply"])


def summary(calibration: "Calibration") -> dict[str, Any]:
    """The same content as JSON."""
    return {
        "verdict": reports.words.headline(calibration)._asdict(),
        "lengths": [line._asdict() for line in reports.words.lengths(calibration)],
        "boards": reports.words.board_lines(calibration),
        "noise": reports.words.noise_lines(calibration),
        "second_look": reports.words.second_look(calibration),
        "bad_views": [view._asdict() for view in reports.words.bad_views(calibration)],
        "warnings": reports.words.warnings(calibration),
        "advice": reports.words.advice(calibration),
        "parameters": [parameter.as_json() for parameter in reports.parameters(calibration)],
    }


def write_page(
    calibration: "Calibration",
    output: Path,
    *,
    notes: tuple[str, ...] = (),
    path: Path | None = None,
    capture: Path | None = None,
) -> None:
    """Write the report.

    Args:
        calibration: To draw.
        output: File to write.
        notes: Remarks that come first.
        path: The calibration's own file, whose time is shown where the calibration does not say its own.
        capture: Folder of the capture of boards, for its photographs.
    """
    photographs = {} if capture is None else api.board_photographs(capture_files.open_capture(capture), calibration)
    date = reports.calibration_date(calibration, path)
    written = reports.calibration_page(calibration, notes=notes, date=date, photographs=photographs)
    disk.write_atomically(output, written.encode())
