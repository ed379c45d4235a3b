"""What every controller is: its tables in the configuration, settings, status, guarantees, and the interface."""

import logging
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Literal, Self, TypeVar

import pydantic

from jaxscan.files.disk import FileModel, Integer, Number
from scanrig.clock import Clock
from scanrig.errors import Fault, LinkLost, PortError, RigError
from scanrig.wire import Link


@dataclass(frozen=True)
class Settings:
    """Motion, waits and limits, in microsteps and milliseconds; a controller ignores those that it does not have."""

    watchdog_ms: int = 500
    """Milliseconds without a valid line after which the controller treats the link as lost."""
    speed: int = 4000
    start_speed: int = 400
    acceleration: int = 8000
    home_speed: int = 200
    backlash: int = 0
    """Microsteps by which a downward motion overshoots, so that every target is approached from below."""
    reverse: bool = False
    lasers: int = 1
    settle_ms: int = 50
    """Rest before a shot."""
    laser_on_ms: int = 20
    """Time from laser on to exposure."""
    laser_off_ms: int = 20
    """Time from laser off to exposure."""
    exposure_ms: int = 10
    gap_ms: int = 5
    """After each exposure."""
    ready_ms: int = 0
    """Longest wait for the camera's ready line before each trigger; 0: no wait."""
    limits: tuple[int, int] | None = None
    """Soft limits, microsteps from home; None: none."""


_Command = Annotated[str, pydantic.Field(max_length=70, pattern=r"^[\x20-\x7e]*$")]
_REALTIME = set("?!~")
"""Characters that GRBL removes from a line and obeys at once."""


class GrblTable(FileModel):
    """Commands and units of a board that speaks GRBL's G-code or a dialect of it."""

    greeting: Annotated[str, pydantic.Field(min_length=1, max_length=40)] = "Grbl"
    """Beginning of the line that the board sends after a reset."""
    axis: Literal["X", "Y", "Z", "A", "B", "C"] = "X"
    units_per_turn: Annotated[Number, pydantic.Field(gt=0, le=1e6)] = 360.0
    """Length of one turn of the table in the board's "millimetres": 360 for degrees."""
    laser_on: Annotated[tuple[_Command, ...], pydantic.Field(min_length=1, max_length=8)] = ("M3 S1000",)
    """Commands that switch a laser on, one for each laser."""
    laser_off: Annotated[_Command, pydantic.Field(min_length=1)] = "M5"
    home: _Command = "$H"
    enable: _Command = ""
    disable: _Command = ""
    check_settings: bool = True
    """Whether to read the board's own settings ($$) and compare them with the configuration."""

    @pydantic.field_validator("laser_on", mode="before")
    @classmethod
    def _listed(cls, commands: object) -> object:
        return (commands,) if isinstance(commands, str) else tuple(commands) if isinstance(commands, list) else commands

    @pydantic.model_validator(mode="after")
    def _lines(self) -> "GrblTable":
        for command in (*self.laser_on, self.laser_off, self.home, self.enable, self.disable):
            if _REALTIME & set(command):
                raise ValueError(
                    f'found the command "{command}", expected none of ? ! ~ in it: GRBL obeys them at once'
                )
        if not all(command.strip() for command in self.laser_on):
            raise ValueError('laser_on: found an empty command, expected one that switches a laser on, as "M3 S1000"')
        return self


class ControllerTable(FileModel):
    """The controller and its port."""

    type: Literal["jaxscan", "grbl"] = "jaxscan"
    """"jaxscan": the firmware of hardware/firmware. "grbl": a board that speaks GRBL's G-code."""
    port: Annotated[str, pydantic.Field(min_length=1, max_length=1024)] = "auto"
    """Serial port; "auto": the only port that looks like a controller."""
    baud: Annotated[Integer, pydantic.Field(ge=1200, le=4_000_000)] | None = None
    """Bits per second; by default that of its type: 250000, for GRBL 115200."""
    watchdog_ms: Annotated[Integer, pydantic.Field(ge=100, le=60_000)] = 500
    """Time without a valid line from the host after which laser and motor are switched off; GRBL has no watchdog."""
    reconnects: Annotated[Integer, pydantic.Field(ge=0, le=1000)] = 10
    """Attempts to find a lost controller again, with growing pauses, before the scan ends."""
    allow_laser_without_watchdog: bool = False
    """Scan with a controller that leaves the laser on when the host dies or the cable is pulled."""
    grbl: GrblTable = GrblTable()


