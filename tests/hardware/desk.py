"""A rig on paper: a controller that obeys at once, in front of a simulated camera, with faults on demand."""

import functools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scanrig.cameras.camera import CameraSettings, Frame
from scanrig.cameras.simulated import FrameShape, SyntheticScene, draw
from scanrig.config import RigConfig
from scanrig.controllers.jxs.controller import JxsController
from scanrig.controllers.jxs.protocol import FAULTS
from scanrig.errors import CameraTimeout, Fault, PortError, RigFault
from scanrig.session import Devices, Hooks, SessionResult, run_calibration, run_sweep

from .fake import FakeController, ManualClock
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

    @property
    def shines(self) -> int:
        """Which laser shines, from 1; 0: none."""
        return (
            int(self.laser or self.welded)
            if self.contactor and not (self.dead or self.laser in self.dead_lasers)
            else 0
        )


class PaperEnd(FakeController):
    """The controller at the other end of the line, with a table, its lasers and a camera on its wire."""

    def __init__(self, table: Table, camera: FaultyCamera, clock: ManualClock) -> None:
        self.table, self.camera = table, camera
        self.broken_wire = self.twice = False
        self.gone = 0
        """How many attempts to reconnect fail."""
        super().__init__(clock=clock, name="paper", position=table.position)

    position = property(lambda self: self.table.position, lambda self, at: setattr(self.table, "position", at))
    laser = property(lambda self: self.table.laser, lambda self, on: setattr(self.table, "laser", int(on)))
    armed = property(lambda self: self.table.contactor, lambda self, on: setattr(self.table, "contactor", on))

    def expose(self) -> None:
        super().expose()
        for _ in range(0 if self.broken_wire else 1 + self.twice):
            self.camera.expose(self.table.position, self.table.shines)


class PaperController(JxsController):
    """The scanner's controller on a line of paper; `before_shot[n]` is called before the n-th shot."""

    def __init__(self, table: Table, camera: FaultyCamera, clock: ManualClock) -> None:
        self.fake = PaperEnd(table, camera, clock)
        self.fake.exposures = 65530
        super().__init__(self.fake, clock, reopen=self._found_again, session=5)
        self.before_shot: dict[int, Callable[[PaperController], None]] = {}
        self.shots: list[int] = []
        """Targets of all shots."""
        self.log: list[str] = []
        """What was asked of it."""
        self.never_safe = False

    # Injected faults

    def lose_link(self, attempts: int = 1) -> None:
        self.fake.unplugged, self.fake.gone = True, attempts
        self.fake.laser = False

    def _found_again(self) -> FakeController:
        if self.fake.gone:
            self.fake.gone -= 1
            raise PortError("paper is not there")
        self.fake.unplugged = False
        return self.fake

    def reset(self) -> None:
        self.fake.reset()
        super().stat()

    def fall_into(self, fault: Fault) -> None:
        self.fake.fail({known: number for number, known in FAULTS.items()}[fault])
        super().stat()
        raise RigFault(fault, self.fake.counter)

    def lose_steps(self, count: int) -> None:
        self.fake.position -= count

    # Actions

    def shot(self, to: int, id: int, *, number: int = 1) -> None:
        self.log.append("shot")
        if self.fake.homed and self.fake.armed:
            self.shots.append(to)
            if act := self.before_shot.pop(len(self.shots), None):
                act(self)
        super().shot(to, id, number=number)

    def make_safe(self) -> bool:
        self.log.append("make_safe")
        return super().make_safe() and not self.never_safe


def _of_fake(name: str) -> property:
    return property(lambda self: getattr(self.fake, name), lambda self, value: setattr(self.fake, name, value))


def _logged(name: str) -> Callable[..., Any]:
    do = getattr(JxsController, name)

    @functools.wraps(do)
    def logged(self: PaperController, *arguments: Any, **keys: Any) -> Any:
        self.log.append(f"{name} {arguments[0]:d}" if name in ("arm", "laser") else name)
        return do(self, *arguments, **keys)

    return logged


for _name in ("table", "camera", "estop", "exposures", "turn", "switch", "slips", "broken_wire", "twice", "fault"):
    setattr(PaperController, _name, _of_fake(_name))
for _name in (
    "hello", "configure", "reconnect", "enable", "arm", "home", "move", "laser", "trigger", "wait_shot", "counters",
    "clear", "stop", "abort",
):  # fmt: skip
    setattr(PaperController, _name, _logged(_name))


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
