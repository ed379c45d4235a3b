"""Errors of the rig. Each message states the finding, the expectation and the remedy."""

from enum import StrEnum

from jaxscan.errors import JaxscanError


class Fault(StrEnum):
    """Why a controller stopped by itself, independent of its firmware's numbers."""

    EMERGENCY_STOP = "emergency stop"
    LINK_LOST = "the controller lost the host's line"
    LEASE_RAN_OUT = "the laser's lease ran out"
    HOME_NOT_FOUND = "home switch not found, or stuck"
    ABORTED = "aborted"
    CAMERA_NOT_READY = "the camera was not ready in time"
    TOOL_CHANGE = "the board waits for a change of tool"
    ASLEEP = "the board sleeps"
    HELD = "the board holds its motion"
    LIMIT = "a limit switch was hit, or a motion would leave the limits"
    UNKNOWN = "a fault that this host does not know"


CURES = {
    Fault.EMERGENCY_STOP: "release it, clear the fault, home again",
    Fault.LINK_LOST: "reconnect and clear the fault",
    Fault.LEASE_RAN_OUT: "clear the fault",
    Fault.HOME_NOT_FOUND: "look at the switch and its wiring, then clear the fault and home",
    Fault.ABORTED: "clear the fault, and home again if the table was moving",
    Fault.CAMERA_NOT_READY: "look at the camera and its ready line, then clear the fault",
    Fault.TOOL_CHANGE: "end the change at the board (cycle start), and let no command of the configuration ask for one",
    Fault.ASLEEP: "clear the fault, which wakes it, and home again; a longer sleep timeout of the board avoids it",
    Fault.HELD: "look at its feed hold button or pin and let go of it, then clear the fault",
    Fault.LIMIT: "look for an obstacle at the table and check the limits, then clear the fault and home",
    Fault.UNKNOWN: "look at the controller",
}


class Reason(StrEnum):
    """Why a controller refuses a command."""

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
    """Base class of all errors of the rig."""


class PortError(RigError):
    """No serial port can be opened: none found, missing, no permission, in use."""


class FirmwareError(RigError):
    """The port does not lead to the controller that this host needs: another device, version or settings."""


class LinkLost(RigError):
    """No answer any more: a cable, a dead controller, a port that went away. `Controller.reconnect` recovers."""


class ControllerReset(LinkLost):
    """The controller was reset during a session: position, settings and driver state are lost."""

    def __init__(self, before: int | None, now: int | None):
        was = "" if before is None or now is None else f" (boot {before} → {now})"
        super().__init__(
            f"the controller was reset{was}: its position and settings are gone; reconnect, configure and home again"
        )


class Refused(RigError):
    """The controller received a command intact and did not carry it out."""

    def __init__(self, reason: Reason, command: str, said: str = ""):
        super().__init__(f"the controller refused '{command}': {reason}" + (f" ({said})" if said else ""))
        self.reason = reason


class RigFault(RigError):
    """The controller stopped by itself: laser off, motor stopped."""

    def __init__(self, fault: Fault, position: int | None = None, said: str = ""):
        """`position`: where it stopped, microsteps from home."""
        where = "" if position is None else f" at microstep {position}"
        words = f" ({said})" if said else ""
        super().__init__(f"fault{where}: {fault}{words}; {CURES[fault]}")
        self.fault = fault
        self.position = position


class RigTimeout(RigError):
    """The controller answers, but a motion or shot did not end in time."""


class CameraError(RigError):
    """A camera is missing, in use, or does not keep to its settings."""


class CameraTimeout(CameraError):
    """No frame came in time."""


class CameraLost(CameraError):
    """The camera went away; `Camera.reopen` recovers."""


class FrameError(CameraError):
    """No take of a pair was proven: laser in the laser-on frame, none in the laser-off frame, same place."""


class SessionError(RigError):
    """A session cannot begin or go on: another configuration, a lock, the disk."""
