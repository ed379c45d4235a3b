"""`jaxscan project init`: the project of what lies in a folder."""

import os
import shlex
from pathlib import Path
from typing import Annotated

import tyro

from jaxscan.cli.output import JsonTarget, check_json, console, emit_json
from jaxscan.cli.paths import check_paths, file_at
from jaxscan.errors import JaxscanError, OptionError


NAME = "project.toml"


def init(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")] = Path(),
    /,
    *,
    json: JsonTarget = None,
) -> None:
    """Write the project of what lies in a folder: `jaxscan project init FOLDER`.

    Looks for captures and calibrations, four folders deep, and writes FOLDER/project.toml; an existing one is refused.

    Args:
        folder: The folder that holds captures and calibrations; without one, this one.
        json: Write the result as JSON too.
    """
    # Imported here, so that `--help` does not load JAX.
    from jaxscan.files.disk import write_atomically
    from jaxscan.project import board_notes, load_project, project_text, steps_of

    target = folder / NAME
    check_paths([], [*file_at("FOLDER", target), *file_at("--json", json)])
    check_json(json)
    if os.path.lexists(target):
        raise OptionError(f"{target}: exists, and may be yours; move it away.")
    if not folder.is_dir():
        raise OptionError(f"{folder}: is no folder.")
    write_atomically(target, project_text(folder).encode(), links="replace")
    try:
        project = load_project(target)
        steps, notes = len(steps_of(project)), [*project.notes, *board_notes(project)]
    except JaxscanError:
        # What is in the way, a name that two captures have say, is mended in the folder; then it is called again.
        target.unlink()
        raise
    out = console(json)
    out.print(f"written: {target} ({len(project.captures)} captures, {steps} steps)")
    for note in notes:
        out.print(f"note: {note}")
    out.print(f"next: {shlex.join(['jaxscan', 'batch', str(target)])}")
    names = [capture.name for capture in project.captures]
    emit_json(json, "project-init", {"project": str(target), "captures": names, "notes": notes})
