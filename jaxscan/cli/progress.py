"""Progress bars on a terminal; elsewhere nothing is printed."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from jaxscan.cli.process.signals import leave_behind
from jaxscan.cli.process.terminal import Terminal
from jaxscan.printable import printable


_WITHOUT_BAR = b"\r\x1b[2K\x1b[?25h"
"""Clears the line of the bar, and shows the cursor that rich hides."""


@contextmanager
def progress_bar(task: str) -> Iterator[Callable[[int, int], None]]:
    """A bar on standard error, as a callback `(done, total)`; without a terminal the callback does nothing."""
    terminal = Terminal(stderr=True)
    if not terminal.is_terminal:
        yield lambda done, total: None
        return
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    leave_behind(_WITHOUT_BAR)
    try:
        with Progress(*columns, console=terminal.console, transient=True) as bars:
            number = bars.add_task(printable(task), total=None)
            yield lambda done, total: bars.update(number, completed=done, total=total)
    finally:
        leave_behind(b"")
