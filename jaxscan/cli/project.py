"""`jaxscan project` and `batch`: many captures as one project, where it stands, and what makes the rest."""

import contextlib
import os
import shlex
import time
from collections import Counter
from collections.abc import Iterator, Sequence, Sized
from pathlib import Path
from typing import Annotated, Any, final

from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn

from jaxscan import project as projects
from jaxscan.cli.help import Arg
from jaxscan.cli.options import at_least, check_paths
from jaxscan.cli.signals import leave_behind
from jaxscan.cli.terminal import Terminal, console, emit_json, table
from jaxscan.errors import BatchError, JaxscanError, MeasurementError, OptionError
from jaxscan.files import disk
from jaxscan.printable import printable


ProjectPath = Annotated[Path, Arg("PROJECT")]
STATES = ("done", "stale", "failed", "missing")


def project() -> None:
    """Many captures as one project: `jaxscan project init FOLDER` (`jaxscan project --help`)."""


def counted(states: "Sequence[projects.Status]") -> dict[str, int]:
    """How many steps are in each state."""
    found = Counter[str](status.state for status in states)
    return {state: found[state] for state in STATES}


def in_words(counts: dict[str, int]) -> str:
    """The counts of states that there are, in a line."""
    return ", ".join(f"{count} {state}" for state, count in counts.items() if count) or "nothing to do"


NAME = "project.toml"


def init(
    folder: Annotated[Path, Arg("FOLDER")] = Path(),
    /,
) -> None:
    """Write the project of what lies in a folder: `jaxscan project init FOLDER`.

    Looks for captures and calibrations, four folders deep, and writes FOLDER/project.toml; an existing one is refused.

    Args:
        folder: The folder that holds captures and calibrations; without one, this one.
    """
    target = folder / NAME
    check_paths({}, {"FOLDER": target})
    if os.path.lexists(target):
        raise OptionError(f"{target}: exists, and may be yours; move it away.")
    if not folder.is_dir():
        raise OptionError(f"{folder}: is no folder.")
    disk.write_atomically(target, projects.project_text(folder).encode(), links="replace")
    try:
        project = projects.load_project(target)
        steps, notes = len(projects.steps_of(project)), [*project.notes, *projects.board_notes(project)]
    except JaxscanError:
        # Conflicts, such as two captures of one name, are for the user to solve in the folder.
        target.unlink()
        raise
    out = console()
    out.print(f"written: {target} ({len(project.captures)} captures, {steps} steps)")
    out.notes(notes)
    out.print(f"next: {shlex.join(['jaxscan', 'batch', str(target)])}")
    names = [capture.name for capture in project.captures]
    emit_json({"project": str(target), "captures": names, "notes": notes})


_ORDER = ("failed", "stale", "missing", "done")
_MOST_ROWS = 60
"""Most rows of the table; where there are more steps, only those that are not done are listed."""


def status(project: ProjectPath = Path("project.toml"), /, *, all: bool = False) -> None:
    """Say what is done, stale, failed and missing: `jaxscan project status project.toml`.

    Below the table, each step that is not done has its reason, and each that is done its notes. A product is stale if
    its capture, its calibration, the settings or the code that makes it have changed since, or if a file of it is gone.
    Nothing is computed.

    Args:
        project: The project's file.
        all: List every step, also those that are done.
    """
    check_paths({"PROJECT": project})
    with projects.opened(projects.load_project(project)) as found:
        states = found.states
    out, counts = console(), counted(states)
    shown = [one for one in states if all or len(states) <= _MOST_ROWS or one.state != "done"]
    # Rows that need attention come first.
    shown.sort(key=lambda one: _ORDER.index(one.state))
    listed = shown if all else shown[:_MOST_ROWS]
    if listed:
        out.print(table(f"{project}", ("", "state"), [(one.step.key, one.state) for one in listed]))
    for one in listed:
        if one.why:
            out.print(f"{one.step.key} ({one.state}): {one.why}")
    if len(listed) < len(shown):
        out.print(f"... and {len(shown) - len(listed)} more (--all)")
    out.notes(found.project.notes)
    out.print(in_words(counts))
    if counts["done"] < len(states):
        out.print(f"next: {shlex.join(['jaxscan', 'batch', str(project)])}")
    left_out = list(found.project.notes)
    result = {"counts": counts, "steps": [_as_json(one) for one in states], "left_out": left_out}
    emit_json(result)


