"""Progress: a moving bar and the current stage on a terminal; a line after each tenth in a log."""

import math
import time
from collections.abc import Callable, Iterator
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

from jaxscan.cli.paces import pace_of, remember_pace
from jaxscan.cli.signals import leave_behind
from jaxscan.cli.terminal import Terminal
from jaxscan.printable import printable


_WITHOUT_BAR = b"\r\x1b[2K\x1b[?25h"
"""Clears the line of the bar, and shows the cursor that rich hides."""
_BESIDE_BAR = 72
"""Narrower terminals have room for what is being done, but not for a bar and a clock too."""
_TOLD = 0.05
"""Share of its work after which processor time and the clock tell how fast a task is now."""
_BETWEEN_LINES_S = 5.0
"""Shortest time between lines of progress in a log."""


def duration(seconds: float) -> str:
    """A time that is left, in words."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    # Rounding to half minutes would be a third of the shortest times.
    minutes = round(seconds / 30) / 2 if seconds < 600 else float(math.ceil(seconds / 60))
    return f"{minutes:g} min" if minutes < 90 else f"{int(minutes) // 60} h {int(minutes) % 60} min"


@final
class Remaining:
    """How long something still takes, estimated from what was done so far."""

    def __init__(
        self,
        now: Callable[[], float] = time.monotonic,
        *,
        from_first: bool = False,
        pace: float | None = None,
        worked: Callable[[], float] = time.process_time,
    ) -> None:
        """The clock runs from here, or from the first call.

        Args:
            now: The time [s].
            from_first: Start the clock at the first call: the work before it is of another kind.
            pace: Processor time per unit of work in the last run [s].
            worked: Processor time of this one [s].
        """
        self._now, self._worked = now, None if pace is None else Worked(pace, now, worked)
        self._begun: tuple[float, int] | None = None if from_first else (now(), 0)
        self._said = (self._now(), 0)

    def __call__(self, done: int, total: int) -> float | None:
        """Seconds that are left; None where nothing tells."""
        if self._begun is None:
            self._begun = self._now(), done
        if self._worked is not None and (left := self._worked(done, total)) is not None:
            return left
        begun_s, before = self._begun
        return (self._now() - begun_s) / (done - before) * (total - done) if done > before else None

    def line(self, done: int, total: int) -> str | None:
        """A line for a log, after each tenth: about how long it takes; None where there is nothing to say yet."""
        left, (said_s, said) = self(done, total), self._said
        if total <= 0 or left is None or done >= total or self._now() - said_s < _BETWEEN_LINES_S:
            return None
        if 10 * done // total == 10 * said // total:
            return None
        self._said = self._now(), done
        return f"about {duration(left)} left"


@final
class Worked:
    """How long a task still takes, by the processor time that it took before and has taken now.

    A processor that is shared makes a task slower, but takes no more of its time; and that time passes while a long
    stage says nothing.
    """

    def __init__(self, pace: float, now: Callable[[], float], worked: Callable[[], float]) -> None:
        """Begin, with seconds of processor time per unit of work, a clock and that of the processor."""
        self._pace, self._now, self._worked = pace, now, worked
        self._begun = now(), worked()

    def __call__(self, done: int, total: int) -> float | None:
        """Seconds that are left; None as long as nothing tells, and where it takes more than before."""
        wall, used = self._now() - self._begun[0], self._worked() - self._begun[1]
        expected = self._pace * total
        if not _TOLD * expected <= used < expected:
            return None
        # What is skipped, such as stripes that are kept, takes no time.
        return wall / used * min(expected - used, expected * (1 - done / total))


@final
class Shown:
    """The callback of a progress bar, or of lines in a log."""

    def __init__(self, task: str, bars: Progress | None, log: Terminal | None = None, *, brief: bool = False) -> None:
        """Show a task on some bars, or in a log. If brief, what is done now stands in the task's place."""
        self._bars, self._log, self._task, self._brief = bars, log, task, brief
        self._remaining, self._began, self._total = Remaining(pace=pace_of(task)), time.process_time(), 0
        self._number = TaskID(0) if bars is None else bars.add_task(printable(task), total=None, ends=None)

    def __call__(self, done: int, total: int) -> None:
        """Show that `done` of `total` are done."""
        self._total = total
        if self._bars is not None:
            left = self._remaining(done, total) if 10 * done >= total > done else None
            ends = None if left is None else time.monotonic() + left
            self._bars.update(self._number, completed=done, total=total, ends=ends)
        elif self._log is not None and (line := self._remaining.line(done, total)):
            self._log.print(f"{self._task}: {100 * done // total} %, {line}")

    def ended(self) -> None:
        """The task is done: the next one of its kind is estimated by it."""
        if self._total > 0:
            remember_pace(self._task, (time.process_time() - self._began) / self._total)

    def doing(self, words: str) -> None:
        """Show the current stage."""
        if self._bars is not None:
            description = words if self._brief else f"{self._task}: {words}"
            self._bars.update(self._number, description=printable(description))


@final
class _Count(ProgressColumn):
    """How much of the work is done; empty as long as that is not known."""

    def render(self, task: Task) -> Text:
        return Text("" if not task.total else f"{100 * int(task.completed) // int(task.total)} %")


@final
class _Left(ProgressColumn):
    """The time that is left, which becomes less while a long stage says nothing."""

    def render(self, task: Task) -> Text:
        ends = task.fields["ends"]
        left = 0.0 if ends is None else ends - time.monotonic()
        return Text(f"about {duration(left)} left" if left > 0 else "")


@contextmanager
def progress_bar(task: str) -> Iterator[Shown]:
    """A bar on standard error, as a callback `(done, total)`; without a terminal lines with the time that is left.

    A wheel turns and the seconds count during a long step; the callback's `doing` shows the current stage.
    """
    terminal = Terminal(stderr=True)
    if not terminal.is_terminal:
        yield (shown := Shown(task, None, terminal))
        shown.ended()
        return
    text = TextColumn("{task.description}", markup=False)
    brief = terminal.console.width < _BESIDE_BAR
    wide = (SpinnerColumn("line"), text, BarColumn(), _Count(), TimeElapsedColumn(), _Left())
    columns = (SpinnerColumn("line"), text, _Count()) if brief else wide
    leave_behind(_WITHOUT_BAR)
    try:
        with Progress(*columns, console=terminal.console, transient=True) as bars:
            yield (shown := Shown(task, bars, brief=brief))
        shown.ended()
    finally:
        leave_behind(b"")
