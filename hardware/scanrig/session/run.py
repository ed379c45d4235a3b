"""Sessions from the lock to the seal: sweeps and calibrations, their ends, and the laser off at each of them."""

import contextlib
import logging
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from itertools import groupby
from pathlib import Path
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np

from jaxscan.errors import ConfigError
from jaxscan.files.capture import HEADER_NAME, JOURNAL_NAME, SEAL
from jaxscan.files.disk import make_folder
from scanrig.config import RigConfig
from scanrig.controllers import UNCONFIRMED, Controller, require_allowed
from scanrig.errors import Fault, LinkLost, RigError, RigFault, SessionError
from scanrig.recording import folder_lock, is_full
from scanrig.session.job import Devices, Hooks, Job, SessionResult, spoken_runs
from scanrig.session.plan import Target, angle_deg, placed_targets, placement_bearing, placement_positions, plan_sweep
from scanrig.session.resume import Found, find_capture, ranges, require_same_plan
from scanrig.session.session import Session


log = logging.getLogger(__name__)


class Ending(NamedTuple):
    """The end of a session."""

    status: str
    """One of those in `SessionResult`; or "aborted" or "failed", and then `error` is raised."""
    message: str
    error: BaseException | None = None


def ended_by(problem: BaseException, controller: Controller) -> Ending:
    """Classify an error: a regular end, or an error to raise. After an interrupt everything is switched off first."""
    if isinstance(problem, KeyboardInterrupt):
        with contextlib.suppress(LinkLost):
            controller.abort()
        return Ending("aborted", "aborted", problem)
    if is_full(problem):
        return Ending("disk full", str(problem))
    if isinstance(problem, RigFault) and problem.fault is Fault.EMERGENCY_STOP:
        return Ending("e-stop", str(problem))
    return Ending("failed", f"{type(problem).__name__}: {problem}", problem)


def leave_safe(controller: Controller) -> str:
    """Laser off and contactor open, in every case; "" if the controller confirmed it, else an order to a person."""
    warning = f"{UNCONFIRMED[0].upper()}{UNCONFIRMED[1:]}"
    for _ in range(2):
        try:
            return "" if controller.make_safe() else f"{warning}."
        except KeyboardInterrupt:
            # A further interrupt: switch off first.
            with contextlib.suppress(LinkLost):
                controller.abort()
        except (RigError, OSError) as problem:
            return f"{warning} ({problem})."
    return f"{warning}."


def including(unsafe: str, error: BaseException) -> BaseException:
    """The error, its message with the warning of `leave_safe`: many programs show only one line of an error."""
    if unsafe and error.args:
        error.args = (f"{str(error).rstrip('.')}. {unsafe}", *error.args[1:])
    return error


def _counted(controller: Controller, *, answers: bool) -> dict[str, Any]:
    """The counters of the link and, if it `answers`, of the controller, as fields for the journal."""
    counted: dict[str, Any] = {"link": asdict(controller.link_counts)}
    if answers:
        try:
            if counters := controller.counters():
                counted["controller"] = asdict(counters)
        except RigError as problem:
            log.info("the controller's counters could not be read: %s", problem)
    return counted


def run_job(job: Job, work: Callable[[Session], bool]) -> SessionResult:
    """Run a session from the lock to the seal.

    Args:
        work: Takes the missing records; returns False if the operator asked to stop.

    Raises:
        JaxscanError: As for `run_sweep`. The laser is off, or the message says that this is not confirmed.
    """
    guarantees = job.devices.controller.guarantees
    require_allowed(guarantees, job.config.controller)
    if job.config.camera.trigger == "hardware" and not guarantees.hardware_trigger:
        raise ConfigError(
            'camera.trigger: found "hardware", expected "software" or "free": the controller has no wire to the camera.'
        )
    made = not job.folder.is_dir()
    try:
        make_folder(job.folder, durable=True)
    except OSError as problem:
        raise SessionError(f"{job.folder}: cannot be created: {problem.strerror or problem}.") from problem
    try:
        with folder_lock(job.folder) as lock:
            found = _find(job)
            if found is not None and found.status == "complete" and not found.damaged and not found.suspect:
                count = len(found.records)
                message = f"{job.folder}: is complete already, {count} records; nothing was done."
                return SessionResult("complete", message, count, job.planned, 0, 0, (), (), True)
            if job.resume and found is None:
                job.hooks.notify(f"{job.folder}: no capture to resume; a new one begins.")
            session = Session(job, found)
            if lock.note:
                job.hooks.notify(f"{job.folder}: {lock.note}.")
                session.ledger.note("lock", message=lock.note)
            return _run(session, work)
    finally:
        if made:
            # Removes only an empty folder.
            with contextlib.suppress(OSError):
                job.folder.rmdir()


