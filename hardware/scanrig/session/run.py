"""The two sessions that a caller may run: a sweep, or views of the calibration board."""

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

from jaxscan.errors import ConfigError
from scanrig.config import RigConfig
from scanrig.session.job import Devices, Hooks, Job, SessionResult
from scanrig.session.lifecycle import run_job
from scanrig.session.placements import Operator, take_placements
from scanrig.session.plan import Target, placed_targets, placement_positions, plan_sweep
from scanrig.session.session import Session


def run_sweep(
    config: RigConfig,
    folder: str | Path,
    devices: Devices,
    hooks: Hooks | None = None,
    *,
    resume: bool = False,
    calibration_digest: str | None = None,
) -> SessionResult:
    """Capture a sweep, each pair proven and written while the table turns to the next.

    Args:
        config: The rig.
        folder: Folder of the capture: new, or one to continue.
        devices: Controller and camera, open.
        hooks: Callbacks.
        resume: Continue the capture in the folder; if there is none, begin it.
        calibration_digest: Digest of the calibration that is used during the scan; noted, and refused
            if it changed.

    Returns:
        How it ended. The laser is off, or the result says that this could not be confirmed.

    Raises:
        ConfigError: If the plan does not fit the table, or the controller cannot switch the laser off without the
            host and the configuration does not allow that.
        SessionError: If the folder is in use, cannot be resumed or lacks space, or if the rig has moved since.
        FrameError: If a step could not be proven.
        RigError: If the rig failed in another way and did not recover. In all cases the capture is
            whole and can be resumed.
        KeyboardInterrupt: After an abort.
    """
    targets, notes = plan_sweep(config)
    job = Job(config, Path(folder), "sweep", len(targets), devices, hooks or Hooks(), resume, calibration_digest)
    for note in notes:
        job.hooks.notify(note)
    return run_job(job, lambda session: _take_turns(session, targets))


def _take_turns(session: Session, targets: Sequence[Target]) -> bool:
    """Take all missing records, each pass closed with a check; False if the operator asked to stop."""
    session.start()
    for _, group in groupby(targets, key=lambda target: target.turn):
        turn = tuple(group)
        for target in turn:
            if target.record in session.done:
                continue
            if session.should_stop():
                return False
            session.take(target.record, target.position)
        session.settle()
        if session.unclosed(turn):
            if session.should_stop():
                return False
            session.close_turn(turn)
    return True


def run_calibration(
    config: RigConfig,
    folder: str | Path,
    devices: Devices,
    operator: Operator,
    hooks: Hooks | None = None,
    *,
    resume: bool = False,
) -> SessionResult:
    """Capture a calibration: free views at the home angle, then placements at several angles each.

    Args:
        operator: The person who places the board.

    For the other arguments, the result and the errors see `run_sweep`.
    """
    if config.board is None:
        raise ConfigError("[board]: missing, a calibration needs one; see `jaxscan init scan.toml`.")
    positions = placement_positions(config)
    free, stands = placed_targets(config, positions)
    planned = sum(len(targets) for targets in (*free, *stands))
    job = Job(config, Path(folder), "calibration", planned, devices, hooks or Hooks(), resume)
    return run_job(job, lambda session: take_placements(session, positions, operator))
