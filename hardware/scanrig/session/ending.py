"""Ends sessions: classifies errors, and switches the laser off in every case."""

import contextlib
import logging
from dataclasses import asdict, dataclass
from typing import Any

from scanrig.controllers import UNCONFIRMED, Controller
from scanrig.errors import Fault, LinkLost, RigError, RigFault
from scanrig.recording import is_full


log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Ending:
    """The end of a session."""

    status: str
    """As in `SessionResult`; or "aborted" or "failed", and then `error` is raised."""
    message: str
    """The reason."""
    error: BaseException | None = None


def ended_by(problem: BaseException, controller: Controller) -> Ending:
    """Classify an error: a regular end, or an error to raise.

    After an interrupt everything is switched off first.
    """
    if isinstance(problem, KeyboardInterrupt):
        with contextlib.suppress(LinkLost):
            controller.abort()
        return Ending("aborted", "aborted", problem)
    if is_full(problem):
        return Ending("disk full", str(problem))
    if isinstance(problem, RigFault) and problem.fault is Fault.EMERGENCY_STOP:
        return Ending("e-stop", str(problem))
    return Ending("failed", f"{type(problem).__name__}: {problem}", problem)


def counted(controller: Controller, *, answers: bool) -> dict[str, Any]:
    """The counters of the controller and of its link: wear of the laser's switch, line errors.

    Args:
        controller: A controller that was made safe.
        answers: Whether it answered then; otherwise it is not asked again.

    Returns:
        Fields for the journal; without the controller's counters if they cannot be read.
    """
    link: dict[str, Any] = {"link": asdict(controller.link_counts)}
    if not answers:
        return link
    try:
        counters = controller.counters()
        return link if counters is None else {"controller": asdict(counters), **link}
    except RigError as problem:
        log.info("the controller's counters could not be asked for: %s", problem)
        return link


def leave_safe(controller: Controller) -> str:
    """Laser off and contactor open, in every case.

    Returns:
        "" if the controller confirmed it, else the instruction to a person.
    """
    for _ in range(2):
        try:
            return "" if controller.make_safe() else _warning()
        except KeyboardInterrupt:
            # A further interrupt: switch off first.
            with contextlib.suppress(LinkLost):
                controller.abort()
        except (RigError, OSError) as problem:
            return _warning(problem)
    return _warning()


def _warning(problem: Exception | None = None) -> str:
    says = UNCONFIRMED if problem is None else f"{UNCONFIRMED} ({problem})"
    return f"{says[0].upper()}{says[1:]}."
