"""`jaxscan recalibrate`: refines a stored calibration with ordinary sweeps of a room."""

import shlex
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from jaxscan import api, recalibration
from jaxscan import report as calibration_reports
from jaxscan.cli.calibrate import STYLES
from jaxscan.cli.help import Arg
from jaxscan.cli.options import (
    CLOUD_SUFFIXES,
    MAX_RANGE_M,
    MIN_RANGE_M,
    CalibrationPath,
    OutputPath,
    check_paths,
    range_limits,
)
from jaxscan.cli.progress import progress_bar
from jaxscan.cli.terminal import Terminal, console, emit_json
from jaxscan.errors import CalibrationError
from jaxscan.files import calibration as calibration_files
from jaxscan.files import capture as capture_files
from jaxscan.files import clouds as cloud_files
from jaxscan.files import disk
from jaxscan.report import recalibration as reports


if TYPE_CHECKING:
    from jaxscan.calibration import Calibration
    from jaxscan.recalibration import Recalibration


def recalibrate(
    sweeps: Annotated[tuple[Path, ...], Arg("SWEEP")],
    /,
    *,
    calibration: CalibrationPath,
    output: OutputPath,
    boards: tuple[Path, ...] = (),
    stations: bool = False,
    known: Path | None = None,
    features: bool | None = None,
    closed: bool | None = None,
    min_range: float = MIN_RANGE_M,
    max_range: float = MAX_RANGE_M,
    cloud: Annotated[Path | None, Arg(text=f"Cloud of the sweeps with the new calibration ({CLOUD_SUFFIXES}).")] = None,
    report: Path | None = None,
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
        known: Known lengths of the room, and places of the stations (.toml).
        features: Track features of the laser-off images, also where they have little texture (a note says where that
            fails), or nowhere; without either, where the images have texture.
        closed: A full turn of the table is exactly one turn (a gear without slip), or need not be, as by default.
        min_range: Smallest distance of points from the camera [m].
        max_range: Largest distance of points from the camera [m].
        report: Report to write: an HTML page by which to judge the recalibration.
    """
    range_limits("--min-range", min_range, "--max-range", max_range)
    settings = api.RecalibrationSettings(
        stations=stations,
        stripes=api.ReconstructSettings(min_range_m=min_range, max_range_m=max_range),
        closed=closed,
        features=features,
    )
    check_paths(
        {"SWEEP": sweeps, "--boards": boards, "--calibration": calibration, "--known": known},
        {"--output": output, "--cloud": cloud, "--report": report},
        kept={"the stripes": [path / capture_files.CACHE_NAME for path in sweeps]},
    )
    calibration_files.check_calibration_path(output, with_observations=False)
    if cloud is not None:
        cloud_files.check_cloud_path(cloud)
    if report is not None:
        disk.check_writable(report)
    # Imported here, so that `--help` does not load JAX.
    from jaxscan.files.known_room import load_known_room

    given = recalibration.Given() if known is None else load_known_room(known)
    captures, shown = ([api.open_capture(path) for path in paths] for paths in (sweeps, boards))
    notes = calibration_files.calibration_notes(calibration)
    with progress_bar("Recalibrating") as progress:
        result = api.recalibrate(captures, calibration, boards=shown, given=given, settings=settings, progress=progress)
    files: dict[str, str] = {}
    if result.calibration is not None:
        api.save_calibration(result.calibration, output)
        files["calibration"] = str(output)
        if cloud is not None:
            digest, stripes = calibration_files.calibration_digest(output), result.settings.stripes
            api.save_recalibrated_cloud(
                captures, result.adjusted, result.scanner, cloud, settings=stripes, calibration_digest=digest
            )
            files["cloud"] = str(cloud)
    # The verdict on drift is printed even if nothing was updated.
    if report is not None:
        title = f"{calibration.name} with {', '.join(path.name for path in (*sweeps, *boards))}"
        disk.write_atomically(report, reports.recalibration_page(result, title=title, notes=tuple(notes)).encode())
        files["report"] = str(report)
    if result.calibration is not None:
        out = console()
        out.notes(notes)
        out.print(f"written: {', '.join(files.values())}")
        print_recalibration(out, result)
        out.print(_good_to(result.calibration, api.load_calibration(calibration)))
        next_words = ["jaxscan", "reconstruct", str(sweeps[0]), "-c", str(output), "-o", f"{sweeps[0].name}.ply"]
        out.print(f"next: {shlex.join(next_words)}")
    emit_json(files | recalibration_json(result))
    if result.calibration is None:
        sentences = (*reports.words.table_lines(result), f"{reports.words.drift_words(result.drift)}.")
        why = result.refused.removesuffix(".")
        raise CalibrationError(f"{calibration}: not updated: {why}. {' '.join(sentences)}")


def _good_to(new: "Calibration", old: "Calibration") -> str:
    """How good the calibration is, in the same figure as `jaxscan calibrate`, and how good it was."""
    verdicts = [one.quality.verdict for one in (new, old)]
    found = [None if one is None else one.good_to for one in verdicts]
    words = [None if one is None else calibration_reports.words.good_to_words(one) for one in found]
    return f"Good to {words[0] or 'not known'}, before {words[1] or 'not known'}."


_UNUSUAL = 3.0
"""Changes beyond this many standard deviations are named."""


def print_recalibration(out: Terminal, result: "Recalibration") -> None:
    """Print gains, moves, walls, closure and open directions, and the drift verdict last."""
    words = reports.words
    for text in words.table_lines(result):
        out.print(f"table: {text}", style="yellow")
    moved = [
        f"{one.name}: {one.scale * one.before:.7g} → {one.scale * one.after:.7g}{f' {one.unit}' if one.unit else ''}, "
        f"{one.sigmas:+.1f} sigmas"
        for one in words.by_sigmas(result.moved)
        if abs(one.sigmas) > _UNUSUAL
    ]
    blocks = {
        "Uncertainty that the calibration alone causes (one standard deviation):": words.length_lines(result),
        "Directions in the space of the parameters:": words.gain_lines(result.gains),
        "Moved by more than chance:": moved,
    }
    for title, lines in blocks.items():
        for line in (title, *(f"  {line}" for line in lines)) if lines else ():
            out.print(line)
    for told in (words.known_lines, words.wall_lines, words.hold_out_lines, words.closure_lines):
        for text in told(result):
            out.print(text)
    for text in result.unobserved:
        out.print(f"not told by these captures: {text}")
    out.notes(result.notes)
    first = words.headline(result)
    out.print(f"{first.headline}.", style=STYLES[first.kind])
    out.print(first.explanation)


def recalibration_json(result: "Recalibration") -> dict[str, Any]:
    """The same content as JSON."""
    adjusted, table = result.adjusted, result.table
    walls = [(panorama.sweep, *reports.words.flatness_mm(panorama)) for panorama in result.panoramas]
    return calibration_files.finite(
        {
            "updated": result.updated,
            "verdict": reports.words.headline(result)._asdict(),
            "drift": asdict(result.drift),
            "lengths": [asdict(one) for one in result.lengths],
            "known_lengths": [asdict(one) for one in result.known],
            "gains": [asdict(gain) | {"factor": gain.factor} for gain in result.gains],
            "unobserved": result.unobserved,
            "moved": [asdict(one) for one in reports.words.by_sigmas(result.moved)],
            "walls": [{"sweep": name, "before_mm": before, "after_mm": after} for name, before, after in walls],
            "hold_out": None if result.hold_out is None else asdict(result.hold_out),
            "closure": None if result.closure is None else asdict(result.closure),
            "table": {"jumps": table.jumps, "sentences": table.sentences},
            "stations": [
                {"pose": pose, "covariance": covariance}
                for pose, covariance in zip(adjusted.stations, adjusted.station_covariance, strict=True)
            ],
            "points": int(np.count_nonzero(adjusted.point_kept)),
            "surfaces": len(adjusted.surfaces.distance),
            "wall_m": adjusted.wall_m,
            "inflation": adjusted.inflation,
            "notes": result.notes,
        }
    )
