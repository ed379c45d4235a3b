"""A session's inputs, result and messages."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from scanrig.cameras import Camera
from scanrig.clock import Clock
from scanrig.config import RigConfig
from scanrig.controllers import Controller


Kind = Literal["sweep", "calibration"]

Status = Literal["complete", "suspect", "interrupted", "e-stop", "disk full"]
"""How a session ended: all records taken; the same, but steps were lost and some records are suspect; stopped by the
operator; e-stop pressed; no space. All but "complete" may be resumed."""

OnPair = Callable[[int, float, np.ndarray, np.ndarray], None]
"""Called with (record number, angle [rad], laser-on frame, laser-off frame)."""


@dataclass(frozen=True)
class SessionResult:
    """The result of a session."""

    status: Status
    message: str
    records: int
    """Records in the capture, of this and earlier sessions."""
    planned: int
    taken: int
    """Records taken by this session."""
    retakes: int
    suspect: tuple[tuple[int, int], ...]
    """Ranges of suspect records, first and last: steps may have been lost before them."""
    events: tuple[dict[str, Any], ...]
    laser_off: bool
    """Whether the controller confirmed at the end that the laser is off."""


@dataclass(frozen=True)
class Devices:
    """The open devices that a session drives, leaves safe, and does not close."""

    controller: Controller
    camera: Camera
    clock: Clock = field(default_factory=Clock)


@dataclass(frozen=True)
class Hooks:
    """Callbacks of a running session."""

    on_pair: OnPair | None = None
    """Called when a pair is on the disk, in the session's thread between two steps: a step or more after its own."""
    progress: Callable[[int, int], None] | None = None
    """Called with (records on the disk, records planned)."""
    notify: Callable[[str], None] = lambda sentence: None
    """Called with each sentence that people should read."""
    should_stop: Callable[[], bool] = lambda: False
    """Called before each step: whether to stop; `Interrupts` is one."""
    advise: Callable[[], Sequence[str]] | None = None
    """Called before the board is placed: the most helpful poses, a sentence each."""


@dataclass(frozen=True)
class Job:
    """The inputs of a session."""

    config: RigConfig
    folder: Path
    kind: Kind
    planned: int
    devices: Devices
    hooks: Hooks
    resume: bool
    calibration_digest: str | None = None
    """Digest of the calibration that is used during the scan."""


def say_event(name: str, fields: Mapping[str, Any]) -> str:
    """The sentence about an event; "" for most events."""
    match name:
        case "retake":
            action = f"step {fields['step']}" if "step" in fields else "a look"
            return f"{action} is taken again: {fields['reason']}"
        case "fault":
            return f"{fields['at']}: {fields['problem']}"
        case "reconnected":
            position = "kept its position" if fields["same_boot"] else "was reset"
            return f"the controller is connected again and {position}"
        case "compared" | "closing" if "correlation" not in fields:
            return (
                f"record {fields['record']}, taken again, was compared by the laser's line alone: the laser-off frames "
                "have too little contrast. With more light in the room, lost steps are found more surely."
            )
        case "light":
            return (
                f"record {fields['record']}: the light changed from {fields['was_dn']:.0f} to {fields['is_dn']:.0f} DN."
            )
        case "camera":
            return f"the camera is open again, after {fields['reopened']} attempts"
        case "suspect":
            return f"records {spoken_runs(fields['records'])} are suspect: {fields['why']}"
        case _:
            return ""


def spoken_runs(runs: Sequence[Sequence[int]]) -> str:
    return ", ".join(f"{first} to {last}" if last > first else str(first) for first, last in runs)
