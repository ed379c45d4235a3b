"""The interface of every controller: it turns the table, switches the lasers, and may trigger the camera."""

import logging
from abc import ABC, abstractmethod
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self

from scanrig.controllers.settings import Settings
from scanrig.controllers.status import Counters, Firmware, LinkCounts, Reconnection, ShotDone, Status
from scanrig.errors import RigError
from scanrig.wire import Link


log = logging.getLogger(__name__)

UNCONFIRMED = "could not confirm that the laser is off: switch its supply off by hand"


@dataclass(frozen=True)
class Guarantees:
    """The tasks that a controller carries out even when the host fails. People are told of those that it cannot."""

    laser_off_without_host: bool
    """The laser goes off within about a second after the host fails or the cable is pulled."""
    knows_missed_steps: bool
    """`Controller.home` returns by how many microsteps home was missed."""
    hardware_trigger: bool
    """It triggers the camera through a wire: `Controller.trigger`, `shot` and `wait_shot`."""
    checked_lines: bool
    """A line that was damaged on its way is detected and not carried out."""


class Controller(Protocol):
    """A controller whose port is open. As a context manager it makes the rig safe when it exits.

    Positions are microsteps of the table from home, whatever units the controller uses. Used from one thread. Every
    method that asks the controller may raise:

        LinkLost: no answer any more; call `reconnect`. Its subclass ControllerReset: the controller was reset.
        RigFault: it stopped by itself and stays in the fault until `clear`.
        Refused: it does not carry out the command in its present state.
    """

    @property
    def name(self) -> str:
        """The name of the port, for messages."""

    @property
    def guarantees(self) -> Guarantees:
        """What it guarantees without the host."""

    @property
    def link_counts(self) -> LinkCounts:
        """Counts of lines sent, resent and damaged so far."""

    # Session

    def hello(self) -> Firmware:
        """Begin a session: laser off, contactor open.

        Returns:
            The firmware that answered; a changed `boot` means that position and settings are lost.

        Raises:
            FirmwareError: no answer, another device, or firmware that does not fit this host.
        """

    def configure(self, settings: Settings) -> None:
        """Send the settings and check that the controller took them.

        Raises:
            FirmwareError: the controller does not take them, or it switches fewer lasers.
        """

    def reconnect(self, timeout_s: float = 60.0) -> Reconnection:
        """Find the controller again after LinkLost or ControllerReset. Motion is stopped, the laser off.

        Args:
            timeout_s: when to give up.

        Returns:
            Whether it kept its position, whether it must be homed, and its state.

        Raises:
            LinkLost: it did not come back in time.
            FirmwareError: another device is there now.
        """

    # Motion

    def enable(self, on: bool) -> None:
        """Switch the motor driver on or off; switching it off loses home."""

    def home(self, max_steps: int, timeout_s: float = 120.0) -> int | None:
        """Search for the home switch; its edge becomes position 0.

        Args:
            max_steps: how far to search, microsteps.
            timeout_s: how long to wait.

        Returns:
            The position of the switch by the counter as it was before: 0 if no step was lost. None if the controller
            cannot tell (`Guarantees.knows_missed_steps`).

        Raises:
            RigFault: the switch was not found, or a fault stopped the motion.
            RigTimeout: homing did not end in time.
        """

    def move(self, to: int, timeout_s: float = 120.0) -> int:
        """Turn to a position and wait until the table is there.

        Args:
            to: microsteps from home.
            timeout_s: how long to wait.

        Returns:
            The position reached.

        Raises:
            RigTimeout: the table did not arrive in time.
        """

    def stop(self) -> None:
        """Laser off, motor ramped down; the table stays homed."""

    # Light

    def arm(self, on: bool) -> None:
        """Allow or forbid the laser: close or open the contactor in its supply, if there is one."""

    def laser(self, on: bool, *, number: int = 1) -> None:
        """Switch a laser on, renew its lease, or switch all lasers off.

        Args:
            on: on or off.
            number: which one, from 1.

        Raises:
            Refused: not armed.
        """

    # The camera's trigger wire; refused without `Guarantees.hardware_trigger`

    def trigger(self) -> None:
        """Start one exposure. Does not wait for its end."""

    def shot(self, to: int, id: int, *, number: int = 1) -> None:
        """Begin a shot: turn, settle, expose with the laser, expose without. The present position as `to` repeats it.

        Args:
            to: microsteps from home.
            id: a number that identifies the shot.
            number: which laser, from 1.
        """

    def wait_shot(self, id: int, timeout_s: float = 120.0) -> ShotDone:
        """Wait for the end of a shot that `shot` began.

        Raises:
            RigTimeout: it did not end in time and was stopped.
        """

    # State

    def stat(self) -> Status:
        """Ask for the state; a fault is reported, not raised."""

    def poll(self) -> Status:
        """Ask for the state, which also feeds the watchdog. A fault is raised."""

    def counters(self) -> Counters | None:
        """The controller's own counters of errors and wear; None if it has none."""

    def clear(self) -> None:
        """Leave a fault; the laser is not armed afterwards.

        Raises:
            Refused: the cause of the fault is still there.
        """

    # Ending

    def abort(self) -> None:
        """Everything off at once, without waiting for an answer. Raises only LinkLost."""

    def make_safe(self) -> bool:
        """Stop, laser off, contactor open; if that is not answered, abort. Raises no error of the rig.

        Returns:
            True if the controller confirmed that the laser is off and that nothing runs that could switch it on.
            False: a person must check.
        """

    def close(self) -> None:
        """Make the rig safe and close the port; may be called twice.

        Raises:
            RigError: the controller did not confirm that the laser is off.
        """

    def __enter__(self) -> "Controller": ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class SafelyClosed(ABC):
    """The end of a controller's use: `close`, which `with` calls, makes the rig safe and closes the port."""

    _closed = False

    @property
    @abstractmethod
    def link(self) -> Link:
        """The present link."""

    @abstractmethod
    def make_safe(self) -> bool:
        """See `Controller`."""

    @property
    def name(self) -> str:
        """The name of the port, for messages."""
        return self.link.name

    def close(self) -> None:
        """See `Controller`."""
        if self._closed:
            return
        self._closed = True
        try:
            safe = self.make_safe()
        finally:
            self.link.close()
        if not safe:
            raise RigError(f"{self.name}: {UNCONFIRMED}")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close()
        except RigError as problem:
            if error is None:
                raise
            # The error that ended `with` goes on, with this one as its note.
            log.critical("%s", problem)
            error.add_note(str(problem))
