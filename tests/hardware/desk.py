"""A rig on paper: a controller that obeys at once, in front of a simulated camera, with faults on demand."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scanrig.cameras.camera import CameraSettings, Frame
from scanrig.cameras.simulated import FrameShape, SyntheticScene, draw
from scanrig.config import RigConfig
from scanrig.controllers.controller import (
    Controller,
    Counters,
    Firmware,
    Guarantees,
    LinkCounts,
    Reconnection,
    Settings,
    ShotDone,
    Status,
)
from scanrig.errors import CameraTimeout, ControllerReset, Fault, LinkLost, Reason, Refused, RigFault
from scanrig.session import Devices, Hooks, SessionResult, run_calibration, run_sweep
from scanrig.wire import Link

from .fake import ARMED_IDLE_S, ManualClock
from .faulty_camera import FaultyCamera


WIDTH, HEIGHT = 128, 96


def rig_config(**tables):
    """A rig of 28800 microsteps a turn, a small camera, and ten steps."""
    camera = {"kind": "simulated", "width": WIDTH, "height": HEIGHT, **tables.pop("camera", {})}
    turntable = {"full_steps": 200, "microsteps": 16, "gear": [9, 1], **tables.pop("turntable", {})}
    sweep = {"steps": 10, "turn_deg": 36.0, **tables.pop("sweep", {})}
    return RigConfig.model_validate({"turntable": turntable, "camera": camera, "sweep": sweep, **tables})


class Table:
    """The true state of table, laser and contactor."""

    def __init__(self) -> None:
        self.position = 500
        """Where the table stands, in microsteps from the home switch."""
        self.laser = 0
        """Which laser is on, from 1."""
        self.contactor = False
        self.welded = False
        """The laser shines whatever the command."""
        self.dead = False
        """The laser is dark whatever the command."""
        self.dead_lasers: set[int] = set()
        """Those that are dark whatever the command."""
        self.moved_px = 0
        """How far the camera was knocked."""
        self.lit_cycles = 0

    @property
    def shines(self) -> int:
        """Which laser shines, from 1; 0: none."""
        return (
            int(self.laser or self.welded)
            if self.contactor and not (self.dead or self.laser in self.dead_lasers)
            else 0
        )


class PaperController(Controller):
    """A `Controller` without a wire; `before_shot[n]` is called before the n-th shot."""

    guarantees = Guarantees(True, True, True, True)

    def __init__(self, table: Table, camera: FaultyCamera, clock: ManualClock) -> None:
        self.table, self.camera, self.clock = table, camera, clock
        self.before_shot: dict[int, Callable[[PaperController], None]] = {}
        self.shots: list[int] = []
        """Targets of all shots."""
        self.log: list[str] = []
        self.boot = 7
        self.counter = 0
        self.fault: Fault | None = None
        self.estop = False
        self.homed = self.enabled = self.armed = False
        self.settings: Settings | None = None
        self.exposures = 65530
        self.gone = 0
        """How many attempts to reconnect fail."""
        self.lost = False
        self.never_safe = False
        self.counts = LinkCounts()
        self._heard = clock.now()

    # Injected faults

    def lose_link(self, attempts: int = 1) -> None:
        self.lost, self.gone = True, attempts
        self.table.laser = False

    def reset(self) -> None:
        self.boot += 1
        self.table.laser = self.table.contactor = False
        self.homed = self.enabled = self.armed = False
        self.counter, self.settings, self.fault = 0, None, None
        raise ControllerReset(self.boot - 1, self.boot)

    def fall_into(self, fault: Fault) -> None:
        self.fault = fault
        self.table.laser = self.table.contactor = self.armed = False
        if fault is Fault.EMERGENCY_STOP:
            self.homed = self.enabled = False
        raise RigFault(fault, self.counter)

    def lose_steps(self, count: int) -> None:
        self.table.position -= count

    # Actions

    name = "paper"

    @property
    def link(self) -> Link:
        raise NotImplementedError

    @property
    def link_counts(self) -> LinkCounts:
        return self.counts

    def _alive(self, verb: str) -> None:
        self.log.append(verb)
        patience = max(ARMED_IDLE_S, self.settings.watchdog_ms / 1000 if self.settings else 0.0)
        if self.clock.now() - self._heard >= patience:
            self._open_contactor()
        self.clock.sleep(0.003)
        self.link_counts.sent += 1
        if self.lost:
            self.link_counts.unanswered += 1
            raise LinkLost("no answer from paper")
        self.link_counts.unanswered = 0
        self._heard = self.clock.now()

    def _open_contactor(self) -> None:
        self.table.contactor = self.armed = False

    def _require(self, held: bool, reason: Reason, verb: str) -> None:
        if not held:
            raise Refused(reason, verb)

    def hello(self) -> Firmware:
        self._alive("hello")
        self.table.laser = False
        self._open_contactor()
        return Firmware(1, "1.0.0", self.boot, 1000)

    def configure(self, settings: Settings) -> None:
        self._alive("configure")
        self.settings = settings

    def reconnect(self, timeout_s: float = 60.0) -> Reconnection:
        self.log.append("reconnect")
        if self.gone * 2.0 > timeout_s:
            raise LinkLost("paper did not come back")
        self.clock.sleep(self.gone * 2.0)
        self.gone, self.lost = 0, False
        self._open_contactor()  # It is greeted.
        return Reconnection(self.settings is not None, self.stat())

    def enable(self, on: bool) -> None:
        self._alive("enable")
        self._require(self.fault is None, Reason.IN_FAULT, "EN on=1")
        self.enabled = on

    def arm(self, on: bool) -> None:
        self._alive(f"arm {on:d}")
        self._require(not on or self.fault is None, Reason.IN_FAULT, "ARM on=1")
        self.armed = self.table.contactor = on

    def home(self, max_steps: int, timeout_s: float = 120.0) -> int:
        self._alive("home")
        self._require(self.enabled, Reason.DRIVER_OFF, "HOME")
        assert self.settings is not None
        was = self.counter - self.table.position
        self.table.position = self.counter = 0
        self.homed = True
        return was

    def move(self, to: int, timeout_s: float = 120.0) -> int:
        self._alive("move")
        self._require(self.enabled, Reason.DRIVER_OFF, f"MOVE to={to}")
        self._turn(to)
        return to

    def _turn(self, to: int) -> None:
        self.table.position += to - self.counter
        self.counter = to

    def laser(self, on: bool, ms: int | None = None, *, number: int = 1) -> None:
        self._alive(f"laser {on:d}")
        self._require(not on or self.armed, Reason.NOT_ARMED, "LASER on=1")
        self.table.laser = number if on else 0
        self.table.lit_cycles += on

    def trigger(self) -> None:
        self._alive("trigger")

    def shot(self, to: int, id: int, *, number: int = 1) -> None:
        self._alive("shot")
        self._require(self.homed, Reason.NOT_HOMED, f"SHOT to={to}")
        self._require(self.armed, Reason.NOT_ARMED, f"SHOT to={to}")
        assert self.settings is not None
        self.shots.append(to)
        act = self.before_shot.pop(len(self.shots), None)
        if act is not None:
            act(self)
        self._alive("shot answered")
        self._turn(to)
        self.clock.sleep(0.145)
        for lit in (number, 0):
            self.table.laser = lit
            self.exposures = (self.exposures + 1) % 65536
            self.camera.expose(self.table.position, self.table.shines)
        self.table.lit_cycles += 1

    def wait_shot(self, id: int, timeout_s: float = 120.0) -> ShotDone:
        self._alive("wait_shot")
        return ShotDone(self.counter, self.exposures)

    def stat(self) -> Status:
        self._alive("stat")
        return Status(
            state="fault" if self.fault else "idle",
            fault=self.fault,
            position=self.counter,
            homed=self.homed,
            armed=self.armed,
            enabled=self.enabled,
            laser=self.table.laser,
            exposures=self.exposures,
            home_switch=self.table.position <= 0,
            estop=self.estop,
        )

    def poll(self) -> Status:
        status = self.stat()
        if self.fault:
            raise RigFault(self.fault, self.counter)
        return status

    def counters(self) -> Counters:
        self._alive("counters")
        return Counters(0, 0, 0, self.table.lit_cycles, 1000, 0)

    def clear(self) -> None:
        self._alive("clear")
        self._require(not self.estop, Reason.STILL_PRESSED, "CLEAR")
        self.fault = None

    def stop(self) -> None:
        self._alive("stop")
        self.table.laser = False

    def abort(self) -> None:
        self.log.append("abort")
        self.table.laser = self.table.contactor = self.armed = False
        self.fault = Fault.ABORTED

    def make_safe(self) -> bool:
        self.log.append("make_safe")
        if self.never_safe or self.lost:
            return False
        self.table.laser = self.table.contactor = self.armed = False
        return True


class Desk:
    """The whole simulated rig, and the inputs of a session on it."""

    def __init__(self, *, scene: SyntheticScene | None = None, **tables) -> None:
        self.config = rig_config(**tables)
        self.clock = ManualClock()
        self.table = Table()
        self.scene = scene or SyntheticScene()
        self._generator = np.random.default_rng(1)
        self.camera = self._camera(self.config.camera)
        self.controller = PaperController(self.table, self.camera, self.clock)
        self.said: list[str] = []

    def _camera(self, settings: CameraSettings) -> FaultyCamera:
        def world() -> tuple[float, int]:
            self.clock.sleep(0.03)
            return float(self.table.position), self.table.shines

        camera = FaultyCamera(settings, lambda *at: self.see(*at), world=world)
        next_frame = camera.next

        def waited(timeout_s: float) -> Frame:
            try:
                return next_frame(timeout_s)
            except CameraTimeout:
                self.clock.sleep(
                    timeout_s
                )  # The camera does not wait, so that nobody has to; time passes all the same.
                raise

        camera.next = waited  # type: ignore[method-assign]
        return camera

    def see(self, position: float, lit: int) -> np.ndarray:
        camera = self.config.camera
        image = draw(self.scene, position, lit, FrameShape(WIDTH, HEIGHT, camera.layout, camera.bits), self._generator)
        return np.ascontiguousarray(np.roll(image, self.table.moved_px, 1))

    @property
    def devices(self) -> Devices:
        return Devices(self.controller, self.camera, self.clock)

    def sweep(self, folder, *, resume=False, calibration_digest=None, **hooks) -> SessionResult:
        """A sweep; `hooks` are those of a session."""
        called = Hooks(**{"notify": self.said.append, **hooks})
        return run_sweep(
            self.config, folder, self.devices, called, resume=resume, calibration_digest=calibration_digest
        )

    def calibrate(self, folder, operator, *, resume=False, **hooks) -> SessionResult:
        """Views of the board; `hooks` are those of a session."""
        called = Hooks(**{"notify": self.said.append, **hooks})
        return run_calibration(self.config, folder, self.devices, operator, called, resume=resume)


def journal(folder: Path) -> list[dict[str, Any]]:
    """All lines of a capture's journal."""
    return [json.loads(line) for line in (folder / "frames.jsonl").read_text().splitlines()]


def events(folder: Path, name: str) -> list[dict[str, Any]]:
    """The events of one kind."""
    return [line for line in journal(folder) if line.get("event") == name]


def records(folder: Path) -> list[dict[str, Any]]:
    """The lines of records."""
    return [line for line in journal(folder) if "i" in line]


class After:
    """Asks to stop when so many steps are there."""

    def __init__(self, steps: int) -> None:
        self.left = steps

    def __call__(self) -> bool:
        self.left -= 1
        return self.left < 0