State = Literal["idle", "move", "home", "shot", "fault"]


@dataclass(frozen=True)
class Firmware:
    """The firmware that answered."""

    proto: int | str
    version: str
    boot: int
    """Counts resets: when it changes, position and settings are lost."""
    lease_ms: int = 0
    """Longest time for which the laser stays on without a command from the host; 0: no limit."""


@dataclass(frozen=True)
class Status:
    """The present state."""

    state: State
    fault: Fault | None
    position: int
    homed: bool
    armed: bool
    """Whether the laser may be switched on: the contactor in its supply is closed, if there is one."""
    enabled: bool
    laser: bool
    exposures: int = 0
    home_switch: bool = False
    estop: bool = False


@dataclass(frozen=True)
class Counters:
    """A controller's counters of errors and wear."""

    damaged: int
    """Lines that arrived damaged at the controller."""
    overruns: int
    """Bytes that the controller lost."""
    repeated: int
    """Lines that arrived again and were answered but not carried out again."""
    laser_cycles: int
    up_ms: int
    watchdog_resets: int
    """Resets by the processor's watchdog since it was programmed."""


@dataclass(frozen=True)
class ShotDone:
    """A finished shot."""

    position: int
    exposures: int
    """Exposures since boot, modulo 65536: has grown by the number of exposures of the shot."""


@dataclass(frozen=True)
class Reconnection:
    """How the controller was found again."""

    same_boot: bool
    """It was not reset: its position is still valid."""
    status: Status


@dataclass
class LinkCounts:
    """Counts of the lines sent to and received from the controller."""

    sent: int = 0
    resent: int = 0
    naks: int = 0
    damaged: int = 0
    """Lines that arrived damaged at the host."""
    strays: int = 0
    """Unexpected answers: second answers to lines that were resent."""
    events: int = 0
    events_missed: int = 0
    unanswered: int = 0
    """Waits for an answer that came to nothing, and failures of the port, since a line was heard last."""


log = logging.getLogger(__name__)

UNCONFIRMED = "could not confirm that the laser is off: switch its supply off by hand"


@dataclass(frozen=True)
class Guarantees:
    """What a controller does even when the host fails. People are warned of what it cannot do."""

    laser_off_without_host: bool
    """The laser goes off within about a second after the host fails or the cable is pulled."""
    knows_missed_steps: bool
    """`Controller.home` returns by how many microsteps home was missed."""
    hardware_trigger: bool
    """It triggers the camera through a wire: `Controller.trigger`, `shot` and `wait_shot`."""
    checked_lines: bool
    """A line that was damaged on its way is detected and not carried out."""


