"""The plan of a scan, shown before it begins: records, time, disk space and notes."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from jaxscan.cli.process.terminal import Terminal
from jaxscan.files.capture import CameraTable, CaptureHeader, TurntableTable


if TYPE_CHECKING:
    from scanrig.config import RigConfig


class CaptureFolder(NamedTuple):
    """The folder of a capture."""

    path: Path
    resume: bool
    """Whether to continue the capture in it."""


class ScanPlan(NamedTuple):
    """The records of a scan, and its need of time and disk space."""

    records: int
    targets: str
    """The targets in words."""
    seconds: float
    bytes: int
    notes: tuple[str, ...] = ()

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
        needed = estimate(rig, records)
        places = (
            f"{views.free_views} poses of the board, then {views.placements} places where it stands while the table "
            f"turns to {len(views.angles_deg)} angles{_each(rig)}"
        )
        return cls(len(records), places, needed.seconds, needed.bytes)

    def show(self, out: Terminal, rig: "RigConfig", folder: Path) -> None:
        """Print the plan."""
        from scanrig.recording import readable

        out.print(f"{self.targets}: {2 * self.records} images of {rig.camera.width} x {rig.camera.height} to {folder}")
        turn = f"{rig.microsteps_per_turn} microsteps per turn"
        out.print(f"about {_duration(self.seconds)}, up to {readable(self.bytes)}, {turn}")
        for note in self.notes:
            out.print(f"note: {note}")


def _each(rig: "RigConfig") -> str:
    names = " and ".join(laser.name for laser in rig.laser)
    return f", each with the lasers {names}" if len(rig.laser) > 1 else ""


def _duration(seconds: float) -> str:
    minutes = math.ceil(seconds / 60)
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"


def sweep_header(rig: "RigConfig") -> CaptureHeader:
    """The header that the capture is going to have, as far as it describes the frames."""
    camera = rig.camera
    table = CameraTable(
        width=camera.width,
        height=camera.height,
        pixel_format=camera.pixel_format,
        response=camera.response,
        up=camera.up,
    )
    turntable = TurntableTable(carries=rig.turntable.carries)
    return CaptureHeader(kind="sweep", camera=table, turntable=turntable, laser=tuple(one.table for one in rig.laser))
