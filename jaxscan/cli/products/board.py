"""`jaxscan board`: a calibration board to be printed."""

from jaxscan import api
from jaxscan.cli.options import ConfigPath, OutputPath
from jaxscan.cli.output import JsonTarget, check_json, console, emit_json
from jaxscan.cli.paths import capture_at, check_paths, file_at
from jaxscan.report.prints import Paper


def board(config: ConfigPath, /, *, output: OutputPath, paper: Paper = "A4", json: JsonTarget = None) -> None:
    """Print a calibration board: `jaxscan board board.toml -o board.pdf --paper A3`.

    In true size, with a ruler to check the print. A board that is larger than the paper goes on several sheets, with
    marks where they are joined.

    Args:
        config: A TOML file with a table [board], such as a configuration for `jaxscan scan`; or a capture.
        output: File to write: .pdf, or .svg, one for each sheet.
        paper: Size of the sheets.
        json: Write the result as JSON too.
    """
    reads = capture_at("CONFIG", config) if config.is_dir() else file_at("CONFIG", config)
    check_paths(reads, [*file_at("--output", output), *file_at("--json", json)])
    check_json(json)
    described = api.load_board(config)
    sheets = api.draw_board(described, output, paper)
    check_paths(
        reads, [*(place for file in sheets.files for place in file_at("--output", file)), *file_at("--json", json)]
    )
    files = api.write_sheets(sheets)
    out = console(json)
    out.print(described.describe())
    for note in sheets.notes:
        out.print(f"note: {note}")
    for file in files:
        out.print(f"written: {file}")
    out.print("Print it at 100 %, without fitting to the page, and write what you measure into [board].")
    width, height = (float(length) for length in described.outline()[2] - described.outline()[0])
    emit_json(
        json,
        "board",
        {
            "files": [str(file) for file in files],
            "board": described.describe(),
            "paper": paper,
            "sheets": len(sheets.pages),
            "width_mm": 1e3 * width,
            "height_mm": 1e3 * height,
            "notes": sheets.notes,
        },
    )
