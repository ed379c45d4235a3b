"""`jaxscan scan --boards`: takes poses of the calibration board, and checks each at once."""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from jaxscan.cli.process.terminal import Terminal
from jaxscan.cli.scanning.display import ScanDisplay
from jaxscan.cli.scanning.line_finder import line_finder
from jaxscan.cli.scanning.operator import CommandOperator, Lines, TerminalOperator, coverage_lines
from jaxscan.cli.scanning.plan import CaptureFolder
from jaxscan.errors import OptionError


if TYPE_CHECKING:
    from scanrig.checks.guide import Guide
    from scanrig.config import RigConfig
    from scanrig.session import Devices, SessionResult


def scan_boards(
    rig: "RigConfig",
    folder: CaptureFolder,
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
        return run_calibration(
            rig,
            folder.path,
            devices,
            operator,
            Hooks(on_pair, notify=display.say, should_stop=should_stop),
            resume=folder.resume,
        )


def make_guide(rig: "RigConfig") -> "Guide":
    """The guide. OpenCV finds the corners, `extract_stripes` finds the laser's line."""
    from scanrig.checks.guide import Guide

    from jaxscan.vision import find_corners, to_grey

    camera = rig.camera
    if rig.board is None:
        raise OptionError("The configuration has no [board] table, which --boards needs.")
    board = rig.board.board()

    def detect(frame: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        found = find_corners(to_grey(frame, camera.pixel_format), board)
        return None if found is None else (found.q, found.valid)

    finders = {laser.name: line_finder(rig, laser.line) for laser in rig.laser}
    return Guide(board, (camera.width, camera.height), detect, finders)
