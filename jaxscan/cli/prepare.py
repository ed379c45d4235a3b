"""`jaxscan init`, `board`, `simulate`: a configuration, a printed board, simulated captures."""

import difflib
import importlib.resources
import os
import re
import time
from pathlib import Path
from typing import Annotated

import jaxscan
from jaxscan import api
from jaxscan.cli.help import Arg
from jaxscan.cli.options import ConfigPath, OutputPath, Paper, at_least, check_paths
from jaxscan.cli.progress import progress_bar
from jaxscan.cli.terminal import console, emit_json
from jaxscan.errors import ConfigError, OptionError
from jaxscan.files import disk


Name = Annotated[str | None, Arg("NAME")]


def init(
    name: Name = None,
    /,
    *,
    output: Annotated[Path | None, Arg(short="-o")] = None,
    list: bool = False,
) -> None:
    """Write a configuration to start from: `jaxscan init scan.toml`. All there are: `jaxscan init --list`.

    Args:
        name: The configuration, with or without .toml; without a name they are listed.
        output: File to write, if not NAME in this folder; an existing one is refused.
        list: Say which configurations there are, in a line each.
    """
    with importlib.resources.as_file(importlib.resources.files("jaxscan.data") / "configs") as folder:
        known = {path.stem: path for path in sorted(folder.glob("*.toml"))}
        if list or name is None:
            check_paths({})
            lines = {f"{stem}.toml": _first_sentence(_text(path)) for stem, path in known.items()}
            for file, line in lines.items():
                console().print(f"{file:24} {line}")
            emit_json({"written": None, "configurations": lines})
            return
        chosen = known.get(name.removesuffix(".toml"))
        if chosen is None:
            closest = difflib.get_close_matches(name[:64], known, n=1, cutoff=0.0)[0]
            raise OptionError(
                f"found {name[:64]!r}, expected a configuration that `jaxscan init --list` names; the closest is "
                f'"{closest}.toml".'
            )
        text, target = _text(chosen), Path(chosen.name) if output is None else output
    check_paths({}, {"--output": target})
    if os.path.lexists(target):
        raise OptionError(f"{target}: exists, and may be yours; choose another name with -o, or move it away.")
    disk.write_atomically(target, text.encode())
    console().print(f"written: {target}")
    emit_json({"written": str(target), "configuration": chosen.name})


def _text(path: Path) -> str:
    return disk.read_bounded(path, disk.MEGABYTE, error=ConfigError).decode()


def _first_sentence(text: str) -> str:
    """The first sentence of the comment at the beginning of a configuration."""
    comment = re.match(r"(?:#.*\n)+", text)
    words = " ".join(line.lstrip("# ") for line in comment[0].splitlines()) if comment else ""
    return re.split(r"(?<=\.) ", words, maxsplit=1)[0]


def board(config: ConfigPath, /, *, output: OutputPath, paper: Paper = "A4") -> None:
    """Print a calibration board: `jaxscan board board.toml -o board.pdf --paper A3`.

    In true size, with a ruler to check the print. A board that is larger than the paper goes on several sheets, with
    marks where they are joined.

    Args:
        config: A TOML file with a table [board], such as a configuration for `jaxscan scan`; or a capture.
        output: File to write: .pdf, or .svg, one for each sheet.
        paper: Size of the sheets.
    """
    check_paths({"CONFIG": config}, {"--output": output})
    described = api.load_board(config)
    sheets = api.draw_board(described, output, paper)
    check_paths({"CONFIG": config}, {"--output": sheets.files})
    files = api.write_sheets(sheets)
    out = console()
    out.print(described.describe())
    out.notes(sheets.notes)
    for file in files:
        out.print(f"written: {file}")
    out.print("Print it at 100 %, without fitting to the page, and write what you measure into [board].")
    width, height = (float(length) for length in described.outline()[2] - described.outline()[0])
    emit_json(
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


def simulate(
    config: ConfigPath,
    /,
    *,
    output: OutputPath,
    every: int = 1,
    seed: int | None = None,
) -> None:
    """Render a simulated rig: `jaxscan simulate paper.toml -o captures/paper --every 10`.

    Writes the captures `boards` and `sweep`, the true values `truth.json` and the true cloud `truth.npz`. Only
    comparisons read the truth.

    Args:
        config: Configuration of the rig, its room and its boards (`jaxscan init paper.toml` writes one).
        output: Folder to create.
        every: Render every n-th step of the sweep only.
        seed: Seed of the noise and of the board poses, instead of the seed in the configuration.
    """
    at_least(1, "--every", every)
    at_least(0, "--seed", seed)
    check_paths({"CONFIG": config}, {"--output": output})
    settings = jaxscan.load_simulation(config)
    start = time.perf_counter()
    with progress_bar("Rendering") as progress:
        made = jaxscan.simulate(settings, output, every=every, seed=seed, progress=progress)
    seconds = time.perf_counter() - start
    console().print(f"{made.board_pairs} board pairs and {made.sweep_pairs} sweep pairs in {seconds:.0f} s: {output}")
    emit_json(
        {
            "boards": str(made.boards) if made.board_pairs else None,
            "sweep": str(made.sweep),
            "truth": str(made.truth),
            "true_cloud": str(made.true_cloud),
            "board_pairs": made.board_pairs,
            "sweep_pairs": made.sweep_pairs,
            "seconds_s": seconds,
        },
    )
