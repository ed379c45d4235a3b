"""Runs any session: lock the folder, make the rig ready, take records, laser off, seal the journal."""

import contextlib
from collections.abc import Callable
from pathlib import Path

from jaxscan.errors import ConfigError
from jaxscan.files.capture import JOURNAL_NAME, SEAL
from jaxscan.files.disk import make_folder
from scanrig.controllers import require_allowed
from scanrig.errors import SessionError
from scanrig.recording import folder_lock
from scanrig.session.ending import Ending, counted, ended_by, leave_safe
from scanrig.session.job import Job, SessionResult
from scanrig.session.resume import Found, find_capture, is_capture, ranges, require_same_plan
from scanrig.session.sentences import say_end
from scanrig.session.session import Session


def run_job(job: Job, work: Callable[[Session], bool]) -> SessionResult:
    """Run a session from the lock to the seal.

    Args:
        job: The inputs.
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
    made = _folder(job.folder)
    try:
        with folder_lock(job.folder) as lock:
            found = _look(job)
            if found is not None and found.status == "complete" and not found.damaged and not found.suspect:
                return _complete_already(job, found)
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
        status = ("suspect" if session.suspect else "complete") if finished else "interrupted"
        ending = Ending(status, "")
    except BaseException as problem:
        ending = ended_by(problem, job.devices.controller)
    unsafe = leave_safe(job.devices.controller)
    # Only now: it may wait for the disk.
    session.end()
    unsealed = session.ledger.end(
        ending.status,
        records=len(session.done),
        taken=session.taken,
        problem=ending.message,
        laser_off=not unsafe,
        **counted(job.devices.controller, answers=not unsafe),
    )
    for sentence in (unsafe, unsealed):
        if sentence:
            job.hooks.notify(sentence)
    if ending.error is not None:
        if unsafe and ending.error.args:
            # Many programs show only one line of an error.
            ending.error.args = (f"{str(ending.error).rstrip('.')}. {unsafe}", *ending.error.args[1:])
        if session.ledger.events and session.done:
            job.hooks.notify(
                f"{job.folder}: {len(session.done)} of {job.planned} records are on the disk; "
                "the capture can be resumed."
            )
        raise ending.error
    return _result(session, ending, unsafe)


def _result(session: Session, ending: Ending, unsafe: str) -> SessionResult:
    job, count = session.job, len(session.done)
    suspect = tuple(ranges(tuple(session.suspect)))
    says = say_end(ending, job.folder, count=count, planned=job.planned, suspect=suspect)
    return SessionResult(
        status=ending.status,  # type: ignore[arg-type]
        message=" ".join(part for part in (says, unsafe) if part),
        records=count + len(session.suspect - session.done),
        planned=job.planned,
        taken=session.taken,
        retakes=session.rig.rejected,
        suspect=suspect,
        events=tuple(session.ledger.events),
        laser_off=not unsafe,
    )


def _folder(folder: Path) -> bool:
    """Make the folder; True if it did not exist."""
    try:
        if folder.is_dir():
            return False
        make_folder(folder, durable=True)
    except OSError as problem:
        raise SessionError(f"{folder}: cannot be created: {problem.strerror or problem}.") from problem
    return True


def _look(job: Job) -> Found | None:
    """The capture in the folder, if there is one and it may be continued.

    Raises:
        KeyboardInterrupt: If the operator asks to stop while it is verified.
    """
    if not is_capture(job.folder):
        return None
    if not job.resume:
        raise SessionError(f"{job.folder}: holds a capture already; resume it, or choose another folder.")
    job.hooks.notify(f"{job.folder}: verifying the capture.")

    def end_if_asked(done: int, total: int) -> None:
        # At the end nothing is saved by it.
        if done < total and job.hooks.should_stop():
            raise KeyboardInterrupt

    found = find_capture(job.folder, progress=end_if_asked)
    for problem in found.altered:
        if not problem.lasting:
            job.hooks.notify(str(problem))
    require_same_plan(found, job.config, job.kind, folder=job.folder, calibration_digest=job.calibration_digest)
    _require_seals(found)
    return found


def _require_seals(found: Found) -> None:
    """Check that no seal is broken: new records do not mend it, and the whole capture could never be opened."""
    for problem in found.altered:
        if problem.lasting:
            raise SessionError(
                f"{problem.message.removesuffix('.')}; the capture cannot be continued: restore the file from a copy, "
                f"or, if the change is meant, remove the lines with {SEAL} from {JOURNAL_NAME}."
            )


def _complete_already(job: Job, found: Found) -> SessionResult:
    count = len(found.records)
    message = f"{job.folder}: is complete already, {count} records; nothing was done."
    return SessionResult("complete", message, count, job.planned, 0, 0, (), (), True)
