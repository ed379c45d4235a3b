"""The inputs and the result of a session."""

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
"""The purpose of a capture."""

Status = Literal["complete", "suspect", "interrupted", "e-stop", "disk full"]
"""How a session ended: all records taken; the same, but steps were lost and some records are suspect; stopped by the
operator; e-stop pressed; no space. All but "complete" may be resumed."""

OnPair = Callable[[int, float, np.ndarray, np.ndarray], None]
"""Called with (record number, angle [rad], laser-on frame, laser-off frame) when the pair is on the disk."""


@dataclass(frozen=True)
class SessionResult:
    """The result of a session."""

    status: Status
    message: str
    """One line for people."""
    records: int
    """Records in the capture, of this and earlier sessions."""
    planned: int
    """Records of the complete capture."""
    taken: int
    """Records taken by this session."""
    retakes: int
    """Takes that were not proven."""
    suspect: tuple[tuple[int, int], ...]
    """Ranges of suspect records, first and last: steps may have been lost before them."""
    events: tuple[dict[str, Any], ...]
    """The events noted in the journal."""
    laser_off: bool
    """Whether the controller confirmed at the end that the laser is off."""


@dataclass(frozen=True)
class Devices:
    """The open devices that a session drives. A session closes none of them."""

    controller: Controller
    """The session configures, homes and arms it, and leaves it safe."""
    camera: Camera
    """The session starts it."""
    clock: Clock = field(default_factory=SystemClock)
    """For waiting and for time stamps."""


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
    """Asked before each step whether to stop; `Interrupts` is one."""
    advise: Callable[[], Sequence[str]] | None = None
    """Asked for advice before the board is placed: the most helpful poses, a sentence each."""


@dataclass(frozen=True)
class Job:
    """The inputs of a session."""

    config: RigConfig
    folder: Path
    kind: Kind
    planned: int
    """Records that the capture will have."""
    devices: Devices
    hooks: Hooks
    resume: bool
    calibration_digest: str | None = None
    """Digest of the calibration that is used during the scan."""
