"""What can go wrong between host and rig: what was found, what was expected, and what to do about it."""

from collections.abc import Sequence

from jaxscan.errors import JaxscanError


REFUSALS = {
    1: "the line was not understood",
    2: "the line came damaged",
    3: "the command is not known",
    4: "an argument is missing, unknown or out of range",
    5: "the controller is busy",
    6: "the controller is in a fault",
    8: "the table is not homed",
    9: "there is no session",
    10: "the line was too long",
    11: "the motor driver is off",
    13: "the target is beyond a soft limit",
    14: "the laser is not armed",
}
"""What the controller means by the code of a refusal (PROTOCOL.md, section 4)."""

FAULTS = {
    1: ("emergency stop", "release it, clear the fault, home again"),
    2: ("the controller lost the host's line", "reconnect and clear the fault"),
    3: ("the laser's lease ran out", "clear the fault"),
    4: ("home switch not found, or stuck", "look at the switch and its wiring, then clear the fault and home"),
    5: ("aborted", "clear the fault, and home again if the table was moving"),
    6: ("the camera was not ready in time", "look at the camera and its ready line, then clear the fault"),
}
"""Code of a fault: what happened, and what to do."""


class RigError(JaxscanError):
    """Base of everything that goes wrong with the rig."""


class PortError(RigError):
    """No serial port to open: none found, missing, without rights, taken.

    Attributes:
        candidates: ports that do exist, as a person would name them.
    """

    def __init__(self, message: str, candidates: Sequence[str] = ()):
        super().__init__(message)
        self.candidates = tuple(candidates)


class FirmwareError(RigError):
    """Something else than the controller that this host needs: another device, version or set of settings."""


class LinkLost(RigError):
    """No answer any more: a cable, a dead controller, a port that went away. `Controller.reconnect` is the way back."""


class ControllerReset(LinkLost):
    """The controller started anew in mid-session: position, settings and driver state are gone."""

    def __init__(self, before: int | None, now: int | None):
        was = "" if before is None or now is None else f" (boot {before} → {now})"
        super().__init__(
            f"the controller was reset{was}: its position and settings are gone; reconnect, configure and home again"
        )
        self.before = before
        self.now = now


class Refused(RigError):
    """The controller understood a command and did not carry it out.

    Attributes:
        code: the error number of PROTOCOL.md.
        command: the line that was refused, without number and CRC.
    """

    def __init__(self, code: int, command: str):
        why = REFUSALS.get(code, "for a reason that this host does not know")
        if code == 6 and command == "CLEAR":
            why = "the emergency stop is still pressed; release it first"
        super().__init__(f"the controller refused '{command}': {why} (error {code})")
        self.code = code
        self.command = command


class RigFault(RigError):
    """The controller stopped by itself: laser off, contactor open, motor stopped.

    Attributes:
        code: the fault number of PROTOCOL.md.
        position: microsteps from home where it stopped; None where it is not known.
    """

    def __init__(self, code: int, position: int | None = None):
        what, cure = FAULTS.get(code, ("a fault that this host does not know", "look at the controller"))
        where = "" if position is None else f" at microstep {position}"
        super().__init__(f"fault {code}{where}: {what}; {cure}")
        self.code = code
        self.position = position


class RigTimeout(RigError):
    """The controller answers, but what was begun did not end in time."""


class TranscriptDifference(RigError):
    """What is written differs from the transcript that is being replayed."""


class CameraError(RigError):
    """A camera that is missing, busy, or does not do what it was set to."""


class CameraTimeout(CameraError):
    """No frame within the time that was given."""


class CameraLost(CameraError):
    """The camera went away; `Camera.reopen` is the way back."""


class FrameError(CameraError):
    """A pair of frames that could not be proven to be one lit and one dark picture of the same place."""


class SessionError(RigError):
    """A session that cannot begin or go on: another configuration, a lock, the disk."""
