"""Sessions: a sweep or a calibration from beginning to end, every pair proven and on the disk before the next."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np

from scanrig.cameras.frame import Camera
from scanrig.clock import Clock, SystemClock
from scanrig.config import RigConfig
from scanrig.controller import Controller


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
class PlacementRequest:
    """What the operator is asked to do with the calibration board."""

    kind: Literal["free", "placement"]
    """"free": hold it anywhere; "placement": stand it where it will not move while the table turns."""
    number: int
    """Counted from 0 within its kind."""
    total: int
    advice: list[str]
    """What would help most, a sentence each."""


class Operator(Protocol):
    """Who moves the board."""

    def place(self, request: PlacementRequest) -> bool:
        """Return when the board is placed; False: enough of this kind."""


def run_sweep(
    config: RigConfig,
    folder: str | Path,
    *,
    controller: Controller,
    camera: Camera,
    resume: bool = False,
    calibration_digest: str | None = None,
    on_pair: OnPair | None = None,
    progress: Callable[[int, int], None] | None = None,
    notify: Callable[[str], None] | None = None,
    clock: Clock | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> SessionResult:
    """Capture a sweep.

    Args:
        config: The rig.
        folder: Where the capture goes; new, or one to go on with.
        controller: Open; is configured, homed and armed here, and left safe.
        camera: Open; is started here. Neither is closed.
        resume: Go on with a capture that is there. Without one, begin it.
        calibration_digest: Of the calibration that is used along with the scan; noted, and refused
            where it changed.
        on_pair: Called after each pair is on the disk.
        progress: Called with (records there, records planned).
        notify: Called with a sentence where something happened that a person should know.
        clock: For waiting and for time stamps.
        should_stop: Asked after each step; `scanrig.signals.Interrupts` is one.

    Returns:
        How it ended. The laser is off, or the result says that this could not be confirmed.

    Raises:
        SessionError: If the folder is in use, or cannot be resumed, or has not the space; or if the rig
            has moved since.
        FrameError: If a step could not be proven.
        RigError: If the rig failed in another way and did not come back. In all cases the capture is
            whole and can be resumed.
        KeyboardInterrupt: After an abort.
    """
    raise NotImplementedError


def run_calibration(
    config: RigConfig,
    folder: str | Path,
    *,
    controller: Controller,
    camera: Camera,
    operator: Operator,
    resume: bool = False,
    advise: Callable[[], Sequence[str]] | None = None,
    on_pair: OnPair | None = None,
    progress: Callable[[int, int], None] | None = None,
    notify: Callable[[str], None] | None = None,
    clock: Clock | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> SessionResult:
    """Capture a calibration: free views at the home angle, then placements at several angles each.

    Args:
        operator: Places the board.
        advise: What the request for the next placement says, asked before each.

    The other arguments, the result and the errors are those of `run_sweep`.
    """
    raise NotImplementedError
