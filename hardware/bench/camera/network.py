"""The GigE Vision camera on loopback: it follows the rig's log, renders the world, and sends frames.

Every pulse of the rig's trigger wire gives one frame, in order, of the table's angle at its beginning and with the
share of laser light that it had. Control socket, one line each: `board N`, `board none`, `poses`, `lose N`, `swap`,
`flash DN`, `blur PX`, `cover 0|1`, `loss SHARE`, `forget`, `disappear`, `appear`, `state`, `quit`.
"""

import json
import math
import queue
import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from bench.camera.aravis import EXPOSURE_US, GAIN, GvCamera
from bench.camera.follow import Exposure, LogReader, Plant
from bench.camera.world import NOMINAL_EXPOSURE_S, View, World
from bench.errors import BenchError


POLL_S = 0.002
"""How often the log is looked at."""

ADDRESS = "127.0.0.1"


@dataclass
class Trouble:
    """Faults of the next frames, as ordered by the control socket."""

    lose: int = 0
    swap: bool = False
    flash_dn: float = 0.0
    blur_px: int = 0
    covered: bool = False


@dataclass
class Counts:
    """Counts of the pulses of the trigger wire, by outcome."""

    triggers: int = 0
    not_armed: int = 0
    lost: int = 0
    sent: int = 0
    refused: int = 0


