"""What a person sees while the rig scans: how far, how long, how bright; and what happened, a line each."""

import math
from collections.abc import Callable
from types import TracebackType
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from jaxscan.cli.scanning.live import LiveStatus


class ScanDisplay:
    """A bar on standard error where that is a terminal; sentences in any case."""

    def __init__(self, live: Callable[[], LiveStatus] | None = None, *, total: int | None = None) -> None:
        """Nothing is shown before `with`.

        Args:
            live: Says what the live cloud has.
            total: Records of the scan; None for no bar.
        """
        self.retakes = 0
        self._live = live
        self._console = Console(stderr=True, highlight=False, markup=False, soft_wrap=True)
        self._fields: dict[str, Any] = {"angle": "   home", "peak": "", "retakes": "", "points": ""}
        self._problem = ""
        self._bars: Progress | None = None
        if total is not None and self._console.is_terminal:
            columns = (
                TextColumn("{task.fields[angle]}"),
                BarColumn(),
                MofNCompleteColumn(),
                TimeRemainingColumn(),
                TextColumn("{task.fields[peak]}{task.fields[retakes]}{task.fields[points]}"),
            )
            self._bars = Progress(*columns, console=self._console, transient=True)
            self._task = self._bars.add_task("", total=total, **self._fields)

    def __enter__(self) -> "ScanDisplay":
        if self._bars is not None:
            self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bars is not None:
            self._bars.stop()

    def pair(self, angle: float, peak_dn: float) -> None:
        """A pair was taken, at an angle [rad], of a line that reaches a level [DN]."""
        self._fields["angle"] = f"{math.degrees(angle):7.2f}°"
        self._fields["peak"] = f"line {peak_dn:3.0f} DN"
        self._fields["retakes"] = f", {self.retakes} retaken" if self.retakes else ""
        if self._live is not None:
            status = self._live()
            self._fields["points"] = f", {status.points} points"
            if status.problem and status.problem != self._problem:
                self._problem = status.problem
                self.say(f"the live cloud stopped: {status.problem}; the scan goes on")

    def progress(self, done: int, planned: int) -> None:
        """So many records are on the disk."""
        if self._bars is not None:
            self._bars.update(self._task, completed=done, total=planned, **self._fields)

    def say(self, sentence: str) -> None:
        """Something happened that a person should know."""
        if sentence.startswith("retake:"):
            self.retakes += 1
        (self._console if self._bars is None else self._bars.console).print(sentence)
