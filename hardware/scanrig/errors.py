"""What can go wrong between host and rig: what was found, what was expected, and what to do about it."""

from collections.abc import Sequence
from enum import StrEnum

from jaxscan.errors import JaxscanError


class Fault(StrEnum):
    """Why a controller stopped by itself, whatever number its firmware gives it."""

    EMERGENCY_STOP = "emergency stop"
    LINK_LOST = "the controller lost the host's line"
    LEASE_RAN_OUT = "the laser's lease ran out"
    HOME_NOT_FOUND = "home switch not found, or stuck"
    ABORTED = "aborted"
    CAMERA_NOT_READY = "the camera was not ready in time"
    LIMIT = "a limit switch was hit, or a motion would leave the limits"
    UNKNOWN = "a fault that this host does not know"


CURES = {
    Fault.EMERGENCY_STOP: "release it, clear the fault, home again",
    Fault.LINK_LOST: "reconnect and clear the fault",
    Fault.LEASE_RAN_OUT: "clear the fault",
    Fault.HOME_NOT_FOUND: "look at the switch and its wiring, then clear the fault and home",
    Fault.ABORTED: "clear the fault, and home again if the table was moving",
    Fault.CAMERA_NOT_READY: "look at the camera and its ready line, then clear the fault",
    Fault.LIMIT: "see what the table ran into and what limits are set, then clear the fault and home",
    Fault.UNKNOWN: "look at the controller",
}
"""What to do about a fault."""


class Reason(StrEnum):
    """Why a controller does not carry out a command that it understood."""

    NOT_UNDERSTOOD = "the line was not understood"
    DAMAGED = "the line came damaged"
    UNKNOWN_COMMAND = "the command is not known"
    BAD_ARGUMENT = "an argument is missing, unknown or out of range"
    BUSY = "the controller is busy"
    IN_FAULT = "the controller is in a fault"
    STILL_PRESSED = "the emergency stop is still pressed; release it first"
    NOT_HOMED = "the table is not homed"
    NO_SESSION = "there is no session"
    TOO_LONG = "the line was too long"
    DRIVER_OFF = "the motor driver is off"
    BEYOND_LIMIT = "the target is beyond a soft limit"
    NOT_ARMED = "the laser is not armed"
    NO_SUCH_PART = "it has no such part"
    UNKNOWN = "for a reason that this host does not know"


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
        reason: why.
        command: the command, as it went over the wire.
    """

    def __init__(self, reason: Reason, command: str, said: str = ""):
        super().__init__(f"the controller refused '{command}': {reason}" + (f" ({said})" if said else ""))
        self.reason = reason
        self.command = command


class RigFault(RigError):
    """The controller stopped by itself: laser off, motor stopped.

    Attributes:
        fault: which.
        position: microsteps from home where it stopped; None where it is not known.
    """

    def __init__(self, fault: Fault, position: int | None = None, said: str = ""):
        where = "" if position is None else f" at microstep {position}"
        words = f" ({said})" if said else ""
        super().__init__(f"fault{where}: {fault}{words}; {CURES[fault]}")
        self.fault = fault
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