def _as_json(status: "projects.Status") -> dict[str, Any]:
    outputs = list(status.step.outputs)
    return {"step": status.step.key, "state": status.state, "why": status.why, "outputs": outputs}


def compare(
    first: Annotated[Path, Arg("FIRST")],
    second: Annotated[Path, Arg("SECOND")],
    /,
) -> None:
    """Lengths of two epochs or two versions: `jaxscan project compare old/project.toml new/project.toml`.

    Captures with the same name are compared by their measures. Different captures: a length has changed if it differs
    by three standard deviations. The same capture gives the same points, so there a tenth of the length's noise is a
    change already, made by the code, the settings or the calibration. The exit code is 1 if a length has changed, or
    if the second has it no more.

    Args:
        first: The project's file of the first epoch or version.
        second: That of the second.
    """
    check_paths({"FIRST": first, "SECOND": second})
    found = projects.compare_projects(projects.load_project(first), projects.load_project(second))
    out = console()
    columns = ("", "first m", "second m", "difference mm", "sigma mm", "")
    out.print(table(f"{first} and {second}", columns, [_row(one) for one in found.lengths]))
    if found.stale:
        out.print(f"stale in {second}, so compared as they were made: {', '.join(found.stale)}")
    only_first, only_second = (*found.only_first, *found.lost), (*found.only_second, *found.gained)
    for names, path in ((only_first, first), (only_second, second)):
        if names:
            out.print(f"only in {path}: {', '.join(names)}")
    result = found._asdict() | {
        "lengths": [one._asdict() | {"difference_m": one.difference_m} for one in found.lengths]
    }
    emit_json(result)
    changes = _changes(found)
    if changes:
        raise MeasurementError(f"{' and '.join(changes)}.")
    out.print(f"{len(found.lengths)} lengths, none has changed")


def _changes(found: "projects.Comparison") -> list[str]:
    """Sentences on lengths that have changed, and on those that are lost."""
    changes = []
    if found.moved:
        worst = max(found.moved, key=lambda one: abs(one.difference_m))
        changes.append(
            f"{len(found.moved)} of {len(found.lengths)} lengths have changed, {worst.capture} {worst.name} most: by "
            f"{1e3 * worst.difference_m:+.3f} mm"
        )
    if found.lost:
        number = len(found.lost)
        changes.append(f"{number} length{' is' if number == 1 else 's are'} lost: {', '.join(found.lost)}")
    return changes


def _row(one: "projects.LengthChange") -> tuple[str, ...]:
    sigma = "same capture" if one.same_capture else f"{1e3 * one.sigma_m:.2f}"
    name, difference = f"{one.capture} {one.name}", f"{1e3 * one.difference_m:+.3f}"
    return name, f"{one.first_m:.4f}", f"{one.second_m:.4f}", difference, sigma, "changed" if one.moved else ""


