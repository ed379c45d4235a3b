"""`jaxscan scan --boards`: a person or a command places the calibration board, and each pose is checked at once."""

import math
import os
import select
import shlex
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jaxscan import api
from jaxscan.cli.scan_display import ScanDisplay
from jaxscan.cli.terminal import Terminal
from jaxscan.errors import OptionError
from jaxscan.stripes import FrameFormat, LaserLine


if TYPE_CHECKING:
    from scanrig.checks.guide import Coverage, Guide
    from scanrig.config import RigConfig
    from scanrig.session import Devices, PlacementRequest, SessionResult


def scan_boards(
    rig: "RigConfig",
    folder: Path,
    resume: bool,
    devices: "Devices",
    interrupted: Callable[[], bool],
    place_command: str | None,
    out: Terminal,
) -> "SessionResult":
    """Take a capture of the board, which a person or a command places."""
    from scanrig.session import Hooks, run_calibration

    guide, lines = make_guide(rig), None
    named = [f"{one.name} " for one in rig.laser] if len(rig.laser) > 1 else [""]
    operator: TerminalOperator | CommandOperator
    if place_command is None:
        lines = Lines()
        operator = TerminalOperator(guide, lines, should_stop=interrupted, console=out)
    else:
        operator = CommandOperator(place_command, free_views=rig.calibration.free_views, console=out)

    def on_pair(number: int, angle: float, on: np.ndarray, off: np.ndarray) -> None:
        request = operator.placing
        turning = request is not None and request.kind == "placement"
        laser = rig.laser_of(number)
        seen = guide.look(on, off, laser)
        guide.keep(seen, request.number if turning and request is not None else None)
        at = f"at {math.degrees(angle):.1f}°: " if turning else ""
        if seen.view is None:
            out.print(f"  {at}{seen.problem}")
            return
        pose = guide.pose(seen)
        stands = "" if pose is None else f", tilted {pose.tilt_deg:.0f}°, about {pose.depth_m:.2f} m away"
        out.print(f"  {at}board found, {len(seen.view.q)} corners{stands}; laser {named[laser]}{seen.view.where}")
        if not turning:
            for line in coverage_lines(guide.coverage()):
                out.print(line)

    def should_stop() -> bool:
        return interrupted() or (lines is not None and lines.ended)

    with ScanDisplay() as display:
        result = run_calibration(
            rig,
            folder,
            devices,
            operator,
            Hooks(on_pair, notify=display.say, should_stop=should_stop),
            resume=resume,
        )
    if isinstance(operator, CommandOperator):
        operator.take_away()
    return result


