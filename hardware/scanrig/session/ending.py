"""How sessions end: what an error means for the capture, and the laser off whatever happened."""

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
    """As of `SessionResult`; or "aborted" or "failed", where `error` is raised."""
    message: str
    """Why."""
    error: BaseException | None = None


def ended_by(problem: BaseException, controller: Controller) -> Ending:
    """What an error means: an end that can be gone on from, or an error to raise.

    After an interrupt everything is off before this returns from its first line.
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
    """What the controller and the link to it have counted: wear of the laser's switch, trouble of the wires.

    Args:
        controller: Made safe.
        answers: Whether it answered then; one that did not is not asked for more.

    Returns:
        Fields for the journal; without those of a controller that cannot be asked.
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
    """Laser off and contactor open, whatever else happens.

    Returns:
        "" if the controller confirmed it, else what a person has to do.
    """
    for _ in range(2):
        try:
            return "" if controller.make_safe() else _warning()
        except KeyboardInterrupt:
            # Somebody is in a hurry; off comes first.
            with contextlib.suppress(LinkLost):
                controller.abort()
        except (RigError, OSError) as problem:
            return _warning(problem)
    return _warning()


def _warning(problem: Exception | None = None) -> str:
    says = UNCONFIRMED if problem is None else f"{UNCONFIRMED} ({problem})"
    return f"{says[0].upper()}{says[1:]}."