def _run(session: Session, work: Callable[[Session], bool]) -> SessionResult:
    job = session.job
    try:
        session.begin()
        finished = work(session)
        session.settle()
        ending = Ending(("suspect" if session.suspect else "complete") if finished else "interrupted", "")
    except BaseException as problem:
        ending = ended_by(problem, job.devices.controller)
    unsafe = leave_safe(job.devices.controller)
    # Only now: it may wait for the disk.
    session.end()
    count = len(session.done)
    unsealed = session.ledger.end(
        ending.status,
        records=count,
        taken=session.taken,
        problem=ending.message,
        laser_off=not unsafe,
        **_counted(job.devices.controller, answers=not unsafe),
    )
    for sentence in (unsafe, unsealed):
        if sentence:
            job.hooks.notify(sentence)
    if ending.error is not None:
        if session.ledger.events and session.done:
            job.hooks.notify(
                f"{job.folder}: {count} of {job.planned} records are on the disk; the capture can be resumed."
            )
        raise including(unsafe, ending.error)
    suspect = tuple(ranges(tuple(session.suspect)))
    there = f"{count} of {job.planned} records"
    says = {
        "complete": f"complete, {count} records",
        "suspect": f"steps were lost: records {spoken_runs(suspect)} are suspect; "
        "resume the capture to take them again",
        "interrupted": f"interrupted with {there}; it can be resumed",
        "e-stop": f"{ending.message}. {there} are there; release the e-stop, then resume the capture",
        "disk full": f"{ending.message} {there} are there",
    }[ending.status]
    # The message of an error may already begin with the folder.
    message = f"{job.folder}: {says.removeprefix(f'{job.folder}: ').rstrip('.')}."
    return SessionResult(
        status=ending.status,  # type: ignore[arg-type]
        message=f"{message} {unsafe}".rstrip(),
        records=count + len(session.suspect - session.done),
        planned=job.planned,
        taken=session.taken,
        retakes=session.rig.rejected,
        suspect=suspect,
        events=tuple(session.ledger.events),
        laser_off=not unsafe,
    )


def _find(job: Job) -> Found | None:
    """The capture in the folder, if there is one and it may be continued.

    Raises:
        KeyboardInterrupt: If the operator asks to stop while it is verified.
    """
    if not (job.folder / HEADER_NAME).exists():
        return None
    if not job.resume:
        raise SessionError(f"{job.folder}: holds a capture already; resume it, or choose another folder.")
    job.hooks.notify(f"{job.folder}: verifying the capture.")

    def end_if_asked(done: int, total: int) -> None:
        # At the end nothing is saved by it.
        if done < total and job.hooks.should_stop():
            raise KeyboardInterrupt

    found = find_capture(job.folder, progress=end_if_asked)
    require_same_plan(found, job.config, job.kind, folder=job.folder, calibration_digest=job.calibration_digest)
    for problem in found.altered:
        # New records do not mend a broken seal, and the whole capture could never be opened.
        if problem.lasting:
            raise SessionError(
                f"{problem.message.removesuffix('.')}; the capture cannot be continued: restore the file from a copy, "
                f"or, if the change is meant, remove the lines with {SEAL} from {JOURNAL_NAME}."
            )
        job.hooks.notify(str(problem))
    return found


PlacementKind = Literal["free", "placement"]


@dataclass(frozen=True)
class PlacementRequest:
    """A request to the operator to place the calibration board."""

    kind: PlacementKind
    """"free": hold it anywhere; "placement": stand it where it will not move while the table turns."""
    number: int
    """Counted from 0 within its kind."""
    total: int
    at_deg: float
    advice: list[str]
    look: Callable[[], np.ndarray]
    """Takes a frame without laser: uint8 [rows, columns] (rgb8: and 3). Recovers from faults as every step does, and
    keeps the contactor open."""


class Operator(Protocol):
    """The person who moves the board."""

    def place(self, request: PlacementRequest) -> bool:
        """Return when the board is placed; False: no more of this kind."""


def take_placements(session: Session, positions: Sequence[tuple[int, ...]], operator: Operator) -> bool:
    """Take the free views at home, then each placement at its positions.

    Every placement gets a new number. A placement that was half done when a session ended is begun again under another
    number; its old records keep the old one.

    Returns:
        False if the operator asked to stop, or ended before any view was taken.
    """
    views, stands = placed_targets(session.config, positions)
    session.start(compare=False)
    kinds: tuple[tuple[PlacementKind, tuple[tuple[Target, ...], ...]], ...] = (("free", views), ("placement", stands))
    for kind, asked in kinds:
        for number, targets in enumerate(asked):
            if all(target.record in session.done for target in targets):
                continue
            if session.job.hooks.should_stop():
                return False
            bearing = 0 if kind == "free" else placement_bearing(session.config, number)
            if session.rig.at != bearing:
                session.rig.approach(bearing)
            session.rig.dark()
            at_deg = angle_deg(bearing, session.config.microsteps_per_turn)
            advice = [] if session.job.hooks.advise is None else list(session.job.hooks.advise())
            placed = operator.place(PlacementRequest(kind, number, len(asked), at_deg, advice, session.rig.look))
            if session.job.hooks.should_stop():
                return False
            if not placed:
                break
            session.rig.light()
            if not _take_placement(session, targets):
                return False
    if session.since_home:
        session.find_home("end of a placement", in_place=False)
    return bool(session.done or session.suspect)


def _take_placement(session: Session, targets: Sequence[Target]) -> bool:
    label = session.next_placement()
    # Records of an interrupted placement show the board at another place.
    for target in targets:
        session.done.discard(target.record)
    for target in targets:
        if session.job.hooks.should_stop():
            session.settle()
            return False
        session.take(target.record, target.position, placement=label)
    # Before the board is moved.
    session.settle()
    if len({target.position for target in targets}) > 1:
        session.find_home("end of a placement", in_place=True)
    return True


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
        folder: Folder of the capture: new, or one to continue.
        devices: Controller and camera, open.
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
            if session.job.hooks.should_stop():
                return False
            session.take(target.record, target.position)
        session.settle()
        # Some were taken since home was last found well.
        if not {target.record for target in turn}.isdisjoint(session.since_home):
            if session.job.hooks.should_stop():
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
