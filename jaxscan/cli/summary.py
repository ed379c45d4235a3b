"""Output of a calibration: as text for people, as JSON for machines, and as a page."""

import shlex
from pathlib import Path
from typing import Any

from jaxscan.api.products.reports import board_photographs
from jaxscan.calibration import Calibration
from jaxscan.cli.process.terminal import Terminal, table
from jaxscan.files.capture import open_capture
from jaxscan.files.disk import write_atomically
from jaxscan.geometry import Still
from jaxscan.report import calibration_date, calibration_page, outcome_rows, parameters, words


_STYLE = {"good": "bold green", "bad": "bold red", "open": "bold yellow"}


def print_summary(out: Terminal, calibration: Calibration, *, verbose: bool = False) -> None:
    """Print lengths, noise, faults and advice, and the verdict last; with `verbose` tests and parameters before all."""
    if verbose:
        _print_tables(out, calibration)
    lengths = words.lengths(calibration)
    if lengths:
        out.print("Uncertainty that the calibration alone causes (one standard deviation):")
    for line in lengths:
        out.print(f"  {words.millimetres(line.sigma_mm):>9}  {line.what}")
    for text in (*words.board_lines(calibration), *words.noise_lines(calibration), *words.second_look(calibration)):
        out.print(text)
    for view in words.bad_views(calibration):
        out.print(f"record {view.record}: {view.why}", style="yellow")
    for text in words.warnings(calibration):
        out.print(f"warning: {text}", style="yellow")
    for text in words.advice(calibration):
        out.print(f"to improve it: {text}")
    first = words.headline(calibration)
    out.print(f"{first.headline}. {first.explanation}", style=_STYLE[first.kind])


def _print_tables(out: Terminal, calibration: Calibration) -> None:
    outcomes = outcome_rows(calibration)
    if outcomes:
        rows = [row[:7] for row in outcomes]
        out.print(table("Tests", ("", "statistic", "dof", "p", "p of structure", "harm", "result"), rows))
    if calibration.quality.converged is False:
        return
    rows = [parameter.row() for parameter in parameters(calibration)]
    out.print(table("Parameters", ("parameter", "value", "standard deviation"), rows))


def next_command(calibration: Calibration, path: Path) -> str:
    """What to type after a calibration that can be used."""
    scanner = calibration.scanner
    if scanner is None or not scanner.laser_names or isinstance(scanner.turntable, Still):
        return shlex.join(["jaxscan", "report", str(path), "-o", str(path.with_suffix(".html"))])
    return shlex.join(["jaxscan", "reconstruct", "captures/room", "-c", str(path), "-o", "room.ply"])


def summary(calibration: Calibration) -> dict[str, Any]:
    """The same content as JSON."""
    return {
        "verdict": words.headline(calibration)._asdict(),
        "lengths": [line._asdict() for line in words.lengths(calibration)],
        "boards": words.board_lines(calibration),
        "noise": words.noise_lines(calibration),
        "second_look": words.second_look(calibration),
        "bad_views": [view._asdict() for view in words.bad_views(calibration)],
        "warnings": words.warnings(calibration),
        "advice": words.advice(calibration),
        "parameters": [parameter.as_json() for parameter in parameters(calibration)],
    }


def write_page(
    calibration: Calibration,
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

    Raises:
        JaxscanError: If the file cannot be written, or the capture is not that of the calibration.
    """
    photographs = {} if capture is None else board_photographs(open_capture(capture), calibration)
    date = calibration_date(calibration, path)
    written = calibration_page(calibration, notes=notes, date=date, photographs=photographs)
    write_atomically(output, written.encode())
