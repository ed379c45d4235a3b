"""Shows the progress of a scan: records, remaining time, brightness, and one line for each event."""

import math
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from jaxscan.cli.process.terminal import Terminal


if TYPE_CHECKING:
    from jaxscan.cli.scanning.live import LiveStatus


_READABLE_S = 0.25


class ScanDisplay:
    """Sentences on standard error; with a progress bar if that is a terminal."""

    def __init__(self, live: "Callable[[], LiveStatus] | None" = None, *, total: int | None = None) -> None:
        """Prepare the display; it is shown inside `with`.

        Args:
            live: Gives the status of the live cloud.
            total: Records of the scan; None for no bar.
        """
        self.retakes = 0
        self._live = live
        self._console = Terminal(stderr=True)
        self._fields: dict[str, Any] = {"angle": "   home", "peak": "", "retakes": "", "points": ""}
        self._problem = ""
        self._read_s = -math.inf
        self._bars: Progress | None = None
        if total is not None and self._console.is_terminal:
            columns = (
                TextColumn("{task.fields[angle]}", markup=False),
                BarColumn(),
                MofNCompleteColumn(),
                TimeRemainingColumn(),
                TextColumn("{task.fields[peak]}{task.fields[retakes]}{task.fields[points]}", markup=False),
            )
            self._bars = Progress(*columns, console=self._console.console, transient=True)
            self._task = self._bars.add_task("", total=total, **self._fields)

    def __enter__(self) -> "ScanDisplay":
        if self._bars is not None:
            self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bars is not None:
            self._bars.stop()

    def pair(self, angle: float, peak_dn: Callable[[], float]) -> None:
        """Show a pair that was taken: the table's angle [rad] and the peak level of the laser's line [DN].

        The table waits meanwhile, so the peak is asked for only as often as people can read it.
        """
        self._fields["angle"] = f"{math.degrees(angle):7.2f}°"
        if self._bars is not None and time.monotonic() - self._read_s >= _READABLE_S:
            self._read_s = time.monotonic()
            self._fields["peak"] = f"line {peak_dn():3.0f} DN"
        self._fields["retakes"] = f", {self.retakes} retaken" if self.retakes else ""
        if self._live is not None:
            status = self._live()
            self._fields["points"] = f", {status.points} points"
            if status.problem and status.problem != self._problem:
                self._problem = status.problem
                self.say(f"the live cloud stopped: {status.problem}; the scan goes on")

    def progress(self, done: int, planned: int) -> None:
        """Show the number of records on the disk."""
        if self._bars is not None:
            self._bars.update(self._task, completed=done, total=planned, **self._fields)

    def say(self, sentence: str) -> None:
        """Print a sentence on an event."""
        if " is taken again: " in sentence:
            self.retakes += 1
        self._console.print(sentence)
