"""`jaxscan project status`: the steps of a project that are done, with their notes, and the others, with the reason."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxscan.cli.output import JsonTarget, check_json, console, emit_json
from jaxscan.cli.paths import check_paths, file_at
from jaxscan.cli.process.terminal import table
from jaxscan.cli.project.plan import ProjectPath, counted, in_words, opened


if TYPE_CHECKING:
    from jaxscan.project import Status


_ORDER = ("failed", "stale", "missing", "done")
_MOST_ROWS = 60
"""Of the table; of more steps, only those that are not done, and so many of them."""


def status(project: ProjectPath = Path("project.toml"), /, *, all: bool = False, json: JsonTarget = None) -> None:
    """Say what is done, stale, failed and missing: `jaxscan project status project.toml`.

    Below the table, each step that is not done has its reason, and each that is done its notes. A product is stale if
    its capture, its calibration, the settings or the code that makes it have changed since, or if a file of it is gone.
    Nothing is computed.

    Args:
        project: The project's file.
        all: List every step, also those that are done.
        json: Write the result as JSON too.
    """
    check_paths(file_at("PROJECT", project), file_at("--json", json))
    check_json(json)
    # Imported here, so that `--help` does not load JAX.
    from jaxscan.project import load_project

    with opened(load_project(project)) as found:
        states = found.states
    out, counts = console(json), counted(states)
    shown = [one for one in states if all or len(states) <= _MOST_ROWS or one.state != "done"]
    # What asks for something comes first.
    shown.sort(key=lambda one: _ORDER.index(one.state))
    listed = shown if all else shown[:_MOST_ROWS]
    if listed:
        out.print(table(f"{project}", ("", "state"), [(one.step.key, one.state) for one in listed]))
    for one in listed:
        if one.why:
            out.print(f"{one.step.key} ({one.state}): {one.why}")
    if len(listed) < len(shown):
        out.print(f"... and {len(shown) - len(listed)} more (--all)")
    for note in found.project.notes:
        out.print(f"note: {note}")
    out.print(in_words(counts))
    if counts["done"] < len(states):
        out.print(f"next: {shlex.join(['jaxscan', 'batch', str(project)])}")
    left_out = list(found.project.notes)
    result = {"counts": counts, "steps": [_as_json(one) for one in states], "left_out": left_out}
    emit_json(json, "project-status", result)


def _as_json(status: "Status") -> dict[str, Any]:
    outputs = list(status.step.outputs)
    return {"step": status.step.key, "state": status.state, "why": status.why, "outputs": outputs}