class Controller(ABC):
    """A controller whose port is open. As a context manager it makes the rig safe when it exits.

    Positions are microsteps of the table from home, whatever units the controller uses. Used from one thread. Every
    method that asks the controller may raise:

        LinkLost: no answer any more; call `reconnect`. Its subclass ControllerReset: the controller was reset.
        RigFault: it stopped by itself and stays in the fault until `clear`.
        Refused: it does not carry out the command in its present state.
        RigTimeout: a motion or shot did not end in time and was stopped.
    """

    guarantees: Guarantees
    _closed = False

    @property
    @abstractmethod
    def link(self) -> Link:
        """The present link."""

    @property
    @abstractmethod
    def link_counts(self) -> LinkCounts:
        """Counts of lines sent, resent and damaged so far."""

    @property
    def name(self) -> str:
        """The name of the port, for messages."""
        return self.link.name

    # Session

    @abstractmethod
    def hello(self) -> Firmware:
        """Begin a session: laser off, contactor open. A changed `boot` means that position and settings are lost.

        Raises:
            FirmwareError: no answer, another device, or firmware that does not fit this host.
        """

    @abstractmethod
    def configure(self, settings: Settings) -> None:
        """Send the settings; FirmwareError if the controller does not take them, or switches fewer lasers."""

    @abstractmethod
    def reconnect(self, timeout_s: float = 60.0) -> Reconnection:
        """Find the controller again after LinkLost or ControllerReset. Motion is stopped, the laser off.

        Raises:
            LinkLost: it did not come back in time.
            FirmwareError: another device is there now.
        """

    # Motion

    @abstractmethod
    def enable(self, on: bool) -> None:
        """Switch the motor driver on or off; switching it off loses home."""

    @abstractmethod
    def home(self, max_steps: int, timeout_s: float = 120.0) -> int | None:
        """Search for the home switch, at most so many microsteps; its edge becomes position 0.

        Returns:
            The position of the switch by the counter as it was before: 0 if no step was lost. None if the controller
            cannot tell (`Guarantees.knows_missed_steps`).
        """

    @abstractmethod
    def move(self, to: int, timeout_s: float = 120.0) -> int:
        """Turn to a position, wait until the table is there, and return the position reached."""

    @abstractmethod
    def stop(self) -> None:
        """Laser off, motor ramped down; the table stays homed."""

    # Light

    @abstractmethod
    def arm(self, on: bool) -> None:
        """Allow or forbid the laser: close or open the contactor in its supply, if there is one."""

    @abstractmethod
    def laser(self, on: bool, *, number: int = 1) -> None:
        """Switch a laser on or renew its lease, by its number from 1; or switch all lasers off."""

    # The camera's trigger wire; refused without `Guarantees.hardware_trigger`

    @abstractmethod
    def trigger(self) -> None:
        """Start one exposure. Does not wait for its end."""

    @abstractmethod
    def shot(self, to: int, id: int, *, number: int = 1) -> None:
        """Begin a shot: turn to microstep `to`, settle, expose with a laser (from 1), expose without."""

    @abstractmethod
    def wait_shot(self, id: int, timeout_s: float = 120.0) -> ShotDone:
        """Wait for the end of a shot that `shot` began."""

    # State

    @abstractmethod
    def stat(self) -> Status:
        """Ask for the state; a fault is reported, not raised."""

    @abstractmethod
    def poll(self) -> Status:
        """Ask for the state, which also feeds the watchdog. A fault is raised."""

    @abstractmethod
    def counters(self) -> Counters | None:
        """The controller's own counters of errors and wear; None if it has none."""

    @abstractmethod
    def clear(self) -> None:
        """Leave a fault; the laser is not armed afterwards. Refused while its cause is still there."""

    # Ending

    @abstractmethod
    def abort(self) -> None:
        """Everything off at once, without waiting for an answer. Raises only LinkLost."""

    @abstractmethod
    def make_safe(self) -> bool:
        """Stop, laser off, contactor open; if that is not answered, abort. Raises no error of the rig.

        Returns:
            True if the controller confirmed that the laser is off and that nothing runs that could switch it on.
        """

    def close(self) -> None:
        """Make the rig safe and close the port; may be called twice. RigError if the laser is not confirmed off."""
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

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        try:
            self.close()
        except RigError as problem:
            if error is None:
                raise
            # The error that ended `with` goes on, with this one as its note.
            log.critical("%s", problem)
            error.add_note(str(problem))


T = TypeVar("T")


def with_growing_pauses(attempt: Callable[[], T], clock: Clock, timeout_s: float, name: str) -> T:
    """Attempt to find a controller again until it succeeds; LinkLost if it did not come back in time."""
    give_up = clock.now() + timeout_s
    pause = 0.1
    while True:
        try:
            return attempt()
        except (LinkLost, PortError) as problem:
            if clock.now() + pause > give_up:
                raise LinkLost(f"{name} did not come back within {timeout_s:.0f} s: {problem}") from problem
        clock.sleep(pause)
        pause = min(2 * pause, 2.0)