def batch(
    project: ProjectPath = Path("project.toml"),
    /,
    *,
    workers: int | None = None,
    output: Path | None = None,
) -> None:
    """Make what a project lacks: `jaxscan batch project.toml`.

    Makes what is missing or stale, and nothing else, on the cores of this machine. A capture that fails is reported in
    a line and stops no other; then the exit code is 1. Ended in the middle and called again, it goes on where it was.

    Args:
        project: The project's file.
        workers: Number of captures at a time, each in a process of its own; without, one for each core, as far as
            memory reaches.
        output: Folder of the products, as the project's file has it: needed once where that lies outside of the
            project's folder.
    """
    check_paths({"PROJECT": project})
    at_least(1, "--workers", workers)
    out, start = console(), time.perf_counter()
    wanted = projects.load_project(project)
    with projects.claimed(wanted, output), projects.opened(wanted, write=True) as found:
        counts = counted(found.states)
        out.print(f"{_many(wanted.captures, 'capture')}, {_many(found.states, 'step')}: {in_words(counts)}")
        out.notes(wanted.notes)
        todo = [one for one in found.states if one.state != "done"]
        report = projects.Report((), {})
        if todo:
            with batch_display(out, len(todo)) as display:
                count = workers or projects.default_workers()
                report = projects.run_batch(todo, wanted.output, found.catalogue, display, workers=count)
    seconds = time.perf_counter() - start
    done = [row for row in report.rows if row.state == "done"]
    failed = {row.key: row.message for row in report.rows if row.state == "failed"}
    notes = {row.key: row.message for row in done if row.message}
    if done:
        out.print(f"{_many(done, 'step')} done in {seconds:.0f} s, in {wanted.output}")
    if notes:
        command = shlex.join(["jaxscan", "project", "status", "--all", str(project)])
        out.print(f"notes on {_many(notes, 'step')}: {command}")
    result = {"done": [row.key for row in done], "failed": failed, "not_begun": dict(report.left), "notes": notes}
    about = {"output": str(wanted.output), "seconds_s": seconds, "left_out": list(wanted.notes)}
    emit_json(result | about)
    if failed:
        again = shlex.join(["jaxscan", "batch", str(project)])
        behind = _many(report.left, "step")
        raise BatchError(
            f"{_many(failed, 'step')} failed, {behind} behind not begun; mend what failed and call again: {again}"
        )


def _many(listed: Sized, name: str) -> str:
    return f"{len(listed)} {name}{'' if len(listed) == 1 else 's'}"


_BELOW_BARS = b"\n\x1b[?25h"
"""Begins a line, and shows the cursor that rich hides."""
_MOST_LINES = 8
"""Steps that have a line of their own."""


@final
class BatchDisplay:
    """Lines for steps that fail, and bars for those at work; without a terminal a line for each that is done."""

    def __init__(self, out: Terminal, bars: Progress | None, steps: int) -> None:
        """Print lines to `out`, and show so many steps on `bars`, if there are any."""
        self._out, self._bars = out, bars
        self._tasks: dict[str, TaskID] = {}
        self._all = None if bars is None else bars.add_task("all steps", total=steps)

    def working(self, key: str, done: int, total: int) -> None:
        """How far a step is."""
        if self._bars is None or (key not in self._tasks and len(self._tasks) >= _MOST_LINES):
            return
        if key not in self._tasks:
            self._tasks[key] = self._bars.add_task(printable(key), total=total)
        self._bars.update(self._tasks[key], completed=done, total=total)

    def finished(self, row: "projects.Row") -> None:
        """A step was done, or failed; a failure is a line."""
        failed = f"failed: {row.key}: {row.message}"
        if self._bars is not None and self._all is not None:
            if (task := self._tasks.pop(row.key, None)) is not None:
                self._bars.remove_task(task)
            self._bars.advance(self._all)
            if row.state == "failed":
                # Above the bars, which a line on another stream would run into.
                self._bars.console.print(printable(failed), style="red")
        elif row.state == "failed":
            self._out.print(failed, style="red")
        else:
            self._out.print(f"done: {row.key} ({row.seconds:.1f} s)")


@contextlib.contextmanager
def batch_display(out: Terminal, steps: int) -> Iterator[BatchDisplay]:
    """A display for so many steps; its bars are on standard error, and only on a terminal."""
    terminal = Terminal(stderr=True)
    if not terminal.is_terminal:
        yield BatchDisplay(out, None, steps)
        return
    text = TextColumn("{task.description}", markup=False)
    columns = (SpinnerColumn("line"), text, BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=terminal.console, transient=True) as bars:
        leave_behind(_BELOW_BARS)
        try:
            yield BatchDisplay(out, bars, steps)
        finally:
            leave_behind(b"")