def make_guide(rig: "RigConfig") -> "Guide":
    """The guide. OpenCV finds the corners, `extract_stripes` finds the laser's line."""
    from scanrig.checks.guide import Guide

    from jaxscan.vision import find_corners, to_grey

    camera = rig.camera
    if rig.board is None:
        raise OptionError("The configuration has no [board] table, which --boards needs.")
    board = rig.board.board()

    def detect(frame: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        found = find_corners(to_grey(frame, camera.layout), board)
        return None if found is None else (found.q, found.valid)

    finders = {laser.name: line_finder(rig, laser.line) for laser in rig.laser}
    return Guide(board, (camera.width, camera.height), detect, finders)


COMMAND_S = 600.0
"""Longest time that a command may take to place the board."""
_TICK_S = 0.2
KEYS = "Enter: take it · s: enough of these · q: enough of all"


class Lines:
    """Lines of standard input, read with short waits so that a signal can end the wait."""

    def __init__(self, file: int | None = None) -> None:
        """Read from a file descriptor; standard input by default."""
        self._file = sys.stdin.fileno() if file is None else file
        self._waiting = b""
        self.ended = False
        """Whether the input has ended."""

    def forget(self) -> None:
        """Drop lines that were typed before the question. Input from a file or a pipe is kept."""
        if not os.isatty(self._file):
            return
        self._waiting = b""
        while not self.ended and select.select([self._file], [], [], 0.0)[0]:
            self._read()

    def next(self, should_stop: Callable[[], bool]) -> str | None:
        """The next line without its end; None if the input ended or `should_stop` said so."""
        while b"\n" not in self._waiting and not self.ended:
            if should_stop():
                return None
            if not select.select([self._file], [], [], _TICK_S)[0]:
                continue
            self._waiting += self._read()
        if b"\n" not in self._waiting:
            return None
        line, self._waiting = self._waiting.split(b"\n", 1)
        return line.decode(errors="replace").strip()

    def _read(self) -> bytes:
        try:
            data = os.read(self._file, 4096)
        except OSError:
            data = b""  # The terminal hung up; its signal comes later.
        self.ended = not data
        return data


class TerminalOperator:
    """An `Operator` of `scanrig.session.run`: a person at the terminal."""

    def __init__(self, guide: "Guide", lines: Lines, *, should_stop: Callable[[], bool], console: Terminal) -> None:
        """Ask on `console` and read the answers from `lines`.

        Args:
            guide: Knows which poses are missing.
            lines: Answers of the person.
            should_stop: Whether the session is to end.
            console: Where the questions are printed.
        """
        self._guide, self._lines = guide, lines
        self._should_stop, self._console = should_stop, console
        self._enough = False
        self.placing: PlacementRequest | None = None
        """The request for which the board is placed now."""

    def place(self, request: "PlacementRequest") -> bool:
        """Ask until the camera sees the board, or the person says that it is enough."""
        if self._enough:
            return False
        self.placing = request
        place = "Pose" if request.kind == "free" else "Standing place"
        at = f", the table at {request.at_deg:g}°" if request.at_deg else ""
        self._console.print("")
        self._console.print(f"{place} {request.number + 1} of {request.total}{at}")
        for sentence in self._guide.advice(request.kind):
            self._console.print(f"  → {sentence}")
        while True:
            # An Enter typed too early would take the board while it is moved to the next pose.
            self._lines.forget()
            self._console.print(f"  {KEYS}", style="dim")
            answer = self._lines.next(self._should_stop)
            if answer is None:
                # The end of the input is not an Enter. The capture can be resumed.
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
    """An `Operator` that runs a command with the number of the pose, for a robot or the bench."""

    def __init__(self, command: str, *, free_views: int, console: Terminal) -> None:
        """Split the command as a shell does; it runs without a shell.

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
        """Run the command. Free poses are numbered from 0, standing places follow."""
        self.placing = request
        number = request.number + (0 if request.kind == "free" else self._free_views)
        place = "pose" if request.kind == "free" else "standing place"
        self._console.print(f"{place} {request.number + 1} of {request.total}: {self._words[0]} … {number}")
        self._run(str(number))
        return True

    def take_away(self) -> None:
        """Run the command with "none": a board that stays in the room is in its scan."""
        try:
            self._run("none")
        except OptionError as problem:
            # The capture is good all the same.
            self._console.print(f"note: the board may still be in the room. {problem}")

    def _run(self, pose: str) -> None:
        try:
            done = subprocess.run(
                [*self._words, pose], stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=COMMAND_S
            )
        except (OSError, subprocess.TimeoutExpired) as problem:
            raise OptionError(f"--place-command: {self._words[0]}: {problem}.") from problem
        if done.returncode:
            says = (done.stderr or done.stdout).strip().splitlines()
            why = f": {says[-1]}" if says else ""
            raise OptionError(f"--place-command: {self._words[0]} {pose} ended with {done.returncode}{why}.")


def coverage_lines(seen: "Coverage", *, laser: bool = True) -> list[str]:
    """Coverage by the poses so far, as text: the cells of the image that have corners, with tilts, depths and
    lasers."""
    from jaxscan.geometry.coverage import MIN_IN_CELL, MIN_TILT_DEG

    cells = [" ".join("■" if count >= MIN_IN_CELL else "·" for count in row) for row in seen.corners]
    sides = f", towards {seen.tilt_sides} of 4 sides" if seen.tilted else ""
    facts = [f"{seen.tilted} of {seen.views} tilted by {MIN_TILT_DEG:.0f}° or more{sides}"]
    depth = "no distance yet" if seen.depth_m is None else f"{seen.depth_m[0]:.2f} to {seen.depth_m[1]:.2f} m away"
    facts.append(f"{depth} (about)")
    facts.append(f"laser {seen.laser} across {seen.crossed} of {seen.lit}".replace("  ", " ") if laser else "")
    return [f"    {row}   {fact}".rstrip() for row, fact in zip(cells, facts, strict=True)]


def line_finder(rig: "RigConfig", line: LaserLine) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """A function of a laser-on and a laser-off frame that gives the stripe's centres [n, 2] [px]."""
    return partial(_find_line, FrameFormat(rig.camera.layout, rig.camera.response), line)


def _find_line(frames: FrameFormat, line: LaserLine, on: np.ndarray, off: np.ndarray) -> np.ndarray:
    stripes = api.extract_stripes(on, off, pixel_format=frames, line=line)
    valid = np.asarray(stripes.valid)[0]
    points = np.column_stack([np.asarray(stripes.u)[0][valid], np.flatnonzero(valid)]).astype(float)
    return points if line.stripe_axis == "rows" else points[:, ::-1]
