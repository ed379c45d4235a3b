"""Asks a person to place the calibration board, and says at once whether a pose will do."""

import os
import select
import shlex
import subprocess
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING

from rich.console import Console

from jaxscan.errors import OptionError


if TYPE_CHECKING:
    from scanrig.checks.guide import Coverage, Guide
    from scanrig.session import PlacementRequest


COMMAND_S = 600.0
"""Longest time that a command may take to place the board."""
_TICK_S = 0.2
KEYS = "Enter: take it · s: enough of these · q: enough of all"


class Lines:
    """Lines of standard input, terminal or not, awaited in small pieces so that a signal ends the wait."""

    def __init__(self, file: int | None = None) -> None:
        """Reads a file descriptor; standard input by default."""
        self._file = sys.stdin.fileno() if file is None else file
        self._waiting = b""
        self.ended = False
        """Whether there is no more input."""

    def forget(self) -> None:
        """Drop what was typed before it was asked for; a file or a pipe, which asks for nothing, is left alone."""
        if not os.isatty(self._file):
            return
        self._waiting = b""
        while not self.ended and select.select([self._file], [], [], 0.0)[0]:
            try:
                self.ended = not os.read(self._file, 4096)
            except OSError:
                self.ended = True

    def next(self, should_stop: Callable[[], bool]) -> str | None:
        """The next line without its end; None where the input ended or the wait was to stop."""
        while b"\n" not in self._waiting and not self.ended:
            if should_stop():
                return None
            if not select.select([self._file], [], [], _TICK_S)[0]:
                continue
            try:
                data = os.read(self._file, 4096)
            except OSError:
                data = b""  # A terminal that hung up, whose signal is still on its way.
            self.ended = not data
            self._waiting += data
        if b"\n" not in self._waiting:
            return None
        line, self._waiting = self._waiting.split(b"\n", 1)
        return line.decode(errors="replace").strip()


class TerminalOperator:
    """An `Operator` of `scanrig.session.run`: a person at the terminal."""

    def __init__(
        self,
        guide: "Guide",
        lines: Lines,
        *,
        should_stop: Callable[[], bool],
        console: Console,
    ) -> None:
        """Asks by `console` and hears by `lines`.

        Args:
            guide: Knows what is missing.
            lines: What the person types.
            should_stop: Whether the session is to end.
            console: What the person reads.
        """
        self._guide, self._lines = guide, lines
        self._should_stop, self._console = should_stop, console
        self._enough = False
        self.placing: PlacementRequest | None = None
        """What the board is placed for now."""

    def place(self, request: "PlacementRequest") -> bool:
        """Ask until the board is where the camera sees it, or it is enough."""
        if self._enough:
            return False
        self.placing = request
        what = "Pose" if request.kind == "free" else "Standing place"
        self._console.print(f"\n{what} {request.number + 1} of {request.total}")
        for sentence in self._guide.advice(request.kind):
            self._console.print(f"  → {sentence}")
        while True:
            # An Enter of impatience would take the board on its way to the next pose.
            self._lines.forget()
            self._console.print(f"  {KEYS}", style="dim")
            answer = self._lines.next(self._should_stop)
            if answer is None:
                # No more input is no consent: what is there can be gone on with.
                return False
            if answer.lower() in ("s", "q"):
                self._enough = answer.lower() == "q"
                return False
            if answer:
                self._console.print(f"  {answer!r} is none of these.")
                continue
            self._console.print("  looking …", style="dim")
            seen = self._guide.look(None, request.look())
            if seen.view is not None:
                return True
            self._console.print(f"  Not taken: {seen.problem}.")


class CommandOperator:
    """An `Operator` that runs a command with the pose's number: a robot, or the bench."""

    def __init__(self, command: str, *, free_views: int, console: Console) -> None:
        """The command, split as a shell would split it, but run without one.

        Raises:
            OptionError: If it cannot be split, or is empty.
        """
        try:
            self._words = shlex.split(command)
        except ValueError as problem:
            raise OptionError(f"--place-command: found {command!r}, expected a command: {problem}.") from problem
        if not self._words:
            raise OptionError("--place-command: found nothing, expected a command.")
        self._free_views, self._console = free_views, console
        self.placing: PlacementRequest | None = None

    def place(self, request: "PlacementRequest") -> bool:
        """Run the command: free views are numbered from 0, standing places follow them."""
        self.placing = request
        number = request.number + (0 if request.kind == "free" else self._free_views)
        what = "pose" if request.kind == "free" else "standing place"
        self._console.print(f"{what} {request.number + 1} of {request.total}: {self._words[0]} … {number}")
        try:
            done = subprocess.run(
                [*self._words, str(number)], stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=COMMAND_S
            )
        except (OSError, subprocess.TimeoutExpired) as problem:
            raise OptionError(f"--place-command: {self._words[0]}: {problem}.") from problem
        if done.returncode:
            says = (done.stderr or done.stdout).strip().splitlines()
            why = f": {says[-1]}" if says else ""
            raise OptionError(f"--place-command: {self._words[0]} {number} ended with {done.returncode}{why}.")
        return True


def coverage_text(seen: "Coverage", *, laser: bool = True) -> str:
    """What the poses so far have covered, for a terminal: the image's cells with corners, and the rest beside them."""
    from jaxscan.geometry.coverage import MIN_IN_CELL, MIN_TILT_DEG

    cells = [" ".join("■" if count >= MIN_IN_CELL else "·" for count in row) for row in seen.corners]
    sides = f", towards {seen.tilt_sides} of 4 sides" if seen.tilted else ""
    facts = [f"{seen.tilted} of {seen.views} tilted by {MIN_TILT_DEG:.0f}° or more{sides}"]
    depth = "no distance yet" if seen.depth_m is None else f"{seen.depth_m[0]:.2f} to {seen.depth_m[1]:.2f} m away"
    facts.append(f"{depth} (about)")
    facts.append(f"laser {seen.laser} across {seen.crossed} of {seen.lit}".replace("  ", " ") if laser else "")
    return "\n".join(f"    {row}   {fact}".rstrip() for row, fact in zip(cells, facts, strict=True))
