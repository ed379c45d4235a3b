"""Progress on a terminal: a moving bar and the current stage. Elsewhere nothing is printed."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, final

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

from jaxscan.cli.signals import leave_behind
from jaxscan.cli.terminal import Terminal
from jaxscan.printable import printable


_WITHOUT_BAR = b"\r\x1b[2K\x1b[?25h"
"""Clears the line of the bar, and shows the cursor that rich hides."""
_BESIDE_BAR = 72
"""Narrower terminals have room for what is being done, but not for a bar and a clock too."""
LOWERED = "/jax/core/compile/jaxpr_to_mlir_module_duration"
COMPILED = "/jax/core/compile/backend_compile_duration"
"""JAX reports these at the start and at the end of compiling a function, in the thread that compiles it."""


@final
class Shown:
    """The callback of a progress bar."""

    def __init__(self, task: str, bars: Progress | None, *, brief: bool = False) -> None:
        """Show a task on some bars; None shows nothing. If brief, what is done now stands in the task's place."""
        self._brief = brief
        self._bars, self._task, self._doing = bars, task, ""
        self._compiling: set[int] = set()
        self._lock = threading.Lock()
        self._number = TaskID(0) if bars is None else bars.add_task(printable(task), total=None)

    def __call__(self, done: int, total: int) -> None:
        """Show that `done` of `total` are done."""
        if self._bars is not None:
            self._bars.update(self._number, completed=done, total=total)

    def doing(self, words: str) -> None:
        """Show the current stage."""
        self._doing = words
        self._describe()

    def heard(self, event: str, duration_secs: float, **_: Any) -> None:
        """Show that some thread compiles; a listener of `jax.monitoring`."""
        if event not in (LOWERED, COMPILED):
            return
        with self._lock:
            if event == LOWERED:
                self._compiling.add(threading.get_ident())
            else:
                self._compiling.discard(threading.get_ident())
        self._describe()

    def _describe(self) -> None:
        if self._bars is None:
            return
        stage = [words for words in (self._doing, "compiling" if self._compiling else "") if words]
        task = [] if self._brief and stage else [self._task]
        description = ": ".join([*task, *([", ".join(stage)] if stage else [])])
        self._bars.update(self._number, description=printable(description))


@final
class _Count(ProgressColumn):
    """How many of how many; empty as long as that is not known."""

    def render(self, task: Task) -> Text:
        return Text("" if task.total is None else f"{int(task.completed)}/{int(task.total)}")


@contextmanager
def progress_bar(task: str) -> Iterator[Shown]:
    """A bar on standard error, as a callback `(done, total)`; without a terminal the callback does nothing.

    A wheel turns and the seconds count during a long step, and "compiling" is shown while a function is compiled; the
    callback's `doing` shows any other stage.
    """
    terminal = Terminal(stderr=True)
    if not terminal.is_terminal:
        yield Shown(task, None)
        return
    text = TextColumn("{task.description}", markup=False)
    brief = terminal.console.width < _BESIDE_BAR
    wide = (SpinnerColumn("line"), text, BarColumn(), _Count(), TimeElapsedColumn())
    columns = (SpinnerColumn("line"), text, _Count()) if brief else wide
    leave_behind(_WITHOUT_BAR)
    try:
        with Progress(*columns, console=terminal.console, transient=True) as bars:
            shown = Shown(task, bars, brief=brief)
            # Imported here: where nobody looks, nothing of JAX is needed.
            import jax.monitoring

            jax.monitoring.register_event_duration_secs_listener(shown.heard)
            try:
                yield shown
            finally:
                jax.monitoring.unregister_event_duration_listener(shown.heard)
    finally:
        leave_behind(b"")