@dataclass
class BenchCamera:
    """Renders and sends the frames that the log asks for; `ledger` gets the true view of each."""

    world: World
    edges: Path
    microsteps_per_turn: int
    ledger: TextIO
    address: str = ADDRESS
    board: int | None = None
    trouble: Trouble = field(default_factory=Trouble)
    counts: Counts = field(default_factory=Counts)

    def __post_init__(self) -> None:
        self._plant = Plant(self.microsteps_per_turn)
        self._waiting: queue.Queue[tuple[Exposure, View]] = queue.Queue()
        self._held: tuple[Exposure, View, np.ndarray] | None = None
        self._stop = threading.Event()
        self._world_lock = threading.Lock()
        self._wire_lock = threading.Lock()
        self._wire: GvCamera | None = GvCamera(self.present, address=self.address)

    def run(self) -> None:
        """Follow the log until `quit`."""
        developer = threading.Thread(target=self._develop, daemon=True)
        developer.start()
        log, armed = LogReader(self.edges), False
        while not self._stop.is_set():
            lines = log.lines()
            for line in lines:
                rises, ended = self._plant.read(line)
                if rises:
                    wire = self._wire
                    armed = wire is not None and wire.armed()
                elif ended is not None:
                    self._expose(ended, armed)
            if not lines:
                self._stop.wait(POLL_S)
        developer.join(10)
        self._disappear()

    def present(self) -> np.ndarray:
        """The view at this moment, for a client that triggers by software or lets the camera run free."""
        lights = tuple(float(light.on) for light in self._plant.lights.values())
        view = self._view(self._plant.from_home(), lights)
        number = self.counts.sent + self.counts.triggers + 1_000_000
        return self._picture(view, number)

    def answer(self, text: str) -> str:
        """One line of the control socket.

        Raises:
            BenchError: If it is not understood.
        """
        verb, _, rest = text.partition(" ")
        try:
            return self._answer(verb, rest)
        except ValueError as problem:
            raise BenchError(f"{text!r}: {problem}") from problem

    def _answer(self, verb: str, rest: str) -> str:
        match verb, rest:
            case "board", "none":
                self.board = None
                return json.dumps({"board": None})
            case "board", _:
                return json.dumps(self._show(rest))
            case "poses", "":
                return json.dumps([self.world.describe(number) for number in range(len(self.world.poses()))])
            case "lose", _:
                self.trouble.lose = int(rest)
            case "swap", "":
                self.trouble.swap = True
            case "flash", _:
                self.trouble.flash_dn = float(rest)
            case "blur", _:
                self.trouble.blur_px = int(rest)
            case "cover", _:
                self.trouble.covered = bool(int(rest))
            case "loss", _:
                if self._wire is not None:
                    self._wire.lose_packets(float(rest))
            case "forget", "":
                self.forget_controller()
            case "disappear", "":
                self._disappear()
            case "appear", "":
                with self._wire_lock:
                    self._wire = self._wire or GvCamera(self.present, address=self.address)
            case "state", "":
                return json.dumps(self._state())
            case "quit", "":
                self.stop()
            case _:
                raise BenchError(f"the camera does not know {verb!r}")
        return "ok"

    def _show(self, which: str) -> dict[str, Any]:
        """The board in the pose of a number, in the next one, or in that of "free K" or "placement K"."""
        kind, _, nth = which.rpartition(" ")
        free = sum(pose.number is None for pose in self.world.poses())
        if which == "next":
            number = 0 if self.board is None else self.board + 1
            if number == len(self.world.poses()):
                self.board = None
                return {"board": None}
        elif kind in ("", "free", "placement"):
            number = int(nth) + (free if kind == "placement" else 0)
            if kind == "free" and not 0 <= number < free:
                raise BenchError(f"there is no free view {number}: 0 … {free - 1}")
        else:
            raise BenchError(f"board {which}: expected a number, next, none, free K or placement K")
        described = self.world.describe(number)
        self.board = number
        return described

    def forget_controller(self) -> None:
        """Free the control channel and stop, as a camera whose controller's heartbeat has ended."""
        with self._wire_lock:
            if self._wire is not None:
                self._wire.forget_controller()

    def stop(self) -> None:
        """End `run`."""
        self._stop.set()

    def _state(self) -> dict[str, Any]:
        return {
            **vars(self.counts),
            "waiting": self._waiting.qsize() + (self._held is not None),
            "board": self.board,
            "position": self._plant.from_home(),
            "light": self._plant.lights["light"].on,
            "light_2": self._plant.lights["light_2"].on,
            "there": self._wire is not None,
            "armed": self._wire is not None and self._wire.armed(),
        }

    def _disappear(self) -> None:
        with self._wire_lock:
            wire, self._wire = self._wire, None
            if wire is not None:
                wire.close()

    def _view(self, position: int, lights: tuple[float, ...]) -> View:
        angle = 2 * math.pi * position / self.microsteps_per_turn
        exposure, wire = 1.0, self._wire
        if wire is not None:
            seconds, gain_db = wire.register(EXPOSURE_US) / 1e6, wire.register(GAIN)
            exposure = seconds / NOMINAL_EXPOSURE_S * 10 ** (gain_db / 20)
        return View(angle, lights, self.board, exposure)

    def _expose(self, exposure: Exposure, armed: bool) -> None:
        self.counts.triggers += 1
        if armed:
            self._waiting.put((exposure, self._view(exposure.position, (exposure.light, exposure.light_2))))
        else:
            self.counts.not_armed += 1

    def _develop(self) -> None:
        """Render the exposures and send them, one after the other."""
        while not self._stop.is_set():
            try:
                exposure, view = self._waiting.get(timeout=0.05)
            except queue.Empty:
                continue
            trouble = self.trouble
            if trouble.lose > 0:
                trouble.lose -= 1
                self.counts.lost += 1
                continue
            picture = self._picture(view, exposure.cycle)
            if trouble.swap and self._held is None:
                self._held = (exposure, view, picture)
                continue
            self._send(exposure, view, picture)
            if self._held is not None:
                held, self._held, trouble.swap = self._held, None, False
                self._send(*held)

    def _picture(self, view: View, number: int) -> np.ndarray:
        trouble = self.trouble
        flash, blur = trouble.flash_dn, trouble.blur_px
        trouble.flash_dn, trouble.blur_px = 0.0, 0
        if trouble.covered:
            view = view._replace(exposure=0.0)
        with self._world_lock:
            return self.world.frame(view, number, flash_dn=flash, blur_px=blur)

    def _send(self, exposure: Exposure, view: View, picture: np.ndarray) -> None:
        with self._wire_lock:
            sent = self._wire is not None and self._wire.deliver(picture)
        self.counts.sent += sent
        self.counts.refused += not sent
        said = {**exposure._asdict(), "angle": view.angle, "board": view.board, "exposure": view.exposure, "sent": sent}
        self.ledger.write(json.dumps(said) + "\n")
        self.ledger.flush()
