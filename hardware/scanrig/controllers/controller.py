"""What a controller is to the rest of the rig: it turns the table, switches the laser, and may trigger the camera."""

import logging
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol

from scanrig.controllers.settings import Settings
from scanrig.controllers.status import Counters, Firmware, LinkCounts, Reconnection, ShotDone, Status
from scanrig.errors import RigError


log = logging.getLogger(__name__)

UNCONFIRMED = "could not confirm that the laser is off: switch its supply off by hand"


@dataclass(frozen=True)
class Guarantees:
    """What a controller does by itself, whatever becomes of the host. What it cannot do is said to people."""

    laser_off_without_host: bool
    """The laser goes off within a second or so of the host's death, or of a cable that was pulled."""
    knows_missed_steps: bool
    """`Controller.home` says by how many microsteps home was missed."""
    hardware_trigger: bool
    """It triggers the camera by a wire: `Controller.trigger`, `shot` and `wait_shot`."""
    checked_lines: bool
    """A line that was damaged on its way is noticed, not carried out."""


class Controller(Protocol):
    """A controller whose port is open. As a context manager it makes everything safe on the way out.

    Positions are microsteps of the table from home, whatever the controller counts in. Used from one thread. Every
    method that asks the controller may raise:

        LinkLost: no answer any more; `reconnect` is the way back. ControllerReset, a kind of it: it has started anew.
        RigFault: it stopped by itself, and is in a fault until `clear`.
        Refused: it will not do that now.
    """

    @property
    def name(self) -> str:
        """The port, as a person calls it."""

    @property
    def guarantees(self) -> Guarantees:
        """What it does without the host."""

    @property
    def link_counts(self) -> LinkCounts:
        """What the line did so far."""

    # Session

    def hello(self) -> Firmware:
        """Begin a session: laser off, contactor open.

        Returns:
            Who answered; a changed `boot` means that position and settings are gone.

        Raises:
            FirmwareError: silence, another device, or one that this host does not fit.
        """

    def configure(self, settings: Settings) -> None:
        """Take over the settings, and see that they hold.

        Raises:
            FirmwareError: the controller is not, and cannot be, set so, or it switches fewer lasers.
        """

    def reconnect(self, timeout_s: float = 60.0) -> Reconnection:
        """Find the controller again after LinkLost or ControllerReset. Motion is stopped, the laser off.

        Args:
            timeout_s: when to give up.

        Returns:
            Whether it kept its position, whether it must be homed, and its state.

        Raises:
            LinkLost: it did not come back in time.
            FirmwareError: something else is there now.
        """

    # Motion

    def enable(self, on: bool) -> None:
        """Switch the motor driver on or off; off forgets home."""

    def home(self, max_steps: int, timeout_s: float = 120.0) -> int | None:
        """Look for the home switch and call its place 0.

        Args:
            max_steps: how many microsteps to look for it.
            timeout_s: how long.

        Returns:
            The position at which it was found by what was known before: 0 where no step was lost. None where the
            controller cannot say (`Guarantees.knows_missed_steps`).

        Raises:
            RigFault: it was not found, or something stopped the motion.
            RigTimeout: it did not arrive.
        """

    def move(self, to: int, timeout_s: float = 120.0) -> int:
        """Turn to a position and wait for it.

        Args:
            to: microsteps from home.
            timeout_s: how long to wait.

        Returns:
            The position reached.

        Raises:
            RigTimeout: it did not arrive.
        """

    def stop(self) -> None:
        """Laser off, motor slowed down; the table stays homed."""

    # Light

    def arm(self, on: bool) -> None:
        """Allow the laser to be lit, or forbid it: close or open the contactor in its supply, where there is one."""

    def laser(self, on: bool, *, number: int = 1) -> None:
        """Switch a laser on, renew that, or switch all lasers off.

        Args:
            on: on or off.
            number: which one, from 1.

        Raises:
            Refused: not armed.
        """

    # The camera's wire; without `Guarantees.hardware_trigger` these are refused

    def trigger(self) -> None:
        """One exposure. Does not wait for its end."""

    def shot(self, to: int, id: int, *, number: int = 1) -> None:
        """Begin a shot: turn, settle, expose with the laser, expose without. `to` as it stands repeats it.

        Args:
            to: microsteps from home.
            id: a number to know it by.
            number: which laser, from 1.
        """

    def wait_shot(self, id: int, timeout_s: float = 120.0) -> ShotDone:
        """Wait for the end of a shot that `shot` has begun.

        Raises:
            RigTimeout: it did not end in time; it was stopped.
        """

    # State

    def stat(self) -> Status:
        """Ask for the state; a fault is only told."""

    def poll(self) -> Status:
        """Ask for the state: a sign of life, too. A fault is raised."""

    def counters(self) -> Counters | None:
        """The controller's own counters of errors and wear; None where it has none."""

    def clear(self) -> None:
        """Leave a fault; the laser is not armed then.

        Raises:
            Refused: what caused it is still there.
        """

    # The way out

    def abort(self) -> None:
        """Everything off at once, without waiting for an answer. Raises LinkLost alone."""

    def make_safe(self) -> bool:
        """Stop, laser off, contactor open; if that is not answered, abort. Raises nothing for the rig's sake.

        Returns:
            True if the controller confirmed that the laser is off, and nothing runs that could switch it on. False:
            a person must look.
        """

    def close(self) -> None:
        """Make safe and give the port back; may be called twice.

        Raises:
            RigError: it could not be confirmed that the laser is off.
        """

    def __enter__(self) -> "Controller": ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


def close_after(controller: Controller, error: BaseException | None) -> None:
    """Close on the way out of `with`; where that fails on the way out of an error, the error says so as well."""
    try:
        controller.close()
    except RigError as problem:
        if error is None:
            raise
        log.critical("%s", problem)
        error.add_note(str(problem))
