"""Progress bars on a terminal; elsewhere nothing is printed."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import final

from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    Task,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
)
from rich.text import Text

from jaxscan.cli.process.signals import leave_behind
from jaxscan.cli.process.terminal import Terminal
from jaxscan.printable import printable


_WITHOUT_BAR = b"\r\x1b[2K\x1b[?25h"
"""Clears the line of the bar, and shows the cursor that rich hides."""


@final
class Bar:
    """A progress callback `(done, total)`, which is told in words what is being done; silent without a display."""

    def __init__(self, bars: Progress | None = None, task: str = "") -> None:
        """A bar of a display."""
        self._bars, self._task = bars, task
        self._number = TaskID(0) if bars is None else bars.add_task(printable(task), total=None)

    def __call__(self, done: int, total: int) -> None:
        """Show how much is done."""
        if self._bars is not None:
            self._bars.update(self._number, completed=done, total=total)

    def doing(self, words: str) -> None:
        """Show what is being done."""
        if self._bars is not None:
            self._bars.update(self._number, description=printable(f"{self._task}: {words}"))


class _Count(ProgressColumn):
    """The number of those done, of all; nothing before all are counted."""

    def render(self, task: Task) -> Text:
        return Text("" if task.total is None else f"{task.completed:.0f}/{task.total:.0f}")


@contextmanager
def progress_bar(task: str) -> Iterator[Bar]:
    """A bar on standard error, as a callback `(done, total)`; without a terminal the callback does nothing."""
    terminal = Terminal(stderr=True)
    if not terminal.is_terminal:
        yield Bar()
        return
    # A thread draws it ten times a second, so spinner and clock move while one step takes long.
    columns = (
        SpinnerColumn("line"),
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        _Count(),
        TimeElapsedColumn(),
    )
    leave_behind(_WITHOUT_BAR)
    try:
        with Progress(*columns, console=terminal.console, transient=True) as bars:
            yield Bar(bars, task)
    finally:
        leave_behind(b"")
