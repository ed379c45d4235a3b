"""`jaxscan recalibrate`: refines a stored calibration with ordinary sweeps of a room."""

import shlex
from pathlib import Path
from typing import Annotated, Literal

import tyro

from jaxscan import api
from jaxscan.cli.options import CLOUD_SUFFIXES, CalibrationPath, OutputPath, range_limits
from jaxscan.cli.output import JsonTarget, check_json, console, emit_json
from jaxscan.cli.paths import Place, calibration_at, capture_at, check_paths, file_at
from jaxscan.cli.progress import progress_bar
from jaxscan.cli.recalibration.summary import print_recalibration, recalibration_json
from jaxscan.errors import CalibrationError, OptionError
from jaxscan.files.calibration import calibration_digest, calibration_notes, check_calibration_path
from jaxscan.files.capture import CACHE_NAME
from jaxscan.files.clouds import check_cloud_path
from jaxscan.files.disk import check_writable, write_atomically
from jaxscan.files.known_room import load_known_room
from jaxscan.recalibration import Given
from jaxscan.report.recalibration import drift_words, recalibration_page, table_lines


_RANGES = api.ReconstructSettings()
_Flag = tyro.conf.FlagCreatePairsOff[bool]


def recalibrate(
    sweeps: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="SWEEP")],
    /,
    *,
    calibration: CalibrationPath,
    output: OutputPath,
    boards: tuple[Path, ...] = (),
    stations: _Flag = False,
    known: Path | None = None,
    angles: Literal["model", "steps"] = "model",
    features: _Flag = False,
    no_features: _Flag = False,
    closed: _Flag = False,
    no_closed: _Flag = False,
    min_range: float = _RANGES.min_range_m,
    max_range: float = _RANGES.max_range_m,
    cloud: Annotated[
        Path | None, tyro.conf.arg(help=f"Cloud of the sweeps with the new calibration ({CLOUD_SUFFIXES}).")
    ] = None,
    report: Path | None = None,
    json: JsonTarget = None,
) -> None:
    """Recalibrate from sweeps of a room: `jaxscan recalibrate captures/room -c old.json -o new.json`.

    The first line says whether the rig is as it was calibrated. The old calibration is not changed; where these
    sweeps gain nothing, no calibration and no cloud is written and the exit code is 1.

    Args:
        sweeps: One or more sweeps of the same room with the rig as it is now.
        calibration: Calibration of the rig, as `jaxscan calibrate` or this verb wrote it.
        output: Calibration file to write.
        boards: Captures of a calibration board with the rig as it is now, beside at least one sweep.
        stations: Every sweep was taken from a place of its own.
        known: Known lengths and spheres of the room (.toml).
        angles: Errors of the table's angles: `model`, its gain and errors once and twice per turn; `steps`, one angle
            per step as well.
        features: Track features of the laser-off images, also where they have little texture; a note says where that
            fails.
        no_features: Track no features; without either, they are tracked where the images have texture.
        closed: A full turn of the table is exactly one turn (a gear without slip).
        no_closed: No such assumption, which is the default.
        min_range: Smallest distance of points from the camera [m].
        max_range: Largest distance of points from the camera [m].
        report: Report to write: an HTML page by which to judge the recalibration.
        json: Write the result as JSON too.
    """
    range_limits("--min-range", min_range, "--max-range", max_range)
    settings = api.RecalibrationSettings(
        stations=stations,
        stripes=api.ReconstructSettings(min_range_m=min_range, max_range_m=max_range),
        closed=_either("closed", closed, no_closed),
        angles=angles,
        features=_either("features", features, no_features),
    )
    check_paths(
        reads=[
            *(place for path in sweeps for place in capture_at("SWEEP", path)),
            *(place for path in boards for place in capture_at("--boards", path)),
            *calibration_at("--calibration", calibration),
            *file_at("--known", known),
        ],
        writes=[
            *calibration_at("--output", output),
            *(place for option, path in _others(cloud, report, json) for place in file_at(option, path)),
        ],
        kept=[Place("the stripes", path / CACHE_NAME) for path in sweeps],
    )
    check_calibration_path(output, with_observations=False)
    if cloud is not None:
        check_cloud_path(cloud)
    if report is not None:
        check_writable(report)
    check_json(json)
    given = Given() if known is None else load_known_room(known)
    captures, shown = ([api.open_capture(path) for path in paths] for paths in (sweeps, boards))
    notes = calibration_notes(calibration)
    with progress_bar("Recalibrating") as progress:
        result = api.recalibrate(captures, calibration, boards=shown, given=given, settings=settings, progress=progress)
    files: dict[str, str] = {}
    if result.calibration is not None:
        api.save_calibration(result.calibration, output)
        files["calibration"] = str(output)
        if cloud is not None:
            api.save_recalibrated_cloud(captures, result, cloud, calibration_digest=calibration_digest(output))
            files["cloud"] = str(cloud)
    # Whether the rig has drifted is worth knowing where nothing was updated too.
    if report is not None:
        title = f"{calibration.name} with {', '.join(path.name for path in (*sweeps, *boards))}"
        write_atomically(report, recalibration_page(result, title=title, notes=tuple(notes)).encode())
        files["report"] = str(report)
    if result.calibration is not None:
        out = console(json)
        for note in notes:
            out.print(f"note: {note}")
        out.print(f"written: {', '.join(files.values())}")
        print_recalibration(out, result)
        next_words = ["jaxscan", "reconstruct", str(sweeps[0]), "-c", str(output), "-o", f"{sweeps[0].name}.ply"]
        out.print(f"next: {shlex.join(next_words)}")
    emit_json(json, "recalibrate", files | recalibration_json(result))
    if result.calibration is None:
        raise CalibrationError(
            " ".join(
                (
                    f"{calibration}: not updated: {result.refused.removesuffix('.')}.",
                    *table_lines(result),
                    f"{drift_words(result.drift)}.",
                )
            )
        )


def _others(cloud: Path | None, report: Path | None, json: str | None) -> list[tuple[str, Path | str | None]]:
    return [("--cloud", cloud), ("--report", report), ("--json", json)]


def _either(option: str, yes: bool, no: bool) -> bool | None:
    """A choice of two options; None where neither is given."""
    if yes and no:
        raise OptionError(f"--{option}: found with --no-{option}, expected one of them.")
    return True if yes else False if no else None
