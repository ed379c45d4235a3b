"""What a session is asked to do, and what it answers."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from scanrig.cameras import Camera
from scanrig.clock import Clock, SystemClock
from scanrig.config import RigConfig
from scanrig.controllers import Controller


Kind = Literal["sweep", "calibration"]
"""What a capture is for."""

Status = Literal["complete", "suspect", "interrupted", "e-stop", "disk full"]
"""How a session ended: all that was planned; the same, but steps were lost and some records are suspect; the
operator asked; the e-stop was pressed; no space. All but "complete" may be resumed."""

OnPair = Callable[[int, float, np.ndarray, np.ndarray], None]
"""Called with (record's number, angle [rad], laser-on image, laser-off image) when the pair is on the disk."""


@dataclass(frozen=True)
class SessionResult:
    """What a session has done."""

    status: Status
    message: str
    """One line for people."""
    records: int
    """Records in the capture, of this and earlier sessions."""
    planned: int
    """Records that it will have."""
    taken: int
    """Records that this session took."""
    retakes: int
    """Pairs that were taken and not believed."""
    suspect: tuple[tuple[int, int], ...]
    """Ranges of records, first and last, that were taken after steps were lost."""
    events: tuple[dict[str, Any], ...]
    """What was noted in the journal."""
    laser_off: bool
    """Whether the controller confirmed at the end that the laser is off."""


def _silent(sentence: str) -> None:
    del sentence


def _never() -> bool:
    return False


@dataclass(frozen=True)
class Devices:
    """What a session drives, all of it open. Nothing of it is closed by a session."""

    controller: Controller
    """Is configured, homed and armed by the session, and left safe."""
    camera: Camera
    """Is started by the session."""
    clock: Clock = field(default_factory=SystemClock)
    """For waiting and for time stamps."""


@dataclass(frozen=True)
class Hooks:
    """What a session calls while it runs."""

    on_pair: OnPair | None = None
    """After each pair is on the disk."""
    progress: Callable[[int, int], None] | None = None
    """With (records there, records planned)."""
    notify: Callable[[str], None] = _silent
    """With a sentence where something happened that a person should know."""
    should_stop: Callable[[], bool] = _never
    """Asked after each step; `Interrupts` is one."""
    advise: Callable[[], Sequence[str]] | None = None
    """Asked before each placing of the calibration board for what would help most, a sentence each."""


@dataclass(frozen=True)
class Job:
    """What a session is asked to do, and with what."""

    config: RigConfig
    folder: Path
    kind: Kind
    planned: int
    """Records that the capture will have."""
    devices: Devices
    hooks: Hooks
    resume: bool
    calibration_digest: str | None = None
    """Of the calibration that is used along with the scan."""
