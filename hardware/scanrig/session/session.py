"""Sessions: a sweep or a calibration from beginning to end, every pair proven and on the disk before the next."""

from collections.abc import Callable, Sequence
from itertools import groupby
from pathlib import Path

from jaxscan.errors import ConfigError
from scanrig.cameras.frame import Camera
from scanrig.clock import Clock, SystemClock
from scanrig.config import RigConfig
from scanrig.controllers.controller import Controller
from scanrig.session.conduct import conduct
from scanrig.session.job import Job, OnPair
from scanrig.session.job import SessionResult as SessionResult
from scanrig.session.job import Status as Status
from scanrig.session.placements import Operator as Operator
from scanrig.session.placements import PlacementRequest as PlacementRequest
from scanrig.session.placements import take_placements
from scanrig.session.plan import Target, placement_positions, plan_sweep
from scanrig.session.work import Session


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
        should_stop: Asked after each step; `scanrig.session.signals.Interrupts` is one.

    Returns:
        How it ended. The laser is off, or the result says that this could not be confirmed.

    Raises:
        ConfigError: If the plan does not fit the table.
        SessionError: If the folder is in use, or cannot be resumed, or has not the space; or if the rig
            has moved since.
        FrameError: If a step could not be proven.
        RigError: If the rig failed in another way and did not come back. In all cases the capture is
            whole and can be resumed.
        KeyboardInterrupt: After an abort.
    """
    targets, notes = plan_sweep(config)
    job = Job(
        config,
        Path(folder),
        "sweep",
        len(targets),
        controller,
        camera,
        clock or SystemClock(),
        resume=resume,
        calibration_digest=calibration_digest,
        on_pair=on_pair,
        progress=progress,
        notify=notify or _silent,
        should_stop=should_stop or _never,
    )
    for note in notes:
        job.notify(note)
    return conduct(job, lambda session: _take_turns(session, targets))


def _take_turns(session: Session, targets: Sequence[Target]) -> bool:
    """All records that are missing, each pass closed with a check; False where the operator asked to stop."""
    session.start()
    for _, group in groupby(targets, key=lambda target: target.turn):
        turn = tuple(group)
        for target in turn:
            if target.record in session.done:
                continue
            if session.should_stop():
                return False
            session.take(target.record, target.position)
        if session.unclosed(turn):
            if session.should_stop():
                return False
            session.close_turn(turn)
    return True


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
    if config.board is None:
        raise ConfigError("[board]: missing, a calibration needs one; see configs/scan.toml.")
    positions = placement_positions(config)
    plan = config.calibration
    job = Job(
        config,
        Path(folder),
        "calibration",
        plan.free_views + plan.placements * len(positions),
        controller,
        camera,
        clock or SystemClock(),
        resume=resume,
        on_pair=on_pair,
        progress=progress,
        notify=notify or _silent,
        should_stop=should_stop or _never,
    )
    return conduct(job, lambda session: take_placements(session, positions, operator, advise))


def _silent(sentence: str) -> None:
    del sentence


def _never() -> bool:
    return False
