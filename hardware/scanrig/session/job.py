"""What a session is asked to do, and what it answers."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from scanrig.cameras.frame import Camera
from scanrig.clock import Clock
from scanrig.config import RigConfig
from scanrig.controllers.controller import Controller
from scanrig.recording.record import Kind


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


@dataclass(frozen=True)
class Job:
    """What a session is asked to do, and with what."""

    config: RigConfig
    folder: Path
    kind: Kind
    planned: int
    controller: Controller
    camera: Camera
    clock: Clock
    resume: bool
    notify: Callable[[str], None]
    should_stop: Callable[[], bool]
    calibration_digest: str | None = None
    on_pair: OnPair | None = None
    progress: Callable[[int, int], None] | None = None
