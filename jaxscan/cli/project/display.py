"""The display of a batch while it goes on: all its steps, and each that is at work."""

import contextlib
import threading
from collections.abc import Iterator
from typing import TYPE_CHECKING, final

from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn

from jaxscan.cli.process.signals import leave_behind
from jaxscan.cli.process.terminal import Terminal
from jaxscan.printable import printable


if TYPE_CHECKING:
    from jaxscan.project import Row


_BELOW_BARS = b"\n\x1b[?25h"
"""Begins a line, and shows the cursor that rich hides."""
_MOST_LINES = 8
"""Steps that have a line of their own."""


@final
class BatchDisplay:
    """Lines for steps that fail, and bars for those at work; without a terminal a line for each that is done."""

    def __init__(self, out: Terminal, bars: Progress | None, steps: int) -> None:
        """Args: where lines go, bars that are shown or None, and the number of steps."""
        self._out, self._bars, self._steps = out, bars, steps
        self._lock = threading.Lock()
        self._tasks: dict[str, TaskID] = {}
        self._finished = set[str]()
        self._all = None if bars is None else bars.add_task("all steps", total=steps)

    def working(self, key: str, done: int, total: int) -> None:
        """How far a step is; called from another thread."""
        if self._bars is None:
            return
        with self._lock:
            if key not in self._tasks:
                # News of a step may come after its end.
                if key in self._finished or len(self._tasks) >= _MOST_LINES:
                    return
                self._tasks[key] = self._bars.add_task(printable(key), total=total)
            self._bars.update(self._tasks[key], completed=done, total=total)

    def finished(self, row: "Row") -> None:
        """A step was done, or failed; a failure is a line."""
        if self._bars is not None and self._all is not None:
            with self._lock:
                self._finished.add(row.key)
                task = self._tasks.pop(row.key, None)
                if task is not None:
                    self._bars.remove_task(task)
                self._bars.advance(self._all)
        if row.state == "failed" and self._bars is not None:
            # Above the bars, which a line on another stream would run into.
            self._bars.console.print(printable(f"failed: {row.key}: {row.message}"), style="red")
        elif row.state == "failed":
            self._out.print(f"failed: {row.key}: {row.message}", style="red")
        elif self._bars is None:
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
