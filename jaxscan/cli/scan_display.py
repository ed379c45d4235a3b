"""The plan of a scan, shown before it begins, and its progress: records, time that is left, one line for each event."""

import itertools
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from jaxscan.cli.progress import Remaining, duration
from jaxscan.cli.terminal import Terminal
from jaxscan.files import capture as capture_files


if TYPE_CHECKING:
    from scanrig.config import RigConfig

    from jaxscan.cli.live import LiveStatus
    from jaxscan.files.capture import CaptureHeader


_READABLE_S = 0.25
_POSE = 4
"""A new pose of the board takes about as long as this many records: more by hand, less on the bench."""


class ScanDisplay:
    """Sentences on standard error; with a progress bar if that is a terminal."""

    def __init__(
        self,
        live: "Callable[[], LiveStatus] | None" = None,
        *,
        total: int | None = None,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        """Prepare the display; it is shown inside `with`.

        Args:
            live: Gives the status of the live cloud.
            total: Records of the scan; None for no bar.
            now: The time [s].
        """
        self.retakes = 0
        self._live = live
        self._console = Terminal(stderr=True)
        self._fields: dict[str, Any] = {"angle": "   home", "peak": "", "retakes": "", "points": ""}
        self._problem = ""
        self._read_s = -math.inf
        # The first record waits for the table to be found.
        self._remaining = Remaining(now, from_first=True)
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

        The table waits meanwhile, so the peak is read only as often as people can follow it.
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
        """Show the number of records on the disk; where nobody watches, in a line after each tenth."""
        if self._bars is not None:
            self._bars.update(self._task, completed=done, total=planned, **self._fields)
            return
        if line := self._remaining.line(done, planned):
            self._console.print(f"{done} of {planned} records, {line}{self._fields['retakes']}")

    def say(self, sentence: str) -> None:
        """Print a sentence on an event."""
        if " is taken again: " in sentence:
            self.retakes += 1
        self._console.print(sentence)


class ScanPlan(NamedTuple):
    """The records of a scan, and its need of time and disk space."""

    records: int
    targets: str
    """The targets in words."""
    seconds: float
    bytes: int
    notes: tuple[str, ...] = ()
    work: tuple[int, ...] = ()
    """For boards: the part of the work that is done after each number of records, from 0. A board that is brought into
    another pose takes longer than a record."""

    @classmethod
    def of(cls, rig: "RigConfig", *, boards: bool) -> "ScanPlan":
        """The plan of a sweep, or of a capture of boards.

        Raises:
            ConfigError: If the table cannot reach a target.
        """
        from scanrig.session.plan import estimate, placed_targets, placement_positions, plan_sweep

        if not boards:
            targets, notes = plan_sweep(rig)
            needed = estimate(rig, [target.position for target in targets])
            step = abs(rig.sweep.turn_deg) / rig.sweep.steps
            steps = f"{rig.sweep.steps * rig.sweep.turns} steps of {step:.4g}°{_each(rig)}"
            return cls(len(targets), steps, needed.seconds, needed.bytes, notes)
        views = rig.calibration
        free, stands = placed_targets(rig, placement_positions(rig))
        records = [target.position for one in (*free, *stands) for target in one]
        work = [_POSE * (number == 0) + 1 for one in (*free, *stands) for number in range(len(one))]
        needed = estimate(rig, records)
        places = (
            f"{views.free_views} poses of the board, then {views.placements} places where it stands while the table "
            f"turns to {len(views.angles_deg)} angles{_each(rig)}"
        )
        return cls(
            len(records), places, needed.seconds, needed.bytes, work=tuple(itertools.accumulate(work, initial=0))
        )

    def show(self, out: Terminal, rig: "RigConfig", folder: Path) -> None:
        """Print the plan."""
        from scanrig.recording import readable

        out.print(f"{self.targets}: {2 * self.records} images of {rig.camera.width} x {rig.camera.height} to {folder}")
        turn = f"{rig.microsteps_per_turn} microsteps per turn"
        out.print(f"about {duration(self.seconds)}, up to {readable(self.bytes)}, {turn}")
        out.notes(self.notes)


def _each(rig: "RigConfig") -> str:
    names = " and ".join(laser.name for laser in rig.laser)
    return f", each with the lasers {names}" if len(rig.laser) > 1 else ""


def sweep_header(rig: "RigConfig") -> "CaptureHeader":
    """The header that the capture is going to have, as far as it describes the frames."""
    turntable = capture_files.TurntableTable(carries=rig.turntable.carries)
    return capture_files.CaptureHeader(
        kind="sweep", camera=rig.camera.table, turntable=turntable, laser=tuple(one.table for one in rig.laser)
    )
